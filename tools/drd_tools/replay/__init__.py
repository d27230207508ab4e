"""Bit-exact replay of the estimation from a recording."""
