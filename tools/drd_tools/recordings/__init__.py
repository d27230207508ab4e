"""Recordings of real and simulated robots."""
