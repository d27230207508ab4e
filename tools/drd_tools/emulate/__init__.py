"""Emulated hardware: a gyro and wheel encoders on a known path, with switchable faults."""
