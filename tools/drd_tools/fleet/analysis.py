"""Analyse one recording: read it, diagnose it, and reduce it to its rows of all tables."""

import math
import threading
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

from threadpoolctl import threadpool_limits

from drd.batch.run import zero_for_terms
from drd.units import S_PER_NS
from drd_tools.diagnose.analysis import Analysis, analyse
from drd_tools.diagnose.conclude.cause import Cause
from drd_tools.diagnose.diagnosis import Diagnosis
from drd_tools.diagnose.observe.parts import first_s, parts
from drd_tools.diagnose.results import Finding
from drd_tools.diagnose.run import concluded
from drd_tools.fleet import discover, labels, products
from drd_tools.fleet.task import Rows, Task, about, build, failed
from drd_tools.recordings.daemon_log import SINCE_START_S, read
from drd_tools.recordings.folder import Recording
from drd_tools.recordings.mcap_file import open_run

# A worker with several threads does one recording at a time: the limit on BLAS threads applies to the whole process.
_ALONE: Final = threading.Lock()


def analysed(task: Task) -> Rows | None:
    """Rows of a recording, without labels, or its error if it fails. None: its contents match the task's digest.

    Raises nothing that a recording could cause.
    """
    seen, place, digest, own = task.seen, Path(task.seen.folder) / task.seen.last, "", labels.Labels()
    with _ALONE, threadpool_limits(limits=1):
        try:
            if build() != task.build:
                raise RuntimeError(f"a worker of build {build()}, where {task.build} is asked for: install one drd")
            with discover.fetched(seen) as place:
                digest = discover.contents(place, seen)
                if digest == task.digest:
                    return None
                if seen.labels:
                    own = labels.read_own((place.parent if seen.last else place) / seen.labels)
                return _rows(task, place, digest, own)
        except Exception as error:
            text = f"{type(error).__name__}: {error}".replace(str(place), f"{seen.folder}/{seen.last}".rstrip("/"))
            return failed(task, text, digest, own)


def _rows(task: Task, place: Path, digest: str, own: labels.Labels) -> Rows:
    recording = read(place)
    pieces, rows = parts(recording), Rows()
    own = own.over(_told(place, recording))
    begin_s = first_s(recording)
    missing_s = zero_for_terms(begin_s) if place.is_file() else 0.0  # missing earlier parts of a run
    for piece in pieces:
        name = task.recording if len(pieces) == 1 else f"{task.recording}{piece.name.removeprefix(recording.name)}"
        analysis = analyse(piece)
        diagnosis = concluded(analysis)
        drive = diagnosis.series.recordings[0]
        found = analysis.conclusion.found
        row = about(task, name, digest, own)
        row |= {"duration_s": drive.duration_s, "distance_m": drive.path_m, "verdict": diagnosis.verdict.value}
        row["begins_s"] = missing_s + first_s(piece) - begin_s
        same = {f.effect for f in diagnosis.findings if products.EFFECTS & set(f.also_fits)}
        tables = {
            "recordings": [row],
            "findings": _findings(analysis, diagnosis),
            "constants": products.constants(found.problem, found.fit, same),
            "pose": _pose(diagnosis),
            "products": products.products(found.problem, found.fit),
        }
        for table, made in tables.items():
            more = {"duration_s": drive.duration_s} if table == "constants" else {}
            rows.setdefault(table, []).extend({"recording": name, **more, **own_row} for own_row in made)
    return rows


def _told(place: Path, recording: Recording) -> labels.Labels:
    """Labels from the recording's data, or from the name of a run."""
    reference = recording.reference
    start = labels.start_of_run(place.name)
    if place.is_file():
        start_s = open_run(place).wall_ns * S_PER_NS
    else:
        start_s = float(reference.time_s[0]) if reference is not None and len(reference.time_s) else 0.0
    if start is None and start_s > SINCE_START_S:
        start = datetime.fromtimestamp(start_s, UTC)
    return labels.Labels(robot=recording.nominal.name, start=start)


def _findings(analysis: Analysis, diagnosis: Diagnosis) -> list[dict[str, Any]]:
    rows = []
    causes = {cause.effect: cause for cause in reversed(analysis.conclusion.causes)}
    for number, finding in enumerate(diagnosis.findings):
        about = {
            "number": number,
            "effect": finding.effect,
            "status": finding.status.value,
            "probability": _finite(finding.probability),
            "also_fits": list(finding.also_fits),
            "gain_nats": finding.gain_nats,
            "sentence": finding.sentence,
        }
        covariance = _covariance(finding, causes.get(finding.effect))
        own = [
            {"parameter": name, "value": _finite(a.value), "sigma": _finite(a.std), "unit": a.unit, "covariance": row}
            for (name, a), row in zip(finding.parameters.items(), covariance, strict=True)
        ]
        rows += [{**about, **parameter} for parameter in own or [{}]]
    return rows


def _covariance(finding: Finding, cause: Cause | None) -> Sequence[list[float] | None]:
    """Covariance row of each parameter, in the units of the findings; 0 for one that was not fitted."""
    names = list(finding.parameters)
    selected = None if cause is None else cause.selected
    if selected is None or not selected.covariance.size:
        return [None] * len(names)
    units = {q.name: q.si for q in selected.effect.parameters}
    free = {name: i for i, name in enumerate(selected.free)}
    return [
        [
            float(selected.covariance[free[a], free[b]]) / (units[a] * units[b]) if a in free and b in free else 0.0
            for b in names
        ]
        for a in names
    ]


def _pose(diagnosis: Diagnosis) -> list[dict[str, Any]]:
    train = diagnosis.result.fit.train
    return [
        {"model": model, "figure": figure, "value": value}
        for model, figures in (("nominal", train.before), ("found", train.after))
        for figure, value in figures.items()
    ]


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
