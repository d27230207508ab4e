"""Compare recorded with simulated sensor increments, without assuming a cause."""
