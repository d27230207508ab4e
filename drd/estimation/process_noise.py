"""The process noise Q of a step of the filter. Equations: EQUATIONS.md."""

from typing import Final

from drd.estimation.noise import NoiseProfile
from drd.estimation.state import (
    BB,
    DD,
    GG,
    GYRO_HEADING,
    HEADING,
    HH,
    LL,
    RR,
    SS,
    TT,
    WHEEL_LAG,
    XX,
    XY,
    YY,
    Matrix,
    N,
    Sigmas,
    Two,
    X,
    Y,
    elements,
)  # fmt: skip

# Flat positions in Q.
XH, YH = X * N + HEADING, Y * N + HEADING
YX, HX, HY = Y * N + X, HEADING * N + X, HEADING * N + Y
GT, TG = GYRO_HEADING * N + WHEEL_LAG, WHEEL_LAG * N + GYRO_HEADING
# A slowly varying rate error of this correlation time acts on the heading as white noise does. (26)
RATE_ERROR_CORRELATION_S: Final = 20.0


class ProcessNoise:
    """Q of the last step, and the variances added to the wheels' heading since the last comparison.

    `distance_rad2`, `turn_rad2`, `jitter_rad2`: the variances of the wheels' travel, of their turns, and of (25).
    """

    def __init__(self, Q: Matrix, sigmas: Sigmas):
        self.distance_rad2 = self.turn_rad2 = self.jitter_rad2 = 0.0
        self.estimates_gyro_scale = 1.0 if sigmas.gyro_scale > 0.0 else 0.0
        self._estimates_lag = 1.0 if sigmas.wheel_lag_s > 0.0 else 0.0
        self._q = elements(Q)

    def copy_from(self, other: "ProcessNoise") -> None:
        """Take over the variances since the last comparison."""
        self.distance_rad2, self.turn_rad2, self.jitter_rad2 = other.distance_rad2, other.turn_rad2, other.jitter_rad2

    def fill_wheels(
        self, k: NoiseProfile, dt_s: float, travel_m: Two, turn_rad: float, c: float, s: float, bend: float, D: float,
        jitter: float,
    ) -> None:  # fmt: skip
        """Map the noise of the wheels into Q: it moves position and heading together. (24)

        `travel_m`: the left and the right wheel's; `c`, `s`: cosine and sine of the step's heading; `bend`: the
        midpoint's share of the travel, m; `D`: tread, m; `jitter`: (25), rad^2.
        """
        q, (left_m, right_m) = self._q, travel_m
        right, left = k.wheel_m2_per_m * right_m, k.wheel_m2_per_m * left_m
        side = k.lateral_m2_per_m * 0.5 * (left_m + right_m)
        anywhere = k.position_m2_per_rad * turn_rad + k.position_m2_per_s * dt_s
        # In the robot's own axes: forward, sideways, heading.
        both = right + left
        travel, turn = both / (D * D), k.turn_rad2_per_rad * turn_rad + k.turn_rad2_per_s * dt_s
        q[HH] = heading = travel + turn + jitter
        self.distance_rad2 += travel
        self.turn_rad2 += turn
        self.jitter_rad2 += jitter
        forward, forward_heading = 0.25 * both, 0.5 * (right - left) / D
        c2, s2, cs = c * c, s * s, c * s
        if bend:
            sideways_heading, forward_sideways = bend * heading, forward_heading * bend
            sideways = bend * sideways_heading + side
            cross = 2.0 * forward_sideways * cs
            q[XX] = forward * c2 + sideways * s2 - cross + anywhere
            q[YY] = forward * s2 + sideways * c2 + cross + anywhere
            q[XY] = q[YX] = (forward - sideways) * cs + forward_sideways * (c2 - s2)
            q[XH] = q[HX] = forward_heading * c - sideways_heading * s
            q[YH] = q[HY] = forward_heading * s + sideways_heading * c
        else:
            q[XX] = forward * c2 + side * s2 + anywhere
            q[YY] = forward * s2 + side * c2 + anywhere
            q[XY] = q[YX] = (forward - side) * cs
            q[XH] = q[HX] = forward_heading * c
            q[YH] = q[HY] = forward_heading * s
        scale = k.wheel_scale_per_s * dt_s
        q[RR], q[LL] = k.wheel_scale_per_m * right_m + scale, k.wheel_scale_per_m * left_m + scale
        q[DD] = k.tread_m2_per_rad * turn_rad + k.tread_m2_per_s * dt_s

    def fill_gyro(self, k: NoiseProfile, dt_s: float, rate_sigma: float, rate_rad_s: float) -> None:
        """Map the gyro's noise, with the calibration's `rate_sigma`, rad/s, and the lag's random walk into Q."""
        q = self._q
        # While the robot turns, the gyro's heading at the wheels' time goes with the lag. (30)
        lag_walk = k.wheel_lag_s2_per_s * dt_s * self._estimates_lag
        swept = rate_rad_s * lag_walk
        q[TT], q[GT], q[TG] = lag_walk, -swept, -swept
        gyro = k.gyro_rad2_per_s + 2.0 * RATE_ERROR_CORRELATION_S * rate_sigma * rate_sigma  # (26)
        q[GG] = gyro * dt_s + rate_rad_s * swept
        q[SS] = k.gyro_scale_per_s * dt_s * self.estimates_gyro_scale
        q[BB] = k.gyro_bias_rad2_s2_per_s * dt_s
