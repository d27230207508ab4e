"""Simulated against recorded sensor increments, before anyone names a cause."""
