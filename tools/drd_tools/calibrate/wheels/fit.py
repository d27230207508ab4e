"""Least squares for wheel radii and effective tread, from drives that have a reference. (52) to (54)"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from drd.arrays import Array
from drd.config.schema import ConfigError
from drd.estimation.estimate import MEASURED_TREAD, WHEEL_SCALE
from drd.units import RAD_PER_DEG
from drd_tools import robust
from drd_tools.calibrate.wheels.covariance import WHEELS, Covariances, Evidence, covariances, evidence
from drd_tools.calibrate.wheels.drive import Drive, Mounting, Wheels, residuals
from drd_tools.calibrate.wheels.score import Scores, score

# Shared unknowns: mean scale of the wheels, right minus left, tread (all relative to the nominal), and the mounting of
# the reference: forward, left (in treads), heading.
NAMES: Final = ("scale", "difference", "tread", "forward", "left", "heading")
PRIOR: Final = np.array([0.1, 0.1, 1.0, 0.1, 0.1, 10.0 * RAD_PER_DEG])
STEP: Final = np.array([1e-5, 1e-5, 1e-5, 1e-3, 1e-3, 1e-4])
# Unknowns of each recording: time offset in s, and deviation of its heading from the shared mounting. A separate lever
# arm would be confounded with the scale on circles: 1.5 mm of 0.3 m are 0.5 %.
OWN_PRIOR: Final = np.array([0.3, 0.3 * RAD_PER_DEG])
OWN_STEP: Final = np.array([5e-3, 1e-4])
# Values with larger standard deviations are not determined: a tape measure does better.
LIMIT: Final = np.array([0.02, 0.02, 0.10])
# Standard deviations of nominal values where they are used: wheels independent of each other, and tread.
BELIEF: Final = np.array([WHEEL_SCALE / math.sqrt(2.0), WHEEL_SCALE * math.sqrt(2.0), MEASURED_TREAD, 0.0, 0.0, 0.0])
# Where data contradict the model, a step could make the tread or a radius negative.
LEAST: Final = np.array([-0.9, -np.inf, -0.9, -np.inf, -np.inf, -np.inf])
# Least residual within windows if whole turns were counted wrong; real skid steer leaves up to 0.17 rad, 0.13 m.
LOST_RAD: Final = 0.25
LOST_TREADS: Final = 0.25
HUBER: Final = 2.0
MAX_STEPS: Final = 25
CONVERGED: Final = 0.01  # of a standard deviation


@dataclass(frozen=True)
class WheelFit:
    """Wheels, their standard deviations, and which values are determined.

    `sigma`: of left radius, right radius, tread, relative to the value; `narrow_sigma`: the same, not widened for few
    windows; `window_sigma`: from the scatter of the windows alone. `determined`: mean scale, difference, tread;
    one that is not stays nominal. `free_sigma`: of these three if none is held, limited by the prior.
    `correlation`: of difference and tread. `disagreement`: ratio of standard deviations between recordings to those
    between windows, the largest of the three, 0 if there are too few recordings. `mounting`: of the reference, with
    the median time offset; `own`: that of each recording. `white_m`, `white_rad`: scale of the residuals.
    `is_lost`: these are so large that no wheels explain the reference, and nothing is determined.
    """

    wheels: Wheels
    sigma: tuple[float, ...]
    narrow_sigma: tuple[float, ...]
    window_sigma: tuple[float, ...]
    determined: tuple[bool, ...]
    free_sigma: tuple[float, ...]
    correlation: float
    disagreement: float
    mounting: Mounting
    own: tuple[Mounting, ...]
    white_m: tuple[float, ...]
    white_rad: tuple[float, ...]
    windows: int
    is_lost: bool


def check_one_robot(drives: Sequence[Drive]) -> None:
    """Raise ConfigError if the recordings differ in nominal wheels or encoders."""
    first = drives[0]
    for drive in drives[1:]:
        if (drive.nominal, drive.counts_per_revolution) != (first.nominal, first.counts_per_revolution):
            raise ConfigError(
                drive.name,
                "robot.yaml",
                f"the same robot as in {first.name} ({_described(first)})",
                f"another one ({_described(drive)})",
            )


def _described(drive: Drive) -> str:
    counts = "wheel speeds" if drive.counts_per_revolution is None else f"{drive.counts_per_revolution:g} counts a turn"
    return f"radius {drive.nominal.left_radius_m:g} m, tread {drive.nominal.tread_m:g} m, {counts}"


def wheels_of(nominal: Wheels, unknowns: Array) -> Wheels:
    """Wheels for `unknowns` = (scale, difference, tread), relative to `nominal`. (52)"""
    scale, difference, tread = unknowns[:3]
    return Wheels(
        nominal.left_radius_m * (1.0 + scale - 0.5 * difference),
        nominal.right_radius_m * (1.0 + scale + 0.5 * difference),
        nominal.tread_m * (1.0 + tread),
    )


def _mounting(drive: Drive, shared: Array, own: Array) -> Mounting:
    D = drive.nominal.tread_m
    return Mounting(float(own[0]), float(D * shared[3]), float(D * shared[4]), float(shared[5] + own[1]))


@dataclass
class Part:
    """One recording within the fit: its own unknowns, its weights and its noise."""

    drive: Drive
    own: Array
    weights: Array
    white_m: float
    white_rad: float

    def evaluate(self, shared: Array) -> tuple[Array, Array]:
        """Residuals, shape (n, 3), and their derivatives, shape (n, 3, 8), at the current unknowns."""

        def left_over(change: Array) -> Array:
            p, q = shared + change[: len(STEP)], self.own + change[len(STEP) :]
            d = self.drive
            return residuals(d, wheels_of(d.nominal, p), _mounting(d, p, q), self.weights)

        steps = np.concatenate([STEP, OWN_STEP])
        columns = [(left_over(+e) - left_over(-e)) / (2.0 * e.sum()) for e in np.diag(steps)]
        return left_over(np.zeros(len(steps))), np.stack(columns, axis=-1)

    def evidence(self, shared: Array) -> Evidence:
        """Scores and information of the recording at the solution."""
        r, J = self.evaluate(shared)
        beyond = self.weights * np.array([self.white_m**2, self.white_rad**2]) < 1.0 - 1e-9
        along = r[:, :2] / np.maximum(np.hypot(r[:, 0], r[:, 1]), 1e-300)[:, None]
        curvature = np.zeros((len(r), 3, 3))
        across = np.eye(2) - beyond[:, :1, None] * along[:, :, None] * along[:, None, :]
        curvature[:, :2, :2] = self.weights[:, :1, None] * across
        curvature[:, 2, 2] = np.where(beyond[:, 1], 0.0, self.weights[:, 1])
        return evidence(self.drive, r, J, self.weights, curvature)

    def reweigh(self, r: Array) -> None:
        """Set the noise from the residuals' robust deviation, and Huber's weights against jumps."""
        drive = self.drive
        self.white_m = max(drive.position_sigma_m, robust.deviation(r[:, :2], 0.0))
        # If data contradict the model, headings may be wrong by several turns; noise is never more than half of one.
        white_rad = min(robust.deviation(r[:, 2], 0.0), math.pi)
        self.white_rad = max(drive.heading_sigma_rad, white_rad)
        ratio = np.column_stack([np.hypot(r[:, 0], r[:, 1]) / self.white_m, np.abs(r[:, 2]) / self.white_rad])
        huber = np.minimum(1.0, HUBER / np.maximum(ratio, 1e-12))
        self.weights = huber / np.array([self.white_m**2, self.white_rad**2])

    @property
    def is_lost(self) -> bool:
        """Whether the residuals are so large that the wheels explain nothing."""
        return self.white_rad > LOST_RAD or self.white_m > LOST_TREADS * self.drive.nominal.tread_m

    @property
    def cost(self) -> float:
        """Negative log-likelihood of the rows, nats, up to a constant."""
        return len(self.drive.windows[0]) * (2.0 * math.log(self.white_m) + math.log(self.white_rad))


def new_part(drive: Drive) -> Part:
    """Make the part of a recording before any fit, with datasheet weights."""
    weights = np.tile([drive.position_sigma_m**-2, drive.heading_sigma_rad**-2], (len(drive.windows[0]), 1))
    return Part(drive, np.zeros(len(OWN_STEP)), weights, drive.position_sigma_m, drive.heading_sigma_rad)


def solve(parts: list[Part], free: npt.NDArray[np.bool_], start: Array) -> Array:
    """Solve by Gauss-Newton with Huber's weights. If not `free`, wheels stay at 0 and the mounting at its start."""
    shared = start * (free | (np.arange(len(free)) >= WHEELS))
    for _ in range(MAX_STEPS):
        scores: list[Scores] = []
        for part in parts:
            r, J = part.evaluate(shared)
            scores.append(score(r, J, part.weights, part.own, OWN_PRIOR))
            part.reweigh(r)
        A = sum((s.information for s in scores), np.diag(PRIOR**-2.0))[np.ix_(free, free)]
        g = sum((s.gradient for s in scores), shared / PRIOR**2)[free]
        move = np.zeros(len(shared))
        move[free] = -np.linalg.solve(A, g)
        shared = np.maximum(shared + move, LEAST)
        for part, s in zip(parts, scores, strict=True):
            part.own = part.own + s.own_move(move)
        if np.all(move[free] ** 2 < CONVERGED**2 * np.diag(np.linalg.inv(A))):
            break
    return shared


def fit_wheels(
    drives: Sequence[Drive], start: WheelFit | None = None, mounted: Mounting | None = None, limit: Array = LIMIT
) -> WheelFit:
    """Fit the wheels to one or more drives of one robot, by robust least squares over windows.

    `start` is a fit of nearly the same drives, where the search starts. `mounted`: mounting of the reference, if it is
    known. `limit`: standard deviations of mean scale, difference and tread beyond which they stay nominal. Raises
    ConfigError if the drives are not of one robot.
    """
    check_one_robot(drives)
    nominal, parts = drives[0].nominal, [new_part(drive) for drive in drives]
    free, shared = np.ones(len(NAMES), bool), setting_out(drives)
    if start is not None:
        shared[:3] = _relative(nominal, start.wheels)
        free[:3] = start.determined
    if mounted is not None:
        D = nominal.tread_m
        shared[3:], free[3:] = (mounted.forward_m / D, mounted.left_m / D, mounted.heading_rad), False
    shared = solve(parts, free, shared)
    if is_lost := all(part.is_lost for part in parts):
        free[:WHEELS] = False
        shared = solve(parts, free, shared)
    free_sigma = _sigmas(parts, shared, free) if start is None else np.array(start.free_sigma)
    # Undetermined values are held at nominal, the worst first; the others are then conditional on it.
    while True:
        excess = np.where(free[:3], _sigmas(parts, shared, free) / limit, 0.0)
        if excess.max() <= 1.0:
            break
        free[int(excess.argmax())] = False
        shared = solve(parts, free, shared)
    return _result(nominal, parts, shared, free, free_sigma, is_lost)


def setting_out(drives: Sequence[Drive]) -> Array:
    """Starting point of a search: nominal values, with the tread by which turns were counted."""
    unknowns = np.zeros(len(NAMES))
    unknowns[2] = drives[0].counted_by_m / drives[0].nominal.tread_m - 1.0
    return unknowns


def _relative(nominal: Wheels, wheels: Wheels) -> Array:
    left, right = wheels.left_radius_m / nominal.left_radius_m, wheels.right_radius_m / nominal.right_radius_m
    return np.array([0.5 * (left + right) - 1.0, right - left, wheels.tread_m / nominal.tread_m - 1.0])


def _covariances(parts: list[Part], shared: Array, free: npt.NDArray[np.bool_]) -> Covariances:
    return covariances([part.evidence(shared) for part in parts], PRIOR, OWN_PRIOR, free, BELIEF)


def _sigmas(parts: list[Part], shared: Array, free: npt.NDArray[np.bool_]) -> Array:
    """Standard deviations of mean scale, difference and tread, not widened: few windows can determine a value."""
    return np.asarray(np.sqrt(np.max([np.diag(V) for V in _covariances(parts, shared, free).plain], axis=0)))


def _result(
    nominal: Wheels,
    parts: list[Part],
    shared: Array,
    free: npt.NDArray[np.bool_],
    free_sigma: Array,
    is_lost: bool,
) -> WheelFit:
    found = _covariances(parts, shared, free)
    wheels = wheels_of(nominal, shared)
    # Left radius, right radius and tread as functions of the unknowns.
    M = np.array([[1.0, -0.5, 0.0], [1.0, 0.5, 0.0], [0.0, 0.0, 1.0]])
    value = 1.0 + M @ shared[:WHEELS]
    plain, widened = (np.sqrt([np.diag(M @ V @ M.T) for V in some]) / value for some in (found.plain, found.widened))
    V = found.plain[0]
    pair = math.sqrt(V[1, 1] * V[2, 2])
    usual = np.array([np.median([part.own[0] for part in parts]), 0.0])
    return WheelFit(
        wheels,
        tuple(widened.max(axis=0).tolist()),
        tuple(plain.max(axis=0).tolist()),
        tuple(plain[0].tolist()),
        tuple(free[:3].tolist()),
        tuple(free_sigma.tolist()),
        float(V[1, 2] / pair) if pair else 0.0,
        found.disagreement,
        _mounting(parts[0].drive, shared, usual),
        tuple(_mounting(part.drive, shared, part.own) for part in parts),
        tuple(part.white_m for part in parts),
        tuple(part.white_rad for part in parts),
        sum(len(part.drive.windows[1]) for part in parts),
        is_lost,
    )
