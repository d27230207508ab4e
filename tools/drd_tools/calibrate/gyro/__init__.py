"""The gyro's error function e(w, T), from a rate table."""
