"""A recording on one time grid: the sensors' readings in each step, and the reference's poses."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline
from scipy.ndimage import maximum_filter1d

from drd.arrays import Array, cumulative
from drd.config.robot import Robot, datasheet
from drd.config.schema import ConfigError
from drd.effects.effect import NOMINAL, Calibrated
from drd.units import RAD_PER_DEG, RAD_PER_S_PER_SQRT_S_PER_DEG_PER_H_PER_SQRT_H, RAD_PER_SQRT_S_PER_DEG_PER_SQRT_H
from drd_tools.diagnose.observe import grids
from drd_tools.diagnose.observe.comparable import check_comparable
from drd_tools.recordings.folder import Recording

FEWEST_STEPS: Final = 10  # fewer leave nothing to be fitted
UNSEEN: Final = 1e12  # sigma of an unobserved quantity, m or rad
NEIGHBOURS: Final = 1  # steps on either side into which a stamp may shift a count
# Defaults if robot.yaml states none: datasheets of the supported gyros, and a smooth floor.
WALK_DEG_PER_SQRT_H: Final = 0.1
BIAS_DEG_S: Final = 0.02
BIAS_WALK_DEG_H_PER_SQRT_H: Final = 5.0
SLIP_M_PER_SQRT_M: Final = 0.003
INFLATION: Final = 10.0  # times the datasheets': largest long-run slip of real wheels
LEAST: Final = 1e-2  # of the default: no sensor is free of noise, whatever its datasheet states
LATERAL_SHARE: Final = 0.25  # of the slip: not in any datasheet
POSITION_SIGMA_M: Final = 0.02  # of a reference of unknown make
HEADING_SIGMA_DEG: Final = 0.5  # of the same
LONGEST_FIX_S: Final = 0.5  # between sparser fixes a robot may turn and stop


@dataclass(frozen=True, kw_only=True)
class Noise:
    """Sizes of the noise, SI. Those of the datasheets are the priors of the fitted ones. (68)"""

    walk_rad_per_sqrt_s: float
    bias_rad_s: float
    bias_walk_rad_s_per_sqrt_s: float
    resolution_rad_s: float
    slip_m_per_sqrt_m: float
    forward_m_per_sqrt_m: float
    lateral_m_per_sqrt_m: float
    count_m: float
    position_m: float
    heading_rad: float
    jitter_s: float = 0.0  # of the timing of the wheels' changes of speed (25)
    ahead_m: float = 0.0  # of the reference's lever arm ahead (70)

    def inflated(self) -> "Noise":
        """Inflate the noise, so that effects missing from the model do not keep a path from following the fixes."""
        slip = INFLATION * self.slip_m_per_sqrt_m
        return replace(
            self,
            walk_rad_per_sqrt_s=INFLATION * self.walk_rad_per_sqrt_s,
            bias_rad_s=INFLATION * self.bias_rad_s,
            slip_m_per_sqrt_m=slip,
            forward_m_per_sqrt_m=slip,
            lateral_m_per_sqrt_m=slip,
        )

    def wheels(self, e: "Evidence") -> Array:
        """Variance of the wheels' turn in a step, the gyro's own included, (n,)."""
        if not e.has_wheels:  # at standstill the turn is observed to be 0
            return np.where(e.still, self.gyro(e), UNSEEN**2)
        D2 = e.tread_m**2
        wheels = self.slip_m_per_sqrt_m**2 * e.near_travel_m / D2 + ~e.still * self.count_m**2 / (3.0 * D2)
        wheels = wheels + (e.left_inflation_m2 + e.right_inflation_m2) / D2
        if self.jitter_s:
            wheels = wheels + self.jitter_s**2 * e.speed_changes_rad2_s2
        return wheels + np.where(e.gyroless, 1e-12, self.gyro(e))

    def gyro(self, e: "Evidence") -> Array:
        """Variance of the gyro's turn in a step, (n,)."""
        return (
            self.walk_rad_per_sqrt_s**2 * e.step_s
            + self.resolution_rad_s**2 / 12.0 * e.step_s**2
            + e.gyro_inflation_rad2
        )

    def steps(self, e: "Evidence", c: Array, s: Array, hx: Array, hy: Array) -> Array:
        """Q of each step, (n, 4, 4). `c`, `s`: of the heading; `hx`, `hy`: effect of a heading error on x and y."""
        forward = (self.forward_m_per_sqrt_m**2 * e.travel_m + e.left_inflation_m2 + e.right_inflation_m2) / 4.0
        sideways = self.lateral_m_per_sqrt_m**2 * e.travel_m / 2.0
        turn = np.where(e.gyroless, self.wheels(e), self.gyro(e)) + e.jump_rad2
        Q = np.zeros((len(c), 4, 4))
        Q[:, 0, 0] = forward * c * c + sideways * s * s + turn * hx * hx / 4.0
        Q[:, 1, 1] = forward * s * s + sideways * c * c + turn * hy * hy / 4.0
        Q[:, 0, 1] = Q[:, 1, 0] = (forward - sideways) * c * s + turn * hx * hy / 4.0
        Q[:, 0, 2] = Q[:, 2, 0] = turn * hx / 2.0
        Q[:, 1, 2] = Q[:, 2, 1] = turn * hy / 2.0
        Q[:, 2, 2] = turn
        Q[:, 0, 0] += e.jump_m2
        Q[:, 1, 1] += e.jump_m2
        if e.gyro_rad is not None:
            Q[:, 3, 3] = self.bias_walk_rad_s_per_sqrt_s**2 * e.step_s
        return Q


@dataclass(frozen=True, kw_only=True)
class Evidence:
    """A recording in steps k = 0..n-1, which end at `time_s` (n,), each `step_s` (n,) long.

    `gyro_rad` (n,): turn by the gyro, or None. `left_m`, `right_m` (n,): travel by the counters.
    `travel_m` (n,): of both wheels; `near_travel_m`: largest in a step or its neighbours, since at a stop the stamps
    decide which step a count falls in. `still` (n,): no wheel has counted for a second before and after.
    `..._inflation_...` (n,): variance added where a sensor carried no useful information; inf for the gyro: the turn
    is the wheels'. `jump_m2`, `jump_rad2` (n,): variance of a jump of the reference in the step, of each coordinate and
    of the heading. `datasheet`: the noise stated by the sensors' makers or robot.yaml.
    `temperature_c` (n,): NaN where not known. `fix` (m, 3): reference poses x_m, y_m, heading_rad, each in the step
    `fix_step` (m,), `fix_share` (m,) of a step before its end. Without wheels (`has_wheels`) the travel is that of the
    reference's positions, 0 if they are too sparse, and only headings, and the turn at standstill, are compared.
    `robot`: its constants as far as measured; `is_far`: they, and perhaps the reference's mounting, are far from
    robot.yaml. `reference_lag_s`: correction of the reference's stamps; None if it is not determined. `counted_m`: the
    counted travel, which gives the wheels' angles, if effects have been removed from `left_m` and `right_m`.
    """

    name: str
    time_s: Array
    step_s: Array
    gyro_rad: Array | None
    left_m: Array
    right_m: Array
    temperature_c: Array
    fix_step: npt.NDArray[np.intp]
    fix_share: Array
    fix: Array
    tread_m: float
    radius_m: float
    standstill_s: float
    datasheet: Noise
    travel_m: Array
    near_travel_m: Array
    still: npt.NDArray[np.bool_]
    gyro_inflation_rad2: Array
    left_inflation_m2: Array
    right_inflation_m2: Array
    jump_m2: Array
    jump_rad2: Array
    has_wheels: bool = True
    robot: Calibrated = NOMINAL
    reference_lag_s: float | None = 0.0
    is_far: bool = False
    counted_m: tuple[Array, Array] | None = None

    @property
    def gyroless(self) -> npt.NDArray[np.bool_]:
        """Steps whose turn is the wheels' alone, (n,)."""
        return np.isinf(self.gyro_inflation_rad2) | (self.gyro_rad is None)

    @property
    def has_three_clocks(self) -> bool:
        """Whether there are wheels, gyro and reference on real ground, where the lags between them drift."""
        return self.is_far and self.gyro_rad is not None and self.has_wheels

    @cached_property
    def speed_changes_rad2_s2(self) -> Array:
        """Square of the turn per second of jitter (25), mean of the changes at a step's begin and end, (n,)."""
        wheels = (travel / self.step_s / self.tread_m for travel in (self.left_m, self.right_m))
        gyro = np.zeros(len(self.step_s)) if self.gyro_rad is None else self.gyro_rad / self.step_s
        changes = np.sum([np.diff(speed) ** 2 for speed in (*wheels, gyro)], axis=0)
        result: Array = 0.5 * (np.append(changes, 0.0) + np.append(0.0, changes))
        return result

    @property
    def observed(self) -> slice | npt.NDArray[np.intp]:
        """Index of the observed rows among those of the filter: of the wheels (n,), then x, y, heading of each fix."""
        n = len(self.time_s)
        if not self.has_wheels:
            return np.concatenate([np.flatnonzero(self.still), n + 2 + 3 * np.arange(len(self.fix))])
        return slice(n if self.gyro_rad is None else 0, None)

    @property
    def channels(self) -> tuple[str, ...]:
        """Channels whose errors are observable."""
        return (("gyro",) if self.gyro_rad is not None else ()) + (("wheels", "body") if self.has_wheels else ())

    @property
    def fix_time_s(self) -> Array:
        """Time of each fix, (m,)."""
        result: Array = self.time_s[self.fix_step] - self.fix_share * self.step_s[self.fix_step]
        return result

    def with_fixes(self, kept: npt.NDArray[np.bool_] | npt.NDArray[np.intp]) -> "Evidence":
        """The evidence with only some of its fixes."""
        return replace(self, fix_step=self.fix_step[kept], fix_share=self.fix_share[kept], fix=self.fix[kept])

    @property
    def edges_s(self) -> Array:
        """Times at which the steps begin and end, (n + 1,)."""
        return np.concatenate([[self.time_s[0] - self.step_s[0]], self.time_s])

    @property
    def apart_m(self) -> Array:
        """Travel of the right wheel less that of the left in each step, with the radii as far as measured, (n,)."""
        return self.right_m * self.robot.right - self.left_m * self.robot.left

    def earlier(self, increments: Array, delay_s: Array | float) -> Array:
        """Correct the increments of a sum, (n,), for samples stamped `delay_s` too late, at each edge."""
        if not np.any(delay_s):
            return increments
        edges = self.edges_s
        total = CubicSpline(edges, cumulative(increments))
        at = edges + delay_s
        known = (at[:-1] >= edges[0]) & (at[1:] <= edges[-1])
        return np.where(known, np.diff(total(np.clip(at, edges[0], edges[-1]))), increments)


def datasheet_noise(nominal: Robot, has_wheels: bool = True) -> Noise:
    """The noise stated by robot.yaml, or the default. Without wheels no position is compared."""
    nominal = datasheet(nominal)
    per_revolution = nominal.counts_per_revolution

    def given(value: float | None, otherwise: float) -> float:
        return otherwise if value is None else max(value, LEAST * otherwise)

    slip = given(nominal.slip_noise_m_per_sqrt_m, SLIP_M_PER_SQRT_M)
    return Noise(
        walk_rad_per_sqrt_s=given(nominal.gyro_angle_random_walk_deg_per_sqrt_h, WALK_DEG_PER_SQRT_H)
        * RAD_PER_SQRT_S_PER_DEG_PER_SQRT_H,
        bias_rad_s=given(nominal.gyro_bias_repeatability_deg_s, BIAS_DEG_S) * RAD_PER_DEG,
        bias_walk_rad_s_per_sqrt_s=given(nominal.gyro_bias_random_walk_deg_per_h_per_sqrt_h, BIAS_WALK_DEG_H_PER_SQRT_H)
        * RAD_PER_S_PER_SQRT_S_PER_DEG_PER_H_PER_SQRT_H,
        resolution_rad_s=given(nominal.gyro_resolution_deg_s, 0.0) * RAD_PER_DEG,
        slip_m_per_sqrt_m=slip,
        forward_m_per_sqrt_m=slip,
        lateral_m_per_sqrt_m=LATERAL_SHARE * slip,
        count_m=2.0 * np.pi * nominal.wheel_radius_m / per_revolution if per_revolution and has_wheels else 0.0,
        position_m=given(nominal.reference_position_sigma_m, POSITION_SIGMA_M) if has_wheels else UNSEEN,
        heading_rad=given(nominal.reference_heading_sigma_deg, HEADING_SIGMA_DEG) * RAD_PER_DEG,
    )


def gather(recording: Recording, robot: Calibrated = NOMINAL, reference_lag_s: float | None = 0.0) -> Evidence:
    """Resample a recording to steps, which follow the gyro's samples if there is a gyro.

    `robot`: its constants as far as measured; `reference_lag_s`: correction already applied to the reference's stamps.

    Raises ConfigError if there is nothing to compare, or no overlap in time.
    """
    check_comparable(recording)
    grid, log, nominal = _grid(recording), recording.wheels, recording.nominal
    time_s, step_s = grid.time_s, grid.step_s
    edges = np.concatenate([[time_s[0] - step_s[0]], time_s])
    fix_step, fix_share, fix = grids.fixes(recording, edges, step_s)
    zero = np.zeros(len(time_s))
    if log is None:
        assert grid.gyro_rad is not None
        tread_m, radius_m = 1.0, 1.0  # without meaning
        left_m = right_m = grids.travel(recording.reference, edges)
        lost_m2, still = zero, grids.still_by_gyro(grid, grid.gyro_rad, nominal.standstill_at_start_s)
    else:
        tread_m, radius_m = nominal.tread_m, nominal.wheel_radius_m
        left_m, right_m = (
            np.diff(np.interp(edges, log.time_s, radius_m * angle)) for angle in recording.wheel_angles_rad()
        )
        lost_m2 = grids.lost_m2(recording, edges, np.maximum(np.abs(left_m), np.abs(right_m)) / step_s)
        still = grids.still_by_wheels(left_m, right_m, step_s) & (lost_m2 == 0.0)
    travel_m = np.abs(left_m) + np.abs(right_m)
    e = Evidence(
        name=recording.name, time_s=time_s, step_s=step_s, gyro_rad=grid.gyro_rad, left_m=left_m, right_m=right_m,
        temperature_c=grid.temperature_c, fix_step=fix_step, fix_share=fix_share, fix=fix, tread_m=tread_m,
        radius_m=radius_m, standstill_s=nominal.standstill_at_start_s,
        datasheet=datasheet_noise(nominal, log is not None), travel_m=travel_m,
        near_travel_m=maximum_filter1d(travel_m, 2 * NEIGHBOURS + 1), still=still,
        gyro_inflation_rad2=grid.bridged_rad2, left_inflation_m2=lost_m2, right_inflation_m2=lost_m2.copy(),
        jump_m2=zero.copy(), jump_rad2=zero.copy(), has_wheels=log is not None, robot=robot,
        reference_lag_s=reference_lag_s,
    )  # fmt: skip
    return _without_holes(e, grid)


def _without_holes(e: Evidence, grid: grids.Grid) -> Evidence:
    """Fill long gaps of the gyro with the turns of the wheels, corrected for their lag."""
    wheels = None
    if e.has_wheels:
        apart_m = np.interp(e.edges_s + e.robot.wheels_lag_s, e.edges_s, cumulative(e.apart_m))
        turn = np.diff(apart_m) / (e.tread_m * e.robot.tread)
        slip_m2 = e.datasheet.inflated().slip_m_per_sqrt_m ** 2 * e.near_travel_m
        wheels = turn, (slip_m2 + 2.0 * e.left_inflation_m2) / e.tread_m**2
    gyro_rad, inflation_rad2 = grids.without_holes(grid, wheels)
    return replace(e, gyro_rad=gyro_rad, gyro_inflation_rad2=inflation_rad2)


def _grid(recording: Recording) -> grids.Grid:
    """The steps. Raises ConfigError if there are too few."""
    fog, log = recording.fog, recording.wheels
    if fog is not None:
        grid = grids.gyro_grid(recording, fog)
    else:
        assert log is not None
        grid = grids.even_grid(log, recording.reference)
    if len(grid.time_s) < FEWEST_STEPS:
        what = "of all sensors together" if fog is not None and log is not None else "of the recording"
        got = f"{len(grid.time_s)}"
        raise ConfigError(str(recording.folder), "", f"at least {FEWEST_STEPS} steps {what}", got)
    return grid
