"""Read poses and their reference, and bring them to common times."""

from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from drd.arrays import Array
from drd.config.schema import ConfigError
from drd.estimation.covariance import of_upper
from drd.units import RAD_PER_DEG
from drd_tools.recordings.folder import (
    BOUND,
    COVARIANCE,
    ESTIMATES,
    POSES,
    VALID,
    Recording,
    continuous_rad,
    file_hash,
    read_recording,
    read_table,
    wrapped,
)
from drd_tools.recordings.path_length import path_length_m

HEADERS: Final = tuple(
    (*POSES, *covariance, *bound) for covariance, bound in product(((), COVARIANCE), ((), (BOUND,), (BOUND, VALID)))
)
MAX_GAP_S: Final = 1.0  # longest gap to interpolate over: 20 poses, which may be lost
DENSE_S: Final = 2.0  # a reference with this median step, or a finer one, determines the path length alone


@dataclass(frozen=True)
class Poses:
    """Estimated poses: `time_s` (n,), `pose` (n, 3) of x_m, y_m, heading_rad (continuous).

    `covariance` (n, 3, 3), of x, y and heading, m and rad, and `bound_m` (n,), the claimed 99 % radius, if known.
    """

    name: str
    time_s: Array
    pose: Array
    covariance: Array | None = None
    bound_m: Array | None = None
    sha256: str = ""


@dataclass(frozen=True)
class Reference:
    """Reference poses, as `Poses`, with the standard deviations of a coordinate and of the heading (0: unknown).

    `temperature`: times and gyro temperatures, shape (m,) each, if the recording has them.
    """

    name: str
    time_s: Array
    pose: Array
    position_sigma_m: float = 0.0
    heading_sigma_rad: float = 0.0
    temperature: tuple[Array, Array] | None = None
    sha256: str = ""


@dataclass(frozen=True)
class Pairs:
    """Estimate and reference at the reference's times, k rows.

    `time_s` (k,), `estimate` and `reference` (k, 3), `covariance` (k, 3, 3), `bound_m` (k,); `travelled_m` (k,), the
    path length since the first row. `outside` and `in_gaps` count the reference's rows without an estimate.
    """

    time_s: Array
    estimate: Array
    reference: Array
    covariance: Array | None
    bound_m: Array | None
    travelled_m: Array
    is_dense: bool
    outside: int
    in_gaps: int

    @property
    def error(self) -> Array:
        """Estimate minus reference, shape (k, 3), m and rad. The heading error is continuous along the rows."""
        difference = self.estimate - self.reference
        difference[:, 2] = np.unwrap(wrapped(difference[:, 2]))
        return difference


def poses_of_rows(name: str, rows: Array, sha256: str = "") -> Poses:
    """Poses from rows (n, columns) with the columns ESTIMATES, but the heading in rad, continuous."""
    covariance = of_upper(rows[:, [ESTIMATES.index(column) for column in COVARIANCE]])
    return Poses(name, rows[:, 0], rows[:, 1:4], covariance, rows[:, ESTIMATES.index(BOUND)], sha256)


def read_poses(file: Path) -> Poses:
    """Read a CSV file of poses. Raises ConfigError with file, line and column."""
    table = read_table(file, HEADERS, rows=2)
    values = dict(zip(table.header, table.values.T, strict=True))
    covariance = None
    if COVARIANCE[0] in values:
        covariance = of_upper(np.column_stack([values[name] for name in COVARIANCE]))
        broken = np.flatnonzero(~_is_covariance(covariance))
        if broken.size:
            where, columns = f"{file}:{table.line[int(broken[0])]}", f"{COVARIANCE[0]} to {COVARIANCE[-1]}"
            raise ConfigError(where, columns, "a covariance", "a matrix with a negative eigenvalue")
    if BOUND in values and (values[BOUND] < 0.0).any():
        raise table.refuse(int(np.argmax(values[BOUND] < 0.0)), BOUND, "a radius of at least 0")
    pose = np.column_stack([values["x_m"], values["y_m"], continuous_rad(values["heading_deg"])])
    return Poses(file.stem, values["time_s"], pose, covariance, values.get(BOUND), file_hash(file))


def _is_covariance(matrices: Array) -> npt.NDArray[np.bool_]:
    """Whether matrices have no negative eigenvalue, apart from the rounding of printed digits."""
    positive: npt.NDArray[np.bool_] = least_eigenvalues(matrices) > -1e-3
    return positive & (matrices[:, range(3), range(3)] >= 0.0).all(axis=1)


def least_eigenvalues(S: Array) -> Array:
    """Least eigenvalues, (k,), of the correlation matrices of covariances (k, d, d), where units do not matter."""
    sigma = np.sqrt(np.maximum(np.diagonal(S, axis1=1, axis2=2), 1e-30))
    return np.asarray(np.linalg.eigvalsh(S / sigma[:, :, None] / sigma[:, None])[:, 0])


def read_reference(
    path: Path, position_sigma_m: float | None = None, heading_sigma_deg: float | None = None
) -> Reference:
    """Read a recording folder or a reference.csv. Given sigmas override those of robot.yaml. Raises ConfigError."""
    if not path.is_dir():
        time_s, x_m, y_m, heading_deg = read_table(path, (POSES,), rows=2).values.T
        pose = np.column_stack([x_m, y_m, continuous_rad(heading_deg)])
        sigma_rad = (heading_sigma_deg or 0.0) * RAD_PER_DEG
        return Reference(path.stem, time_s, pose, position_sigma_m or 0.0, sigma_rad, None, file_hash(path))
    return reference_of(read_recording(path), position_sigma_m, heading_sigma_deg)


def reference_of(
    recording: Recording, position_sigma_m: float | None = None, heading_sigma_deg: float | None = None
) -> Reference:
    """Reference of a recording. Raises ConfigError if there is none."""
    log, sheet, fog = recording.reference, recording.nominal, recording.fog
    if log is None or len(log.time_s) < 2:
        got = "none" if log is None else "1"
        raise ConfigError(str(recording.folder), "reference.csv", "a reference of at least 2 rows", got)
    sigma_m = sheet.reference_position_sigma_m if position_sigma_m is None else position_sigma_m
    sigma_deg = sheet.reference_heading_sigma_deg if heading_sigma_deg is None else heading_sigma_deg
    return Reference(
        recording.name,
        log.time_s,
        np.column_stack([log.x_m, log.y_m, log.heading_rad]),
        sigma_m or 0.0,
        (sigma_deg or 0.0) * RAD_PER_DEG,
        (fog.time_s, fog.temperature_c) if fog is not None and fog.temperature_c is not None else None,
        next((digest for name, digest in recording.sha256.items() if name.endswith("reference.csv")), ""),
    )


def associate(poses: Poses, reference: Reference, max_gap_s: float) -> Pairs:
    """Bring the estimate to the reference's times: linear interpolation, the heading unwrapped.

    A reference row is left out if it is before the first or after the last estimate (nothing is extrapolated), or
    between two estimates more than `max_gap_s` apart. Raises ConfigError if fewer than 2 rows are left.
    """
    at_s, known_s = reference.time_s, poses.time_s
    inside = (at_s >= known_s[0]) & (at_s <= known_s[-1])
    after = np.clip(np.searchsorted(known_s, at_s), 1, len(known_s) - 1)
    exact = np.isin(at_s, known_s)
    near = exact | (known_s[after] - known_s[after - 1] <= max_gap_s)
    kept = inside & near
    if kept.sum() < 2:
        poses_s, reference_s = (f"{t_s[0]:.12g} to {t_s[-1]:.12g} s" for t_s in (known_s, at_s))
        got = f"{kept.sum()} (poses {poses_s}, reference {reference_s})"
        raise ConfigError(poses.name, "time_s", f"at least 2 times in common with {reference.name}", got)
    time_s, k = at_s[kept], after[kept]
    part = (time_s - known_s[k - 1]) / (known_s[k] - known_s[k - 1])

    def at_times(values: Array) -> Array:
        share = part.reshape(-1, *([1] * (values.ndim - 1)))
        return np.asarray((1.0 - share) * values[k - 1] + share * values[k])

    is_dense = bool(np.median(np.diff(time_s)) <= DENSE_S)
    if is_dense:
        travelled_m = path_length_m(reference.pose[kept, :2], reference.position_sigma_m)
    else:
        travelled_m = at_times(path_length_m(poses.pose[:, :2], 0.0))
        travelled_m = travelled_m - travelled_m[0]
    return Pairs(
        time_s,
        at_times(poses.pose),
        reference.pose[kept],
        None if poses.covariance is None else at_times(poses.covariance),
        None if poses.bound_m is None else at_times(poses.bound_m),
        travelled_m,
        is_dense,
        int((~inside).sum()),
        int((inside & ~near).sum()),
    )
