"""The steps of a recording: the gyro's rows, or equal ones, with each sensor's readings; gaps are marked."""

import math
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.ndimage import gaussian_filter1d, maximum_filter1d, uniform_filter1d

from drd.arrays import Array, cumulative
from drd.batch.logs import EncoderLog, FogLog
from drd.batch.samples import MISSING_ROWS
from drd.config.schema import ConfigError
from drd_tools.diagnose.observe.events import runs
from drd_tools.recordings.folder import Recording, ReferenceLog

# A fast gyro's rows are summed without loss. Longer steps would not follow the path within a turn.
STEP_S: Final = 0.1
SHORTEST_S: Final = 0.045  # passes references of 20 Hz; of faster ones some rows suffice
MOST_SHARE: Final = 0.55  # of a step: at half, with two fixes per step, nothing grows; the rest is for jitter
WITHIN_SHARE: Final = 1e-6  # of a step: rounding
# Limits time and memory: longer recordings are cut.
MOST_STEPS: Final = 12_000  # 20 minutes at 0.1 s
LONGEST_GAP_S: Final = 86_400.0  # a day: stamps of two clocks, not a gap
BRIDGED_S: Final = 0.25  # of missing gyro rows: too short for a robot to start and end a turn
HOLE_SHARE, WANDER_RAD_S = 0.1, 0.02  # error of the turn in a long gap, as a share and per second
TURNING_RAD_S: Final = 0.01  # 0.6 deg/s: more than a gyro's noise over a second, less than a turn that matters
DENSE_S: Final = 1.0  # rows of a reference this close determine the speed
WAY_SMOOTHING_S: Final = 0.5  # of the reference's positions, whose noise would look like speed
STILL_S: Final = 1.0  # before and after, without a count


class Grid(NamedTuple):
    """Steps that end at `time_s` (n,), each `step_s` (n,) long, with the gyro's readings.

    `bridged_rad2` (n,): variance of the turn in short gaps; `missing_s` (n,): time of each step within a long one.
    """

    time_s: Array
    temperature_c: Array
    step_s: Array
    gyro_rad: Array | None
    bridged_rad2: Array
    missing_s: Array

    def at(self, rows: slice | npt.NDArray[np.bool_] | npt.NDArray[np.intp]) -> "Grid":
        """Select some of the steps."""
        return Grid._make(None if column is None else column[rows] for column in self)


def gyro_grid(recording: Recording, fog: FogLog) -> Grid:
    """Grid of the gyro's rows while there are wheels; fast rows are combined, several to a step."""
    times, log = fog.time_s, recording.wheels
    if len(times) < 2:
        raise ConfigError(str(recording.folder / "fog.csv"), "", "at least 2 rows of numbers", str(len(times)))
    whole = np.diff(times, prepend=2 * times[0] - times[1])
    typical = float(np.median(whole))
    if whole.max() > LONGEST_GAP_S:
        got = f"{whole.max():g} s after {times[int(whole.argmax()) - 1]:.12g}"
        expected = f"rows at most {LONGEST_GAP_S:g} s apart"
        raise ConfigError(str(recording.folder / "fog.csv"), "time_s", expected, got)
    rows = _with_holes_filled(fog, whole, typical)
    if log is not None:
        rows = rows.at((rows.time_s >= log.time_s[0]) & (rows.time_s <= log.time_s[-1] + 1e-9))
    count, together = len(rows.time_s), math.floor(STEP_S / typical + 1e-9)
    if together > 1 and count:
        first = np.arange(0, count, together)
        added = ("step_s", "gyro_rad", "bridged_rad2", "missing_s")
        sums = {name: np.add.reduceat(getattr(rows, name), first) for name in added}
        rows = rows.at(np.append(first[1:], count) - 1)._replace(**sums)
    return rows.at(slice(MOST_STEPS))


def _with_holes_filled(fog: FogLog, whole_s: Array, typical_s: float) -> Grid:
    """Make a step for each row and each missing row; `whole_s` (n,): time since the row before. (68)"""
    # One long step would force the fixes within it onto a line.
    count = np.where(whole_s > MISSING_ROWS * typical_s, np.round(whole_s / typical_s), 1.0).astype(int)
    row = np.repeat(np.arange(len(count)), count)
    later = np.cumsum(count)[row] - 1 - np.arange(len(row))
    step_s = (whole_s / count)[row]
    change = np.diff(fog.rate_rad_s, prepend=fog.rate_rad_s[0])
    bridge = uniform_filter1d(change**2 / count, 3) * count * (count + 1) / 12.0
    rate = fog.rate_rad_s[row] - (change / count)[row] * later
    lost, is_long = later > 0, (whole_s > BRIDGED_S + typical_s)[row]
    celsius = np.full(len(count), np.nan) if fog.temperature_c is None else fog.temperature_c
    bridged_rad2 = lost * ~is_long * bridge[row] * step_s**2
    return Grid(
        fog.time_s[row] - later * step_s, celsius[row], step_s, rate * step_s, bridged_rad2, lost * is_long * step_s
    )


def even_grid(log: EncoderLog, reference: ReferenceLog | None) -> Grid:
    """Grid of equal steps while there are wheels, the first fix at the end of one, so that its noise is not amplified.

    If fixes would lie early in steps, these end at fixes instead, and are nearly equal.
    """
    begin_s, end_s = float(log.time_s[0]), float(log.time_s[-1])
    fix_s = np.zeros(0) if reference is None else reference.time_s
    fix_s = fix_s[(fix_s >= begin_s) & (fix_s <= end_s + 1e-9)]
    since = (fix_s - (fix_s[0] if len(fix_s) else 0.0)) / STEP_S
    if not swings(np.ceil(since - WITHIN_SHARE) - since):
        first = float((fix_s[0] - begin_s) % STEP_S) if len(fix_s) else 0.0
        time_s = np.arange(begin_s + first + STEP_S, end_s + 1e-6 * STEP_S, STEP_S)
        return _gyroless(time_s, np.full(len(time_s), STEP_S))
    kept = [float(fix_s[0])]
    for at_s in fix_s[1:].tolist():
        if at_s - kept[-1] >= SHORTEST_S:
            kept.append(at_s)
    count = np.maximum(np.round(np.diff(kept) / STEP_S), 1.0).astype(int)
    later = np.cumsum(count)[np.repeat(np.arange(len(count)), count)] - 1 - np.arange(count.sum())
    step_s = np.repeat(np.diff(kept) / count, count)
    after_s = np.arange(kept[-1] + STEP_S, end_s + 1e-6 * STEP_S, STEP_S)
    time_s = np.concatenate([np.repeat(kept[1:], count) - later * step_s, after_s])
    return _gyroless(time_s, np.concatenate([step_s, np.full(len(after_s), STEP_S)]))


def _gyroless(time_s: Array, step_s: Array) -> Grid:
    zero = np.zeros(len(time_s))
    return Grid(time_s, zero + np.nan, step_s, None, zero, zero).at(slice(MOST_STEPS))


def swings(share: Array) -> bool:
    """Whether a path that is bent to fixes at these shares of a step before its end oscillates with growing amplitude.

    If no gyro constrains the turns, each linearisation multiplies the amplitude by twice the share.
    """
    return bool(np.any((share > MOST_SHARE) & (share < 1.0 - WITHIN_SHARE)))


def is_dense(reference: ReferenceLog) -> bool:
    """Whether the reference alone determines the speed."""
    return len(reference.time_s) > 2 and float(np.median(np.diff(reference.time_s))) <= DENSE_S


def fixes(recording: Recording, edges: Array, step_s: Array) -> tuple[npt.NDArray[np.intp], Array, Array]:
    """Step, share of a step before its end, and pose of each row of the reference.

    A row of a sparse reference up to a step after the last step belongs to that, at a negative share: it may be the
    only evidence.
    """
    reference, time_s = recording.reference, edges[1:]
    if reference is None:
        return np.zeros(0, np.intp), np.zeros(0), np.zeros((0, 3))
    end_s = time_s[-1] + (0.0 if is_dense(reference) else step_s[-1])
    within = (reference.time_s > edges[0] - 1e-9) & (reference.time_s <= end_s)
    at = reference.time_s[within]
    if not len(at) and (recording.fog is None or recording.wheels is None):
        expected = f"times within {edges[0]:.12g} to {time_s[-1]:.12g} s, when there are sensors"
        raise ConfigError(str(recording.folder / "reference.csv"), "time_s", expected, "none")
    step = np.minimum(np.searchsorted(time_s, at - 1e-9), len(time_s) - 1)
    fix = np.column_stack([reference.x_m, reference.y_m, reference.heading_rad])[within]
    share = (time_s[step] - at) / step_s[step]
    kept = np.ones(len(at), np.bool_)
    if len(at) > MOST_STEPS:  # the last one of each step is enough
        kept = np.append(np.diff(step) > 0, True)
    if recording.fog is None and swings(share):  # rows within steps of `even_grid` are too frequent
        kept &= (share < WITHIN_SHARE) | (share > 1.0 - WITHIN_SHARE)
    return step[kept], share[kept], fix[kept]


def travel(reference: ReferenceLog | None, edges: Array) -> Array:
    """Forward travel in each step, m, from the reference's positions, along its headings; 0 if it is sparse."""
    if reference is None or not is_dense(reference):
        return np.zeros(len(edges) - 1)
    steps = WAY_SMOOTHING_S / float(np.median(np.diff(edges)))
    x, y = (gaussian_filter1d(np.interp(edges, reference.time_s, v), steps) for v in (reference.x_m, reference.y_m))
    heading = np.interp(0.5 * (edges[1:] + edges[:-1]), reference.time_s, reference.heading_rad)
    way: Array = np.diff(x) * np.cos(heading) + np.diff(y) * np.sin(heading)
    return way


def still_by_gyro(grid: Grid, gyro_rad: Array, standstill_s: float) -> npt.NDArray[np.bool_]:
    """Steps of the standstill at the start stated by robot.yaml in which nothing turns."""
    believed = grid.time_s < grid.time_s[0] + standstill_s
    if not believed.any():
        return np.zeros(len(grid.time_s), np.bool_)
    rate = uniform_filter1d(gyro_rad / grid.step_s, max(1, round(STILL_S / float(np.median(grid.step_s)))))
    still: npt.NDArray[np.bool_] = believed & (np.abs(rate - np.median(rate[believed])) < TURNING_RAD_S)
    return still


def still_by_wheels(left_m: Array, right_m: Array, step_s: Array) -> npt.NDArray[np.bool_]:
    """Steps in and near which no wheel has counted, (n,)."""
    steps = max(1, round(STILL_S / float(np.median(step_s))))
    still: npt.NDArray[np.bool_] = maximum_filter1d(np.abs(left_m) + np.abs(right_m), 2 * steps + 1) == 0.0
    return still


def lost_m2(recording: Recording, edges: Array, speed_m_s: Array) -> Array:
    """Variance of each wheel's travel in steps without counts, or with only their sum over a long time."""
    log = recording.encoders
    lost_s = np.diff(np.interp(edges, log.time_s, cumulative(recording.wheel_gaps() * np.diff(log.time_s))))
    if speed_m_s[:2].any():  # else the wheels also stood before their first row
        lost_s[0] += max(float(log.time_s[0] - edges[0]), 0.0)
    return (float(speed_m_s.max()) * np.where(lost_s > 1e-9, lost_s, 0.0)) ** 2


def without_holes(grid: Grid, wheels: tuple[Array, Array] | None) -> tuple[Array | None, Array]:
    """The gyro's turns, with those of the `wheels` in its long gaps, and their variance (n,).

    `wheels`: turns and variance (n,). An error of their tread is common to a whole gap: the variances of its steps add
    up to that. Without wheels the deviation is the usual yaw rate. (68)
    """
    hole, gyro_rad = grid.missing_s > 0.0, grid.gyro_rad
    if gyro_rad is None or not hole.any():
        return gyro_rad, grid.bridged_rad2
    if wheels is None:
        usual_rad_s = float(np.sqrt(np.mean((gyro_rad / grid.step_s)[~hole] ** 2))) if (~hole).any() else 1.0
        wheels = gyro_rad, (usual_rad_s * grid.missing_s) ** 2
    gyro_rad, variance = np.where(hole, wheels[0], gyro_rad), grid.bridged_rad2 + hole * wheels[1]
    turned = np.abs(gyro_rad)
    for first, last in runs(hole):
        variance[first:last] += HOLE_SHARE**2 * turned[first:last].sum() * turned[first:last]
    return gyro_rad, variance + hole * (WANDER_RAD_S * grid.missing_s) ** 2
