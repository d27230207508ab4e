"""Plant every effect of the catalogue in the raw data of real drives: real noise, real ground, a known answer.

`plan`: diagnose the untouched drive, and list the effects that it can show. `diagnosed`: plant and diagnose one of
them. `run`: all drives of a folder. Findings are judged relative to those of the untouched drive.
"""

import time
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from drd.config.schema import ConfigError
from drd.effects.catalogue import catalogue
from drd.effects.effect import Effect, Values
from drd_tools.diagnose.analysis import Analysis, analyse
from drd_tools.diagnose.regression.refine import refine
from drd_tools.diagnose.results import Amount
from drd_tools.diagnose.run import concluded, in_one_thread
from drd_tools.diagnose.select.search import Found
from drd_tools.diagnose.selected import Selected
from drd_tools.recordings.folder import Recording, read_recording
from drd_tools.simulate.files import effect_rows
from drd_tools.trial.ceiling import set_ceilings
from drd_tools.trial.overlay import planted
from drd_tools.trial.plan import is_chosen
from drd_tools.trial.results import FAILED, Planted, Row, TrueEffect, Untouched, si
from drd_tools.trial.size import Whitener, selected_of
from drd_tools.trial.workers import Call, completed

DISTANCES: Final = (12.0, 25.0)
MOST_JOBS: Final = 2  # each keeps a diagnosis in memory
UNTOUCHED: Final = "untouched"


def drives(folder: Path, pattern: str) -> list[Path]:
    """List the recordings of a folder whose names match and which have wheels. Raises ConfigError if there is none."""
    found = sorted(p.parent for p in folder.glob(f"{pattern}/robot.yaml") if (p.parent / "encoders.csv").exists())
    if not found:
        raise ConfigError(str(folder), "--glob", "recordings with robot.yaml and encoders.csv", f"none with {pattern}")
    return found


def run(
    folders: Sequence[Path], seed: int, done: Sequence[Row], jobs: int, only: Sequence[str] = ("*",)
) -> Iterator[Row]:
    """Yield rows as they become ready, except those `done`: drives, and effects in them whose names match `only`."""
    there = {row.case for row in done}
    by_name = {folder.name: folder for folder in folders}

    def then(row: Row) -> list[Call[Row]]:
        if not isinstance(row, Untouched):
            return []
        folder = by_name[row.case]
        chosen = (case for case in row.plantings if is_chosen(case, only))
        todo = [(case, row.plantings[case]) for case in chosen if case not in there]
        return [partial(diagnosed, folder, case, true, row.lag_s) for case, true in todo]

    todo: list[Call[Row]] = [partial(plan, folder, seed) for name, folder in by_name.items() if name not in there]
    todo += [call for row in done if row.case in by_name for call in then(row)]
    return completed(todo, min(jobs, MOST_JOBS), then)


def plan(folder: Path, seed: int) -> Untouched:
    """Diagnose a drive as it is, and size each effect for each of DISTANCES."""
    recording = read_recording(folder)
    said, analysis = _diagnosed(recording)
    if analysis is None:
        return Untouched(case=folder.name, kind=UNTOUCHED, effects=[], plantings={}, not_visible=[], **said)
    plantings, not_visible = _plantings(recording, analysis, seed)
    return Untouched(
        case=folder.name,
        kind=UNTOUCHED,
        effects=[],
        plantings=plantings,
        not_visible=not_visible,
        lag_s=analysis.measured.lag_s,
        **said,
    )


def _plantings(recording: Recording, analysis: Analysis, seed: int) -> tuple[dict[str, TrueEffect], list[str]]:
    """Effects to plant, by case, and the cases that this drive cannot show."""
    whitener, plantings, not_visible = Whitener.of(analysis), {}, []
    for effect in (x for x in catalogue().values() if x.is_diagnosed):
        for d in DISTANCES:
            # The same shape at each distance, independent of the other effects in the catalogue.
            random = np.random.default_rng([seed, zlib.crc32(f"{recording.name}.{effect.id}".encode())])
            case = f"{recording.name}.{effect.id}.d{d:g}"
            sized = whitener.plantable(effect, d, random)
            if sized is None:
                not_visible.append(case)
                continue
            (row,) = effect_rows([(effect, sized[0])])
            own = _own(analysis.conclusion.found, effect, sized[0])
            plantings[case] = true = TrueEffect(**row, detectability=sized[1], own=own)
            set_ceilings(whitener.problem, selected_of([(effect, sized[0])]), [true], whitener.beside)
    return plantings, not_visible


def _own(found: Found, effect: Effect, values: Values) -> dict[str, Amount]:
    """Sizes that an effect of the planted form already has in the untouched drive, reported or not."""
    linear = {q.name: q for q in effect.parameters if q.linear and not q.choices}
    if effect.id in {c.id for c in found.fit.selection} or not linear:
        return {}
    of_form = Selected(effect, {**values, **dict.fromkeys(linear, 0.0)}, tuple(linear))
    fitted = refine(found.problem, [*found.fit.selection, of_form]).selection[-1]
    return {name: Amount(fitted.number(name) / q.si, fitted.sigma(name) / q.si, q.unit) for name, q in linear.items()}


def diagnosed(folder: Path, case: str, true: TrueEffect, lag_s: float) -> Planted:
    """Plant an effect in a drive whose reference is late by `lag_s`, and diagnose it."""
    recording = planted(read_recording(folder), catalogue()[true.effect], si(true), lag_s)
    said, _ = _diagnosed(replace(recording, folder=Path(case)))
    return Planted(case=case, kind=f"planted {case.rpartition('.')[2]}", effects=[true], base=folder.name, **said)


def _diagnosed(recording: Recording) -> tuple[dict[str, Any], Analysis | None]:
    """Fields of a record, and the analysis, or None if it failed."""
    began_s, analysis = time.perf_counter(), None
    try:
        with in_one_thread():
            made = analyse(recording)
            result = concluded(made).result
        said: dict[str, Any] = {"verdict": result.verdict.value, "findings": result.findings}
        analysis = made
    except Exception as error:  # a diagnosis that fails is a result of the trial
        said = {"verdict": FAILED, "findings": (), "error": f"{type(error).__name__}: {error}"}
    return {**said, "took_s": time.perf_counter() - began_s}, analysis
