"""Drives that never were: a true motion at 500 Hz, effects of the catalogue, and what the sensors say about both."""
