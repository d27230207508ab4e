"""The indirect feedback Kalman filter: eleven error states, fixed size, preallocated. Equations: EQUATIONS.md.

It knows no clock, no sensor and no logger, never raises on data, and returns a typed outcome.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from enum import Enum
from math import cos, sin
from typing import Final

import numpy as np

from drd.estimation.noise import NoiseProfile
from drd.estimation.process_noise import ProcessNoise
from drd.estimation.state import (
    BB,
    DD,
    GYRO_HEADING,
    HEADING,
    HH,
    TREAD,
    VV,
    WHEEL_LAG,
    Matrix,
    N,
    Sigmas,
    State,
    Two,
)  # fmt: skip
from drd.estimation.transition import Transition

# Limits of the wheels' lag: a gyro's own filter and line make it no later than this, and a working drive is no slower;
# an estimate beyond is due to noise or slip.
LEAST_LAG_S: Final = -0.1
MOST_LAG_S: Final = 0.5
# Relative to the stated tread. Effective treads are 1.0 to 2.0 times the measured; no tape is wrong by three quarters.
LEAST_TREAD: Final = 0.25
# z^2 over S beyond which z exceeds the stated noise: three standard deviations, as where noise is learned.
USUAL2: Final = 9.0
# Rounding makes P asymmetric by about 1e-16 of its size in each step; it is made symmetric this often.
UPDATES_PER_SYMMETRISATION: Final = 50


class Outcome(Enum):
    """Outcome of a measurement."""

    ACCEPTED = "accepted"
    REJECTED = "rejected"
    NOT_FINITE = "not finite"


class Filter(State):
    """Predict with wheel travel and gyro rate; update with the difference of the two headings.

    The state is that at the wheels' time: hand in the gyro's rates delayed by the estimated lag.
    """

    def __init__(
        self,
        tread_m: float,
        sigmas: Sigmas,
        noise: NoiseProfile,
        gate_sigma: float = 5.0,
        midpoint: bool = True,
        along_gyro: bool = True,
    ):
        """`along_gyro`: travel follows the gyro's heading if there is one; else, as in the paper, the wheels'."""
        self.z = 0.0  # last innovation, rad
        self.S = 0.0  # and its variance, rad^2
        self.noise = replace(noise)  # a copy: some of it is learned while driving, see learning.py
        self._left_m_s = self._right_m_s = 0.0  # speeds of the last step
        self._without_gyro = True  # in the last step
        self._half = 0.5 if midpoint else 0.0
        self._updates = 0
        # [F I]^T, and [P F^T over Q]: their product is F P F^T + Q, without a further call to add Q. F is kept
        # transposed, since F P and (F P) F^T are then a fifth faster.
        self._FT_and_I: Matrix = np.vstack((np.eye(N), np.eye(N)))
        self._PFT_and_Q: Matrix = np.zeros((2 * N, N))
        self._T: Matrix = np.zeros((N, N))
        self._PH: Matrix = np.zeros(N)
        self._sigma: Matrix = np.zeros(())  # sqrt(S); numpy takes an array's element faster than a float
        self._gate2 = gate_sigma**2
        # Views, made once.
        self._FT, self._F_and_I = self._FT_and_I[:N], self._FT_and_I.T
        self._PFT, self._Q = self._PFT_and_Q[:N], self._PFT_and_Q[N:]
        self.process_noise = ProcessNoise(self._Q, sigmas)
        super().__init__(tread_m, sigmas, along_gyro)
        self._F, self._PT = self._FT.T, self.P.T
        self._P_wheels, self._P_gyro = self.P[HEADING], self.P[GYRO_HEADING]
        self._PH_column, self._PH_row = self._PH.reshape(N, 1), self._PH.reshape(1, N)

    def restart(self, tread_m: float, s: Sigmas) -> None:
        """Begin at the origin with these standard deviations; both headings share their error."""
        super().restart(tread_m, s)
        self._least_tread_m = LEAST_TREAD * tread_m
        # Sums of the comparisons' corrections of newest position and gyro heading, and of variance returned to P. (18)
        self.corrected_x_m = self.corrected_y_m = self.corrected_rad = 0.0
        self.returned_m2 = self.returned_rad2 = 0.0
        self._transition = Transition(self._FT, self._half, self.process_noise.estimates_gyro_scale)

    def copy_from(self, other: "Filter") -> None:
        """Copy another filter's estimate; the parameters and the learned noise stay."""
        self._copy_state(other)
        self.process_noise.copy_from(other.process_noise)
        self.corrected_x_m, self.corrected_y_m = other.corrected_x_m, other.corrected_y_m
        self.corrected_rad = other.corrected_rad
        self.returned_m2, self.returned_rad2 = other.returned_m2, other.returned_rad2
        self._left_m_s, self._right_m_s = other._left_m_s, other._right_m_s
        self._without_gyro = other._without_gyro

    def predict(
        self,
        dt_s: float,
        left_m: float,
        right_m: float,
        rate_rad_s: float | None,
        rate_sigma_rad_s: float = 0.0,
        lateral_m: float = 0.0,
    ) -> None:
        """Advance by `dt_s` with the encoders' travel and the gyro's mean rate over that time (None: no gyro).

        `rate_sigma_rad_s`: the calibration's contribution to the gyro's noise; `lateral_m`: the body's own travel to
        its left, which no sensor measures.
        """
        n, k, F, Q = self.nominal, self.noise, self._transition, self.process_noise
        D = n.tread_m
        U_R, U_L = (1.0 - n.scale_right) * right_m, (1.0 - n.scale_left) * left_m
        U, turn, change = 0.5 * (U_R + U_L), (U_R - U_L) / D, 0.0
        along_gyro = self._along_gyro and rate_rad_s is not None
        if along_gyro != F.along_gyro:
            F.clear_rows(along_gyro)
        middle = n.heading_rad + self._half * turn
        n.heading_rad += turn  # (7)
        if rate_rad_s is not None:
            gyro_turn = (n.gyro_scale * rate_rad_s + n.gyro_bias_rad_s) * dt_s
            if along_gyro:
                middle = n.gyro_heading_rad + self._half * gyro_turn
            n.gyro_heading_rad += gyro_turn  # (11)
            turn, change = self._fused_turn(dt_s, abs(left_m) + abs(right_m), turn, gyro_turn)
        elif F.has_gyro:
            F.clear_gyro()
        self._without_gyro = rate_rad_s is None
        c, s = cos(middle), sin(middle)
        step_x, step_y = U * c, U * s
        jitter = self._jitter_rad2(left_m / dt_s, right_m / dt_s, change)
        if self._p[VV]:  # costs no time without slip
            drift = U * turn / dt_s  # (33)
            F.fill_slip(-drift * s, drift * c)
            lateral_m += n.slip_s * drift
        if lateral_m:
            step_x, step_y = step_x - lateral_m * s, step_y + lateral_m * c  # (32)
        n.x_m += step_x  # (7)
        n.y_m += step_y  # (7)
        travel_m = F.fill_travel(dt_s, D, self._last_tread_m, U, turn, step_x, step_y, c, s)
        self._last_tread_m, bend = D, 0.0 if along_gyro else self._half * U
        Q.fill_wheels(k, dt_s, travel_m, abs(turn), c, s, bend, D, jitter)
        Q.fill_gyro(k, dt_s, rate_sigma_rad_s, self.rate_rad_s)
        self._propagate()

    def _propagate(self) -> None:
        """The covariance after a step. (16)"""
        P = self.P
        P.dot(self._FT, self._PFT)
        self._F_and_I.dot(self._PFT_and_Q, P)

    def _fused_turn(self, dt_s: float, distance_m: float, wheels_rad: float, gyro_rad: float) -> Two:
        """The step's turn from both sensors, by inverse variance, at which F is evaluated, and the change of the yaw
        rate since the last change that counted. Fills in the gyro's row of F. (15), (30)

        Standing wheels have no noise, so that at rest the turn is theirs: zero.
        """
        k, p, turn = self.noise, self._p, wheels_rad
        N2, bias_rad2_s2 = k.gyro_rad2_per_s, p[BB]
        if distance_m:
            D2 = self.nominal.tread_m * self.nominal.tread_m
            of_wheels = k.wheel_m2_per_m * distance_m / D2 + k.turn_rad2_per_rad * abs(wheels_rad)
            of_wheels += wheels_rad * wheels_rad * p[DD] / D2 + k.turn_rad2_per_s * dt_s + k.comparison_rad2
            of_gyro = (N2 + bias_rad2_s2 * dt_s) * dt_s
            turn += (gyro_rad - wheels_rad) * of_wheels / (of_wheels + of_gyro)
        change = self._transition.fill_gyro(
            self.nominal, dt_s, turn, gyro_rad, distance_m > 0.0, self.rate_rad_s, N2, bias_rad2_s2,
            self._without_gyro,
        )  # fmt: skip
        self.rate_rad_s += change
        return turn, change

    def _jitter_rad2(self, left_m_s: float, right_m_s: float, change: float) -> float:
        """Variance of the wheels' heading due to changes of the speeds, stored here, and of the yaw rate. (25)"""
        left_jump, right_jump, D = left_m_s - self._left_m_s, right_m_s - self._right_m_s, self.nominal.tread_m
        self._left_m_s, self._right_m_s = left_m_s, right_m_s
        jumps = left_jump * left_jump + right_jump * right_jump
        return self.noise.jitter_s2 * (jumps / (D * D) + change * change)

    def update(self, rate_rad_s: float) -> Outcome:
        """Compare the two headings, gate, correct all states and feed the correction back.

        Unless the outcome is ACCEPTED nothing has changed.
        """
        n, P, PH, T = self.nominal, self.P, self._PH, self._T
        z = n.heading_rad - n.gyro_heading_rad  # (14)
        np.subtract(self._P_wheels, self._P_gyro, PH)  # P H^T, from rows since P is symmetric
        ph: list[float] = PH.tolist()
        R = self.noise.comparison_rad2 + self.noise.timing_s2 * rate_rad_s * rate_rad_s  # (25)
        S = ph[HEADING] - ph[GYRO_HEADING] + R  # (17)
        self.z, self.S = z, S
        if not (S > 0.0 and math.isfinite(S + z + sum(ph))):
            return Outcome.NOT_FINITE
        k = z / S
        # A correction to almost no tread is rejected, however wide the gate: it would break F and Q.
        if z * z > self._gate2 * S or n.tread_m - ph[TREAD] * k < self._least_tread_m:  # (18)
            return Outcome.REJECTED
        if z * z > USUAL2 * S and not self.stands:
            # Slip within the gate: the excess goes to the wheels' heading, and other states learn little from it. (18)
            before = self._p[HH]
            self.add_heading_variance(z * z / USUAL2 - S)
            excess = self._p[HH] - before
            S += excess
            PH[HEADING] = ph[HEADING] = ph[HEADING] + excess
            k = z / S
        self._correct(ph, k)
        self._sigma[()] = math.sqrt(S)
        PH /= self._sigma
        self._PH_column.dot(self._PH_row, T)
        P -= T  # (19)
        if not LEAST_LAG_S <= n.wheel_lag_s <= MOST_LAG_S:
            # In place of an impossible lag, the likeliest state with the nearest possible one. (30)
            column, nearest_s = P[WHEEL_LAG].tolist(), min(max(n.wheel_lag_s, LEAST_LAG_S), MOST_LAG_S)
            self._correct(column, (n.wheel_lag_s - nearest_s) / column[WHEEL_LAG])
            n.wheel_lag_s = nearest_s
        self._updates += 1
        if self._updates % UPDATES_PER_SYMMETRISATION == 0:
            np.add(P, self._PT, T)
            np.multiply(T, 0.5, P)
        return Outcome.ACCEPTED

    def _correct(self, column: Sequence[float], k: float) -> None:
        """Correct each computed quantity by its estimated error, `column` times k. (20)"""
        n = self.nominal
        x, y, heading, scale_right, scale_left, tread, gyro_heading, gyro_scale, gyro_bias, lag, _ = column
        n.x_m -= x * k
        n.y_m -= y * k
        n.heading_rad -= heading * k
        n.scale_right += scale_right * k
        n.scale_left += scale_left * k
        n.tread_m -= tread * k
        n.gyro_heading_rad -= gyro_heading * k
        n.gyro_scale -= gyro_scale * k
        n.gyro_bias_rad_s -= gyro_bias * k
        n.wheel_lag_s -= lag * k
        # Corrections of the newest pose, ahead by the lag; a change of the lag alone does not move it.
        distance_m = 0.5 * (self._left_m_s + self._right_m_s) * lag
        self.corrected_x_m -= (x + distance_m * cos(n.gyro_heading_rad)) * k
        self.corrected_y_m -= (y + distance_m * sin(n.gyro_heading_rad)) * k
        self.corrected_rad -= (gyro_heading + self.rate_rad_s * lag) * k

    def return_variance(self, position_m2: float, heading_rad2: float) -> None:
        """Return to P the corrections, squared, of comparisons that may be wrong, see `Memory.corrected`. (18)"""
        self.add_position_variance(position_m2)
        self.add_heading_variance(heading_rad2, both=True)
        self.returned_m2, self.returned_rad2 = self.returned_m2 + position_m2, self.returned_rad2 + heading_rad2

    @property
    def gain(self) -> Matrix:
        """Kalman gain of the last accepted comparison, shape (N,)."""
        return self._PH / self._sigma

    @property
    def wheels_rad_s(self) -> float:
        """Yaw rate of the last step, from the wheels."""
        n = self.nominal
        return ((1.0 - n.scale_right) * self._right_m_s - (1.0 - n.scale_left) * self._left_m_s) / n.tread_m

    @property
    def is_turned(self) -> bool:
        """Whether in the last step the wheels stood but the gyro turned, by more than its noise and bias. (30)"""
        return self._transition.is_turned

    @property
    def stands(self) -> bool:
        """Whether the wheels stood in the last step."""
        return self._left_m_s == 0.0 == self._right_m_s
