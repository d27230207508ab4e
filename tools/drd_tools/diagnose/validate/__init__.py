"""Validation of the model on held-out recordings, and of the poses against references."""
