"""The transition matrix F of a step of the filter. Equations: EQUATIONS.md."""

from typing import Final

import numpy as np

from drd.estimation.state import (
    DD,
    GYRO_BIAS,
    GYRO_HEADING,
    GYRO_SCALE,
    HEADING,
    SCALE_L,
    SCALE_R,
    SLIP,
    TREAD,
    WHEEL_LAG,
    Matrix,
    N,
    Nominal,
    Two,
    X,
    Y,
    elements,
)  # fmt: skip

# Flat positions in F^T of the elements that change with each step.
(X_HEADING, X_SCALE_R, X_SCALE_L, X_TREAD) = (i * N + X for i in (HEADING, SCALE_R, SCALE_L, TREAD))
(Y_HEADING, Y_SCALE_R, Y_SCALE_L, Y_TREAD) = (i * N + Y for i in (HEADING, SCALE_R, SCALE_L, TREAD))
(X_GYRO, X_GYRO_SCALE, X_GYRO_BIAS, X_LAG) = (i * N + X for i in (GYRO_HEADING, GYRO_SCALE, GYRO_BIAS, WHEEL_LAG))
(Y_GYRO, Y_GYRO_SCALE, Y_GYRO_BIAS, Y_LAG) = (i * N + Y for i in (GYRO_HEADING, GYRO_SCALE, GYRO_BIAS, WHEEL_LAG))
X_SLIP, Y_SLIP = SLIP * N + X, SLIP * N + Y
(H_SCALE_R, H_SCALE_L, H_TREAD, H_LAG) = (i * N + HEADING for i in (SCALE_R, SCALE_L, TREAD, WHEEL_LAG))
(G_SCALE, G_BIAS, G_LAG) = (i * N + GYRO_HEADING for i in (GYRO_SCALE, GYRO_BIAS, WHEEL_LAG))
# A difference of two rates counts beyond three standard deviations: 3^2 times two rates' variances.
CHANGE_SIGMAS2: Final = 18.0
TURNED_SIGMAS2: Final = 9.0  # a rate itself, likewise


class Transition:
    """Writes F, the derivatives of `Filter.predict`'s lines, into its transpose `FT`, (N, N). (9), (12), (13)

    `along_gyro`: the last step went along the gyro's heading, else the wheels'. `has_gyro`: it had a gyro;
    `is_turned`: the gyro turned by more than its noise and bias while the wheels stood.
    """

    def __init__(self, FT: Matrix, midpoint_share: float, estimates_gyro_scale: float):
        FT[:] = np.eye(N)
        self.along_gyro = self.has_gyro = self.is_turned = self._has_lag = False
        self._f, self._half, self._estimates_gyro_scale = elements(FT), midpoint_share, estimates_gyro_scale

    def fill_gyro(
        self, n: Nominal, dt_s: float, turn: float, gyro_turn: float, moves: bool, rate_rad_s: float,
        gyro_rad2_per_s: float, bias_rad2_s2: float, is_back: bool,
    ) -> float:  # fmt: skip
        """Fill in the gyro's row. Returns the change of the yaw rate since `rate_rad_s`, 0 within its noise. (30)

        `turn`: at which F is evaluated (15); `gyro_rad2_per_s`: the gyro's noise; `bias_rad2_s2`: its bias's variance;
        `is_back`: it was absent in the last step.
        """
        f = self._f
        # The reading that a gyro without noise would give for this turn. (12)
        f[G_SCALE] = (turn - n.gyro_bias_rad_s * dt_s) / n.gyro_scale * self._estimates_gyro_scale
        f[G_BIAS] = dt_s
        self.has_gyro = True
        # Changes within the gyro's noise would pass for information on the lag: they count once they have added up.
        self.is_turned = is_turned = not moves and gyro_turn * gyro_turn > TURNED_SIGMAS2 * (
            (gyro_rad2_per_s + bias_rad2_s2 * dt_s) * dt_s
        )
        change = (gyro_turn if is_turned else turn) / dt_s - rate_rad_s
        if change * change * dt_s > CHANGE_SIGMAS2 * gyro_rad2_per_s:
            # A gyro that is back continues from the heading of turning wheels (35), in which there is no lag yet. (30)
            f[G_LAG] = 0.0 if is_back and moves else -change
            # With standing wheels and a turning gyro the headings are equated: the lag is in both, unobservable. (30)
            f[H_LAG] = 0.0 if moves else -change
            self._has_lag = True
            return change
        if self._has_lag:
            self._has_lag = False
            f[G_LAG] = f[H_LAG] = f[X_LAG] = f[Y_LAG] = 0.0
        return 0.0

    def fill_travel(
        self, dt_s: float, D: float, last_D: float, U: float, turn: float, step_x: float, step_y: float, c: float,
        s: float,
    ) -> Two:  # fmt: skip
        """Fill in the terms of the wheels' travel. Returns the distances of the left and the right wheel, m.

        `D`, `last_D`: tread of this step and of the last one, m; `c`, `s`: cosine and sine of the step's heading.
        """
        f, half_turn, treads, arm = self._f, 0.5 * turn, U / D, 0.5 * D
        per_right, per_left, per_tread = half_turn + treads, half_turn - treads, -turn / D
        arm_x, arm_y, bend_x, bend_y = arm * c, arm * s, -self._half * step_y, self._half * step_x
        # The tread's relative error stays, not that in metres: then scales and tread, all too large alike, remain the
        # unobservable direction, however the estimate of the tread changes. (15)
        f[DD] = D / last_D
        f[H_SCALE_R], f[H_SCALE_L], f[H_TREAD] = per_right, per_left, per_tread
        if self.along_gyro:
            f[X_GYRO], f[Y_GYRO] = -step_y, step_x
            g_scale = f[G_SCALE]
            f[X_GYRO_SCALE], f[Y_GYRO_SCALE] = bend_x * g_scale, bend_y * g_scale
            f[X_GYRO_BIAS], f[Y_GYRO_BIAS] = bend_x * dt_s, bend_y * dt_s
            if self._has_lag:
                f[X_LAG], f[Y_LAG] = bend_x * f[G_LAG], bend_y * f[G_LAG]
            f[X_SCALE_R], f[Y_SCALE_R] = per_right * arm_x, per_right * arm_y
            f[X_SCALE_L], f[Y_SCALE_L] = -per_left * arm_x, -per_left * arm_y
        else:
            f[X_HEADING], f[Y_HEADING] = -step_y, step_x
            f[X_TREAD], f[Y_TREAD] = per_tread * bend_x, per_tread * bend_y
            f[X_SCALE_R], f[Y_SCALE_R] = per_right * (bend_x + arm_x), per_right * (bend_y + arm_y)
            f[X_SCALE_L], f[Y_SCALE_L] = per_left * (bend_x - arm_x), per_left * (bend_y - arm_y)
        return abs(per_left) * D, abs(per_right) * D

    def fill_slip(self, x_m_per_s: float, y_m_per_s: float) -> None:
        """Fill in the effect of sideways slip on the position. (33)"""
        self._f[X_SLIP], self._f[Y_SLIP] = x_m_per_s, y_m_per_s

    def clear_rows(self, along_gyro: bool) -> None:
        """Switch to the other heading of travel: nothing depends on the former one any more."""
        f, self.along_gyro = self._f, along_gyro
        if along_gyro:
            f[X_HEADING] = f[Y_HEADING] = f[X_TREAD] = f[Y_TREAD] = 0.0
        else:
            f[X_GYRO] = f[Y_GYRO] = f[X_GYRO_SCALE] = f[Y_GYRO_SCALE] = 0.0
            f[X_GYRO_BIAS] = f[Y_GYRO_BIAS] = f[X_LAG] = f[Y_LAG] = 0.0

    def clear_gyro(self) -> None:
        """Clear the gyro's terms: without a gyro, its heading depends on nothing."""
        f = self._f
        f[G_SCALE] = f[G_BIAS] = f[G_LAG] = f[H_LAG] = 0.0
        self.has_gyro = self._has_lag = False
