"""A recording as time steps: the readings of each sensor per step, and the events found without regression."""
