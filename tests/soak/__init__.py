"""A day of sensor data with faults through the daemon's core, in simulated time."""
