"""The gyro's noise, bias and warm-up, from a log at standstill."""
