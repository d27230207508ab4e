"""A recording on one grid of time: what the sensors say of each step, and what the reference says of the pose."""

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline
from scipy.ndimage import maximum_filter1d

from drd.schema import ConfigError
from drd.units import (
    RAD_PER_DEG,
    RAD_PER_S_PER_SQRT_S_PER_DEG_PER_H_PER_SQRT_H,
    RAD_PER_SQRT_S_PER_DEG_PER_SQRT_H,
)
from drd_tools.recordings.folder import Nominal, Recording
from drd_tools.replay.nominal import data_sheet

Array = npt.NDArray[np.float64]

# A grid finer than the gyro's samples tells nothing more; a coarser one blurs latencies.
STEP_S: Final = 0.1
STILL_S: Final = 1.0
NEIGHBOURS: Final = 1
# Where robot.yaml does not say: data sheets of the gyros that the project supports, and a smooth floor.
WALK_DEG_PER_SQRT_H: Final = 0.1
BIAS_DEG_S: Final = 0.02
BIAS_WALK_DEG_H_PER_SQRT_H: Final = 5.0
SLIP_M_PER_SQRT_M: Final = 0.003
LATERAL_SHARE: Final = 0.25  # of the slip: no sheet gives it
POSITION_SIGMA_M: Final = 0.02
HEADING_SIGMA_DEG: Final = 0.5


@dataclass(frozen=True)
class Noise:
    """Sizes of the noise, SI. As data sheets give it, they are the priors of what is fitted."""

    walk_rad_per_sqrt_s: float
    bias_rad_s: float
    bias_walk_rad_s_per_sqrt_s: float
    resolution_rad_s: float
    slip_m_per_sqrt_m: float
    turn_slip_rad_per_sqrt_rad: float
    lateral_m_per_sqrt_m: float
    count_m: float
    position_m: float
    heading_rad: float

    def wheels(self, e: "Evidence", turn_rad: Array) -> Array:
        """Variance of the wheels' turn in a step, the gyro's own included, (n,)."""
        D2 = e.tread_m**2
        wheels = self.slip_m_per_sqrt_m**2 * e.near_travel_m / D2 + ~e.still * self.count_m**2 / (3.0 * D2)
        wheels = wheels + (e.left_doubt_m2 + e.right_doubt_m2) / D2
        wheels = wheels + self.turn_slip_rad_per_sqrt_rad**2 * np.abs(turn_rad)
        return wheels + self.gyro(e) if e.gyro_rad is not None else wheels + 1e-12

    def gyro(self, e: "Evidence") -> Array:
        """Variance of the gyro's turn in a step, (n,)."""
        return (
            self.walk_rad_per_sqrt_s**2 * e.step_s + self.resolution_rad_s**2 / 12.0 * e.step_s**2 + e.gyro_doubt_rad2
        )

    def steps(self, e: "Evidence", turn_rad: Array, c: Array, s: Array, hx: Array, hy: Array) -> Array:
        """Q of each step, (n, 4, 4). `c`, `s`: of the heading; `hx`, `hy`: what a heading error does to x and y."""
        forward = (self.slip_m_per_sqrt_m**2 * e.travel_m + e.left_doubt_m2 + e.right_doubt_m2) / 4.0
        sideways = self.lateral_m_per_sqrt_m**2 * e.travel_m / 2.0
        turn = self.wheels(e, turn_rad) if e.gyro_rad is None else self.gyro(e)
        Q = np.zeros((len(c), 4, 4))
        Q[:, 0, 0] = forward * c * c + sideways * s * s + turn * hx * hx / 4.0
        Q[:, 1, 1] = forward * s * s + sideways * c * c + turn * hy * hy / 4.0
        Q[:, 0, 1] = Q[:, 1, 0] = (forward - sideways) * c * s + turn * hx * hy / 4.0
        Q[:, 0, 2] = Q[:, 2, 0] = turn * hx / 2.0
        Q[:, 1, 2] = Q[:, 2, 1] = turn * hy / 2.0
        Q[:, 2, 2] = turn
        if e.gyro_rad is not None:
            Q[:, 3, 3] = self.bias_walk_rad_s_per_sqrt_s**2 * e.step_s
        return Q


@dataclass(frozen=True)
class Evidence:
    """Steps k = 0..n-1 end at `time_s` (n,), each `step_s` (n,) long.

    `gyro_rad` (n,): angle that the gyro turned, or None. `left_m`, `right_m` (n,): travel that the counters told.
    `travel_m` (n,): of both wheels; `near_travel_m`: the most in a step or its neighbours, since at a stop the stamps
    decide what a step has. `still` (n,): no wheel has counted for a second before and after.
    `..._doubt_...` (n,): variance of a step beyond the noise, where a sensor said nothing of use.
    `temperature_c` (n,): NaN where not known. `fix` (m, 3): reference poses x_m, y_m, heading_rad, each in the step
    `fix_step` (m,), `fix_share` (m,) of a step before its end.
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
    sheet: Noise
    travel_m: Array
    near_travel_m: Array
    still: npt.NDArray[np.bool_]
    gyro_doubt_rad2: Array
    left_doubt_m2: Array
    right_doubt_m2: Array

    @property
    def fix_time_s(self) -> Array:
        """When each fix is, (m,)."""
        result: Array = self.time_s[self.fix_step] - self.fix_share * self.step_s[self.fix_step]
        return result

    @property
    def edges_s(self) -> Array:
        """Where the steps begin and end, (n + 1,)."""
        return np.concatenate([[self.time_s[0] - self.step_s[0]], self.time_s])

    def earlier(self, increments: Array, delay_s: float) -> Array:
        """Increments of a sum, (n,), as they are where its samples are stamped `delay_s` too late."""
        if delay_s == 0.0:
            return increments
        edges = self.edges_s
        total = CubicSpline(edges, np.concatenate([[0.0], np.cumsum(increments)]))
        at = edges + delay_s
        known = (at[:-1] >= edges[0]) & (at[1:] <= edges[-1])
        return np.where(known, np.diff(total(np.clip(at, edges[0], edges[-1]))), increments)


def sheet_of(nominal: Nominal) -> Noise:
    """What robot.yaml says of the noise, or what is usual."""
    fog, reference, encoders = data_sheet(nominal.fog), nominal.reference, nominal.encoders
    per_revolution = nominal.wheel.counts_per_revolution

    def given(value: float | None, otherwise: float) -> float:
        return otherwise if value is None else value

    slip = given(encoders.slip_noise_m_per_sqrt_m, SLIP_M_PER_SQRT_M)
    return Noise(
        given(fog.angle_random_walk_deg_per_sqrt_h, WALK_DEG_PER_SQRT_H) * RAD_PER_SQRT_S_PER_DEG_PER_SQRT_H,
        given(fog.bias_repeatability_deg_s, BIAS_DEG_S) * RAD_PER_DEG,
        given(fog.bias_random_walk_deg_per_h_per_sqrt_h, BIAS_WALK_DEG_H_PER_SQRT_H)
        * RAD_PER_S_PER_SQRT_S_PER_DEG_PER_H_PER_SQRT_H,
        given(fog.resolution_deg_s, 0.0) * RAD_PER_DEG,
        slip,
        0.0,
        LATERAL_SHARE * slip,
        2.0 * np.pi * nominal.wheel.radius_m / per_revolution if per_revolution else 0.0,
        given(reference.position_sigma_m, POSITION_SIGMA_M),
        given(reference.heading_sigma_deg, HEADING_SIGMA_DEG) * RAD_PER_DEG,
    )


def gather(recording: Recording) -> Evidence:
    """Bring a recording to steps. The gyro's own samples are the steps where there is a gyro.

    Raises ConfigError where there is nothing to compare.
    """
    fog, log, reference = recording.fog, recording.encoders, recording.reference
    if fog is None and reference is None:
        expected = "fog.csv or reference.csv: wheels alone have nothing to be compared with"
        raise ConfigError(str(recording.folder), "", expected, "encoders.csv only")
    angle_l, angle_r = recording.wheel_angles_rad()
    radius = recording.nominal.wheel.radius_m
    if fog is not None:
        inside = (fog.time_s >= log.time_s[0]) & (fog.time_s <= log.time_s[-1] + 1e-9)
        times = fog.time_s
        step = np.diff(times, prepend=2 * times[0] - times[1])
        typical = float(np.median(step))
        step = np.where(step > 1.5 * typical, typical, step)
        time_s, step_s, gyro = times[inside], step[inside], (fog.rate_rad_s * step)[inside]
        temperature = np.full(len(time_s), np.nan) if fog.temperature_c is None else fog.temperature_c[inside]
    else:
        gyro = None
        # The wheels' noise within a step is not followed, so fixes had better stand at its end.
        first = 0.0 if reference is None else float((reference.time_s[0] - log.time_s[0]) % STEP_S)
        time_s = np.arange(log.time_s[0] + first + STEP_S, log.time_s[-1], STEP_S)
        step_s = np.full(len(time_s), STEP_S)
        temperature = np.full(len(time_s), np.nan)
    edges = np.concatenate([[time_s[0] - step_s[0]], time_s])
    left_m, right_m = (np.diff(np.interp(edges, log.time_s, radius * a)) for a in (angle_l, angle_r))
    if reference is None:
        fix_step, fix_share, fix = np.zeros(0, np.intp), np.zeros(0), np.zeros((0, 3))
    else:
        within = (reference.time_s > edges[0] - 1e-9) & (reference.time_s <= time_s[-1])
        at = reference.time_s[within]
        fix_step = np.searchsorted(time_s, at - 1e-9)
        fix_share = (time_s[fix_step] - at) / step_s[fix_step]
        fix = np.column_stack([reference.x_m, reference.y_m, reference.heading_rad])[within]
    travel_m = np.abs(left_m) + np.abs(right_m)
    still_steps = max(1, round(STILL_S / float(np.median(step_s))))
    return Evidence(
        recording.name, time_s, step_s, gyro, left_m, right_m, temperature, fix_step, fix_share, fix,
        recording.nominal.tread_m, radius, recording.nominal.standstill_at_start_s, sheet_of(recording.nominal),
        travel_m, maximum_filter1d(travel_m, 2 * NEIGHBOURS + 1),
        maximum_filter1d(travel_m, 2 * still_steps + 1) == 0.0,
        np.zeros(len(time_s)), np.zeros(len(time_s)), np.zeros(len(time_s)),
    )  # fmt: skip
