"""Evaluate estimated poses against a reference: errors, drift and consistency."""
