"""Conversion constants, each named for what it converts: multiply by it. SI and radians are used inside."""

from math import pi
from typing import Final

RAD_PER_DEG: Final = pi / 180.0
DEG_PER_RAD: Final = 180.0 / pi
NS_PER_S: Final = 1_000_000_000
S_PER_NS: Final = 1e-9
NS_PER_MS: Final = 1_000_000
NS_PER_US: Final = 1000
S_PER_H: Final = 3600.0
# 1 deg/sqrt(h), the datasheets' unit of angle random walk, in rad/sqrt(s).
RAD_PER_SQRT_S_PER_DEG_PER_SQRT_H: Final = RAD_PER_DEG / 60.0
# 1 deg/h/sqrt(h), the datasheets' unit of rate random walk, in rad/s/sqrt(s).
RAD_PER_S_PER_SQRT_S_PER_DEG_PER_H_PER_SQRT_H: Final = RAD_PER_DEG / S_PER_H / 60.0
