"""The estimator: samples in, poses with their uncertainty out. It knows no port, no bus, no clock, no logger."""
