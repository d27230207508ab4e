"""Benchmarks of the daemon: each compares with a yardstick measured in the same run, since machines differ."""
