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
from drd.estimation.state import (
    BB,
    DD,
    GG,
    GYRO_BIAS,
    GYRO_HEADING,
    GYRO_SCALE,
    HEADING,
    HH,
    LL,
    RR,
    SCALE_L,
    SCALE_R,
    SLIP,
    SS,
    TREAD,
    TT,
    VV,
    WHEEL_LAG,
    XX,
    XY,
    YY,
    Matrix,
    N,
    Sigmas,
    State,
    X,
    Y,
    elements,
)  # fmt: skip

# Flat positions in an N x N matrix, made once: the elements of F and Q that change with each step. F is kept
# transposed, since F P and (F P) F^T are then a fifth faster.
(X_HEADING, X_SCALE_R, X_SCALE_L, X_TREAD) = (i * N + X for i in (HEADING, SCALE_R, SCALE_L, TREAD))
(Y_HEADING, Y_SCALE_R, Y_SCALE_L, Y_TREAD) = (i * N + Y for i in (HEADING, SCALE_R, SCALE_L, TREAD))
(X_GYRO, X_GYRO_SCALE, X_GYRO_BIAS, X_LAG) = (i * N + X for i in (GYRO_HEADING, GYRO_SCALE, GYRO_BIAS, WHEEL_LAG))
(Y_GYRO, Y_GYRO_SCALE, Y_GYRO_BIAS, Y_LAG) = (i * N + Y for i in (GYRO_HEADING, GYRO_SCALE, GYRO_BIAS, WHEEL_LAG))
X_SLIP, Y_SLIP = SLIP * N + X, SLIP * N + Y
(H_SCALE_R, H_SCALE_L, H_TREAD, H_LAG) = (i * N + HEADING for i in (SCALE_R, SCALE_L, TREAD, WHEEL_LAG))
(G_SCALE, G_BIAS, G_LAG) = (i * N + GYRO_HEADING for i in (GYRO_SCALE, GYRO_BIAS, WHEEL_LAG))
XH, YH = X * N + HEADING, Y * N + HEADING
YX, HX, HY = Y * N + X, HEADING * N + X, HEADING * N + Y
GT, TG = GYRO_HEADING * N + WHEEL_LAG, WHEEL_LAG * N + GYRO_HEADING
# A slowly varying rate error of this correlation time acts on the heading as white noise does. (26)
RATE_ERROR_CORRELATION_S: Final = 20.0
# A difference of two rates counts from three of its standard deviations on: 3^2 times two rates' variances.
CHANGE_SIGMAS2: Final = 18.0
TURNED_SIGMAS2: Final = 9.0  # a rate itself, likewise
# The wheels' lag is no less than a gyro can be late by its own filter and its line, and no more than a drive that
# works; what seems to be more is noise, or slip.
LEAST_LAG_S: Final = -0.1
MOST_LAG_S: Final = 0.5
# A part of the stated tread. Effective ones are 1.0 to 2.0 times the measured one; no tape is wrong by three quarters.
LEAST_TREAD: Final = 0.25
# z^2 over S beyond which z is no noise as stated: three standard deviations, as for what noise is learned from.
USUAL2: Final = 9.0
# Rounding makes P asymmetric by about 1e-16 of its size in each step; it is made symmetric this often.
UPDATES_PER_SYMMETRISATION: Final = 50


class Outcome(Enum):
    """What became of a measurement."""

    ACCEPTED = "accepted"
    REJECTED = "rejected"
    NOT_FINITE = "not finite"


class Filter(State):
    """Predict with wheel travel and gyro rate; update with the difference of the two headings.

    All of it is at the time that the wheels report: the gyro's rates are to be handed in later by the estimated lag.
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
        """`along_gyro`: it travels along the gyro's heading where there is one; else, as printed, the wheels'."""
        self.z = 0.0  # last innovation, rad
        self.S = 0.0  # and its variance, rad^2
        self.noise = replace(noise)  # its own: some of it is learned on the way, see learning.py
        # Variances that noise has added to the wheels' heading since the last comparison: their travel's, their turns'.
        self.distance_rad2 = self.turn_rad2 = self.jitter_rad2 = 0.0
        self._left_m_s = self._right_m_s = self._jitter = 0.0  # speeds of the last step, and their share in (25)
        self._half = 0.5 if midpoint else 0.0
        self._estimate_gyro_scale = 1.0 if sigmas.gyro_scale > 0.0 else 0.0
        self._estimate_lag = 1.0 if sigmas.wheel_lag_s > 0.0 else 0.0
        self._updates = 0
        # [F I]^T, and [P F^T over Q]: their product is F P F^T + Q, without a further call to add Q.
        self._FT_and_I: Matrix = np.zeros((2 * N, N))
        self._PFT_and_Q: Matrix = np.zeros((2 * N, N))
        self._T: Matrix = np.zeros((N, N))
        self._PH: Matrix = np.zeros(N)
        self._sigma: Matrix = np.zeros(())  # sqrt(S); numpy takes an array's element faster than a float
        self._gate2 = gate_sigma**2
        super().__init__(tread_m, sigmas, along_gyro)
        # Views, made once.
        self._FT, self._F_and_I = self._FT_and_I[:N], self._FT_and_I.T
        self._PFT, self._Q = self._PFT_and_Q[:N], self._PFT_and_Q[N:]
        self._F, self._PT = self._FT.T, self.P.T
        self._P_wheels, self._P_gyro = self.P[HEADING], self.P[GYRO_HEADING]
        self._PH_column, self._PH_row = self._PH.reshape(N, 1), self._PH.reshape(1, N)
        self._f, self._q = elements(self._FT), elements(self._Q)

    def restart(self, tread_m: float, s: Sigmas) -> None:
        """Begin at the origin with these standard deviations; both headings share their error."""
        super().restart(tread_m, s)
        self._least_tread_m = LEAST_TREAD * tread_m
        # Sums of corrections of the newest pose and the gyro's heading by comparisons, and of what P got back. (18)
        self.corrected_x_m = self.corrected_y_m = self.corrected_rad = 0.0
        self.returned_m2 = self.returned_rad2 = 0.0
        # What stays in F from step to step.
        self._FT_and_I[:N] = self._FT_and_I[N:] = np.eye(N)
        self._F_along_gyro = self._F_has_gyro = self._F_has_lag = False

    def copy_from(self, other: "Filter") -> None:
        """Take over another filter's estimate; the parameters stay, and so does what was learned of the noise."""
        self._copy_state(other)
        self.distance_rad2, self.turn_rad2, self.jitter_rad2 = other.distance_rad2, other.turn_rad2, other.jitter_rad2
        self.corrected_x_m, self.corrected_y_m = other.corrected_x_m, other.corrected_y_m
        self.corrected_rad = other.corrected_rad
        self.returned_m2, self.returned_rad2 = other.returned_m2, other.returned_rad2
        self._left_m_s, self._right_m_s = other._left_m_s, other._right_m_s

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

        `rate_sigma_rad_s` is what the calibration adds to the gyro's noise; `lateral_m` the body's own travel to its
        left, which no sensor tells.
        """
        n = self.nominal
        D = n.tread_m
        U_R, U_L = (1.0 - n.scale_right) * right_m, (1.0 - n.scale_left) * left_m
        U, turn = 0.5 * (U_R + U_L), (U_R - U_L) / D
        along_gyro = self._along_gyro and rate_rad_s is not None
        if along_gyro != self._F_along_gyro:
            self._clear_rows(along_gyro)
        middle = n.heading_rad + self._half * turn
        n.heading_rad += turn  # (7)
        if rate_rad_s is None:
            lag = 0.0
            if self._F_has_gyro:
                self._clear_gyro()
        else:
            gyro_turn = (n.gyro_scale * rate_rad_s + n.gyro_bias_rad_s) * dt_s
            if along_gyro:
                middle = n.gyro_heading_rad + self._half * gyro_turn
            n.gyro_heading_rad += gyro_turn  # (11)
            distance_m = abs(left_m) + abs(right_m)
            turn = self._fused_turn(dt_s, distance_m, turn, gyro_turn)
            lag = self._gyro_row(dt_s, turn, gyro_turn, distance_m > 0.0)
        c, s = cos(middle), sin(middle)
        step_x, step_y = U * c, U * s
        left_m_s, right_m_s = left_m / dt_s, right_m / dt_s
        left_jump, right_jump = left_m_s - self._left_m_s, right_m_s - self._right_m_s
        self._left_m_s, self._right_m_s = left_m_s, right_m_s
        jumps = left_jump * left_jump + right_jump * right_jump
        self._jitter = self.noise.jitter_s2 * (jumps / (D * D) + lag * lag)  # (25)
        if self._p[VV]:  # nobody who does not slip pays for it
            drift = U * turn / dt_s  # (33)
            self._f[X_SLIP], self._f[Y_SLIP] = -drift * s, drift * c
            lateral_m += n.slip_s * drift
        if lateral_m:
            step_x, step_y = step_x - lateral_m * s, step_y + lateral_m * c  # (32)
        n.x_m += step_x  # (7)
        n.y_m += step_y  # (7)
        rows = self._rows_along_gyro if along_gyro else self._rows_along_wheels
        left_m, right_m = rows(dt_s, U, turn, step_x, step_y, c, s)
        bend = 0.0 if along_gyro else self._half * U
        self._process_noise(dt_s, left_m, right_m, abs(turn), rate_sigma_rad_s, c, s, bend)
        self._propagate()

    def _propagate(self) -> None:
        """The covariance after a step. (16)"""
        P = self.P
        P.dot(self._FT, self._PFT)
        self._F_and_I.dot(self._PFT_and_Q, P)

    def _gyro_row(self, dt_s: float, turn: float, gyro_turn: float, moves: bool) -> float:
        """Fill in the gyro's row of F. Returns what an error of the lag turns."""
        n, f, gyro = self.nominal, self._f, self.noise.gyro_rad2_per_s
        # The reading that a gyro without noise would give for this turn. (12)
        f[G_SCALE] = (turn - n.gyro_bias_rad_s * dt_s) / n.gyro_scale * self._estimate_gyro_scale
        f[G_BIAS] = dt_s
        self._F_has_gyro = True
        # Changes within the gyro's noise would pass for knowledge of the lag: they count once they have added up.
        is_turned = not moves and gyro_turn * gyro_turn > TURNED_SIGMAS2 * ((gyro + self._p[BB] * dt_s) * dt_s)
        change = (gyro_turn if is_turned else turn) / dt_s - self.rate_rad_s
        if change * change * dt_s > CHANGE_SIGMAS2 * gyro:
            self.rate_rad_s += change
            f[G_LAG] = -change  # (30)
            # Wheels that stand and a gyro that turns are made one: the lag is in both, and nothing tells it. (30)
            f[H_LAG] = 0.0 if moves else -change
            self._F_has_lag = True
            return -change
        if self._F_has_lag:
            self._F_has_lag = False
            f[G_LAG] = f[H_LAG] = f[X_LAG] = f[Y_LAG] = 0.0
        return 0.0

    def _rows_along_gyro(
        self, dt_s: float, U: float, turn: float, step_x: float, step_y: float, c: float, s: float
    ) -> tuple[float, float]:
        """Fill in what the wheels' travel makes of F: the derivatives of `predict`'s lines. (9), (13)

        `arm` is half the tread, `bend` the midpoint's share. Returns how far the left and the right wheel have gone for
        this turn.
        """
        f, D = self._f, self.nominal.tread_m
        half_turn, treads = 0.5 * turn, U / D
        per_right, per_left = half_turn + treads, half_turn - treads
        arm = 0.5 * D
        arm_x, arm_y, bend_x, bend_y = arm * c, arm * s, -self._half * step_y, self._half * step_x
        # The relative error of the tread stays, not that in metres: then scales and tread, all too large alike, remain
        # the direction of which no comparison tells, whatever the tread is estimated to be meanwhile. (15)
        f[DD], self._last_tread_m = D / self._last_tread_m, D
        f[H_SCALE_R], f[H_SCALE_L], f[H_TREAD] = per_right, per_left, -turn / D
        f[X_GYRO], f[Y_GYRO] = -step_y, step_x
        g_scale = f[G_SCALE]
        f[X_GYRO_SCALE], f[Y_GYRO_SCALE] = bend_x * g_scale, bend_y * g_scale
        f[X_GYRO_BIAS], f[Y_GYRO_BIAS] = bend_x * dt_s, bend_y * dt_s
        if self._F_has_lag:
            f[X_LAG], f[Y_LAG] = bend_x * f[G_LAG], bend_y * f[G_LAG]
        f[X_SCALE_R], f[Y_SCALE_R] = per_right * arm_x, per_right * arm_y
        f[X_SCALE_L], f[Y_SCALE_L] = -per_left * arm_x, -per_left * arm_y
        return abs(per_left) * D, abs(per_right) * D

    def _rows_along_wheels(
        self, _: float, U: float, turn: float, step_x: float, step_y: float, c: float, s: float
    ) -> tuple[float, float]:
        """As `_rows_along_gyro`, for travel along the wheels' heading. (13)"""
        f, D = self._f, self.nominal.tread_m
        half_turn, treads, arm = 0.5 * turn, U / D, 0.5 * D
        per_right, per_left, per_tread = half_turn + treads, half_turn - treads, -turn / D
        arm_x, arm_y, bend_x, bend_y = arm * c, arm * s, -self._half * step_y, self._half * step_x
        f[DD], self._last_tread_m = D / self._last_tread_m, D
        f[H_SCALE_R], f[H_SCALE_L], f[H_TREAD] = per_right, per_left, per_tread
        f[X_HEADING], f[Y_HEADING] = -step_y, step_x
        f[X_TREAD], f[Y_TREAD] = per_tread * bend_x, per_tread * bend_y
        f[X_SCALE_R], f[Y_SCALE_R] = per_right * (bend_x + arm_x), per_right * (bend_y + arm_y)
        f[X_SCALE_L], f[Y_SCALE_L] = per_left * (bend_x - arm_x), per_left * (bend_y - arm_y)
        return abs(per_left) * D, abs(per_right) * D

    def _clear_rows(self, along_gyro: bool) -> None:
        """The robot travels along the other heading from now on: in F nothing depends on the one that it has left."""
        f, self._F_along_gyro = self._f, along_gyro
        if along_gyro:
            f[X_HEADING] = f[Y_HEADING] = f[X_TREAD] = f[Y_TREAD] = 0.0
        else:
            f[X_GYRO] = f[Y_GYRO] = f[X_GYRO_SCALE] = f[Y_GYRO_SCALE] = 0.0
            f[X_GYRO_BIAS] = f[Y_GYRO_BIAS] = f[X_LAG] = f[Y_LAG] = 0.0

    def _clear_gyro(self) -> None:
        """There is no gyro from now on: in F its heading depends on nothing."""
        f = self._f
        f[G_SCALE] = f[G_BIAS] = f[G_LAG] = f[H_LAG] = 0.0
        self._F_has_gyro = self._F_has_lag = False

    def _fused_turn(self, dt_s: float, distance_m: float, wheels_rad: float, gyro_rad: float) -> float:
        """The step's turn from both sensors, each weighted by its variance: where F is taken. (15)

        Wheels that stand have no noise, so that at rest the turn is theirs: none.
        """
        if not distance_m:
            return wheels_rad
        k, p, D = self.noise, self._p, self.nominal.tread_m
        D2 = D * D
        of_wheels = k.wheel_m2_per_m * distance_m / D2 + k.turn_rad2_per_rad * abs(wheels_rad)
        of_wheels += wheels_rad * wheels_rad * p[DD] / D2 + k.turn_rad2_per_s * dt_s + k.comparison_rad2
        of_gyro = (k.gyro_rad2_per_s + p[BB] * dt_s) * dt_s
        return wheels_rad + (gyro_rad - wheels_rad) * of_wheels / (of_wheels + of_gyro)

    def _process_noise(
        self,
        dt_s: float,
        left_m: float,
        right_m: float,
        turn_rad: float,
        rate_sigma: float,
        c: float,
        s: float,
        bend: float,
    ) -> None:
        """Map the noise of a step into Q: wheel noise moves position and heading together. (24)

        `c`, `s`: cosine and sine of the step's heading; `bend`: the midpoint's share of the travel, m.
        """
        k, q, D = self.noise, self._q, self.nominal.tread_m
        right, left = k.wheel_m2_per_m * right_m, k.wheel_m2_per_m * left_m
        turn = k.turn_rad2_per_rad * turn_rad + k.turn_rad2_per_s * dt_s
        side = k.lateral_m2_per_m * 0.5 * (left_m + right_m)
        anywhere = k.position_m2_per_rad * turn_rad + k.position_m2_per_s * dt_s
        scale = k.wheel_scale_per_s * dt_s
        # In the robot's own axes: forward, sideways, heading.
        both = right + left
        travel = both / (D * D)
        heading = travel + turn + self._jitter
        self.distance_rad2 += travel
        self.turn_rad2 += turn
        self.jitter_rad2 += self._jitter
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
        q[HH] = heading
        q[RR] = k.wheel_scale_per_m * right_m + scale
        q[LL] = k.wheel_scale_per_m * left_m + scale
        q[DD] = k.tread_m2_per_rad * turn_rad + k.tread_m2_per_s * dt_s
        # While the robot turns, the gyro's heading at the wheels' time goes with the lag. (30)
        lag_walk = k.wheel_lag_s2_per_s * dt_s * self._estimate_lag
        swept = self.rate_rad_s * lag_walk
        q[TT], q[GT], q[TG] = lag_walk, -swept, -swept
        gyro = k.gyro_rad2_per_s + 2.0 * RATE_ERROR_CORRELATION_S * rate_sigma * rate_sigma  # (26)
        q[GG] = gyro * dt_s + self.rate_rad_s * swept
        q[SS] = k.gyro_scale_per_s * dt_s * self._estimate_gyro_scale
        q[BB] = k.gyro_bias_rad2_s2_per_s * dt_s

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
        # No evidence for a robot almost without a tread is believed, however wide the gate: it would break F and Q.
        if z * z > self._gate2 * S or n.tread_m - ph[TREAD] * k < self._least_tread_m:  # (18)
            return Outcome.REJECTED
        if z * z > USUAL2 * S and not self.stands:
            # Slip, if by less than the gate: what is too much is the wheels' heading's, and teaches little else. (18)
            before = self._p[HH]
            self.add_heading_variance(z * z / USUAL2 - S)
            excess = self._p[HH] - before
            S += excess
            PH[HEADING] = ph[HEADING] = ph[HEADING] + excess
            k = z / S
        self._correct(ph, k)
        if not LEAST_LAG_S <= n.wheel_lag_s <= MOST_LAG_S:
            # In place of a lag that cannot be, the likeliest state with the nearest that can. (30)
            column, nearest_s = P[WHEEL_LAG].tolist(), min(max(n.wheel_lag_s, LEAST_LAG_S), MOST_LAG_S)
            self._correct(column, (n.wheel_lag_s - nearest_s) / column[WHEEL_LAG])
            n.wheel_lag_s = nearest_s
        self._sigma[()] = math.sqrt(S)
        PH /= self._sigma
        self._PH_column.dot(self._PH_row, T)
        P -= T  # (19)
        self._updates += 1
        if self._updates % UPDATES_PER_SYMMETRISATION == 0:
            np.add(P, self._PT, T)
            np.multiply(T, 0.5, P)
        return Outcome.ACCEPTED

    def _correct(self, column: Sequence[float], k: float) -> None:
        """Each computed quantity loses its error, that of `column` times k. (20)"""
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
        # Of the pose that the lag leads to, which the lag by itself does not move.
        distance_m = 0.5 * (self._left_m_s + self._right_m_s) * lag
        self.corrected_x_m -= (x + distance_m * cos(n.gyro_heading_rad)) * k
        self.corrected_y_m -= (y + distance_m * sin(n.gyro_heading_rad)) * k
        self.corrected_rad -= (gyro_heading + self.rate_rad_s * lag) * k

    def return_variance(self, position_m2: float, heading_rad2: float) -> None:
        """Give P what it has lost by comparisons that may have been wrong, as `Memory.corrected` tells. (18)"""
        self.add_position_variance(position_m2)
        self.add_heading_variance(heading_rad2, both=True)
        self.returned_m2, self.returned_rad2 = self.returned_m2 + position_m2, self.returned_rad2 + heading_rad2

    @property
    def gain(self) -> Matrix:
        """Kalman gain of the last accepted comparison, shape (N,)."""
        return self._PH / self._sigma

    @property
    def wheels_rad_s(self) -> float:
        """The yaw rate of the last step as the wheels tell it."""
        return (self._right_m_s - self._left_m_s) / self.nominal.tread_m

    @property
    def stands(self) -> bool:
        """The wheels did not move in the last step."""
        return self._left_m_s == 0.0 == self._right_m_s
