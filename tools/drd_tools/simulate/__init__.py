"""Simulated drives: a true motion at 500 Hz, effects of the catalogue, and the sensors' readings of both."""
