"""Calibration of the gyro and of the wheels, and the gyro's noise."""
