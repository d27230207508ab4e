"""Estimates of several recordings of one robot, combined, and effects that only their joint regression shows."""
