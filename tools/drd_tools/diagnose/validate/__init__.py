"""What the model is worth in recordings, and against references, that had no part in the fit."""
