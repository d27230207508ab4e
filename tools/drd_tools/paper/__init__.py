"""Experiments of Chung, Ojeda and Borenstein (2001), repeated in simulation with the daemon's own classes."""
