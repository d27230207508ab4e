"""Emulated hardware: a gyro and wheel encoders that drive a known path, with faults to switch on."""
