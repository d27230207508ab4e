"""Estimate again from a recording, to the same bits."""
