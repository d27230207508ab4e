"""Validation of the model on recordings that had no part in the fit, and of the poses against references."""
