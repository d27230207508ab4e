"""Errors of the estimator's poses against the reference, without and with a model."""

from collections.abc import Iterable
from pathlib import Path
from typing import Final

import msgspec
import numpy as np

from drd.arrays import Array
from drd.config.schema import ConfigError
from drd.effects.catalogue import catalogue
from drd_tools.diagnose.results import Figures, Finding, Verdict
from drd_tools.diagnose.series import Drive, Line, Paths
from drd_tools.diagnose.validate.heading_only import heading_figures
from drd_tools.evaluate.alignment import align
from drd_tools.evaluate.consistency import consistency
from drd_tools.evaluate.metrics import absolute_error, end_error, kitti_drift
from drd_tools.evaluate.trajectory import MAX_GAP_S, associate, poses_of_rows, reference_of
from drd_tools.recordings.folder import ESTIMATES, Recording, ReferenceLog
from drd_tools.replay.folder_source import replay_folder
from drd_tools.replay.nominal import with_model
from drd_tools.replay.result import table

DRAWN_ROWS: Final = 2000  # more than the pixels across a picture
OUTSIDE: Final = "outside_bound_percent"  # of the poses, outside their 99 % bound
MOST_OUTSIDE_PERCENT: Final = 10.0  # 1 is expected; errors are correlated, so that a long excursion is not exceptional
NO_POSES: Final = np.zeros((0, len(ESTIMATES)))


def judged(recording: Recording, model: Path | None) -> tuple[Figures, Array]:
    """Figures against the reference, with a model or without, and the poses (n, columns); none without wheels."""
    rows = replayed(recording, model)
    return figures_of(recording, rows, model), rows


def errors_of(recording: Recording, model: Path | None) -> Figures:
    """Figures against the reference, with a model or without; for a process that need not return the poses."""
    return judged(recording, model)[0]


def replayed(recording: Recording, model: Path | None = None) -> Array:
    """Poses (n, columns) of the estimator, with a model or without; none without wheels. Uses no reference."""
    if recording.wheels is None:
        return NO_POSES
    return table(replay_folder(recording if model is None else with_model(recording, model)))


def figures_of(recording: Recording, rows: Array, model: Path | None = None) -> Figures:
    """Errors of its poses (n, columns) against the reference; empty if they overlap too little.

    Without wheels, errors of the gyro's heading, with a model or without.
    """
    if recording.wheels is None:
        return heading_figures(recording, model)
    if recording.reference is None or len(recording.reference.time_s) < 2 or len(rows) < 2:
        return {}
    reference = reference_of(recording)
    try:
        pairs = associate(poses_of_rows(recording.name, rows), reference, MAX_GAP_S)
    except ConfigError:
        return {}  # start and end only, the start before the first pose
    aligned, alignment = align(pairs, "start")
    absolute, drift = absolute_error(aligned), kitti_drift(pairs)[0]
    inside_99 = consistency(aligned, alignment, reference).inside_99
    found: Figures = {
        "end_error_m": end_error(aligned, None).position_m,
        "position_rms_m": absolute.position_rmse_m,
        "heading_rms_deg": absolute.heading_rmse_deg,
    }
    if drift is not None:
        found["drift_percent"] = drift.percent
    if inside_99 is not None:
        found[OUTSIDE] = 100.0 * (1.0 - inside_99)
    return found


def checked(
    verdict: Verdict, findings: Iterable[Finding], own: Iterable[Figures], held_out: Iterable[Figures]
) -> Verdict:
    """Posterior predictive check: "explained" is withdrawn if poses with the model leave their own 99 % bound. (91)

    `own`: of the recordings of the fit, with the model; `held_out`: of others. Irreversible effects are not held
    against the model; in other recordings, only if they last.
    """
    lost = [effect for f in findings if f.is_named and (effect := catalogue()[f.effect]).irreversible]
    figures = [*(() if lost else own), *(() if any(effect.lasting for effect in lost) else held_out)]
    return verdict if verdict is not Verdict.EXPLAINED or all(map(is_predicted, figures)) else Verdict.PARTLY


def is_predicted(figures: Figures) -> bool:
    """Whether the poses stay within their 99 % bound."""
    return (figures.get(OUTSIDE) or 0.0) <= MOST_OUTSIDE_PERCENT


def paths(recording: Recording, nominal: Array, corrected: Array | None) -> Paths:
    """The paths to be drawn, aligned with the reference's pose at their start."""
    r = recording.reference
    return Paths(
        None if r is None else _line(np.column_stack([r.time_s, r.x_m, r.y_m])),
        path_from(r, nominal),
        None if corrected is None else path_from(r, corrected),
    )


def with_path(drive: Drive, corrected: Line | None) -> Drive:
    """The drive with another corrected path."""
    return msgspec.structs.replace(drive, path=msgspec.structs.replace(drive.path, corrected=corrected))


def path_from(r: ReferenceLog | None, rows: Array) -> Line:
    """The path to be drawn of poses (n, columns), aligned with the reference's pose at their start."""
    return _line(_from_reference(r, rows))


def _from_reference(r: ReferenceLog | None, rows: Array) -> Array:
    """Rotate and shift rows of poses to the reference's pose where both begin."""
    if r is None or not len(rows):
        return rows
    start_s = max(float(r.time_s[0]), float(rows[0, 0]))
    x0, y0, heading = (float(np.interp(start_s, rows[:, 0], rows[:, i])) for i in (1, 2, 3))
    x, y, seen = (float(np.interp(start_s, r.time_s, v)) for v in (r.x_m, r.y_m, r.heading_rad))
    c, s = np.cos(seen - heading), np.sin(seen - heading)
    dx, dy = rows[:, 1] - x0, rows[:, 2] - y0
    return np.column_stack([rows[:, 0], x + c * dx - s * dy, y + s * dx + c * dy])


def _line(rows: Array) -> Line:
    index = np.unique(np.linspace(0, len(rows) - 1, min(len(rows), DRAWN_ROWS)).round().astype(int))
    return Line(*(rows[index, i] for i in range(3)))
