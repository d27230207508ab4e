"""Diagnose recordings, one in this process or several in parallel processes, and combine them."""

import tempfile
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Final, NamedTuple

import msgspec
from msgspec import UNSET
from threadpoolctl import threadpool_limits
from tqdm import tqdm

import drd
from drd.arrays import Array
from drd.batch.run import no_garbage
from drd_tools.diagnose.advise.next_drive import next_drive
from drd_tools.diagnose.analysis import Analysis, analyse
from drd_tools.diagnose.combine.expected import Expected, expected
from drd_tools.diagnose.combine.pool import combined, largest
from drd_tools.diagnose.combine.statistics import may_stand_for_shared, sufficient_statistics
from drd_tools.diagnose.conclude import outcome
from drd_tools.diagnose.conclude.confirm import rms, unseen_rms
from drd_tools.diagnose.conclude.identify import not_observable
from drd_tools.diagnose.diagnosis import Diagnosis
from drd_tools.diagnose.observe.parts import cut_off
from drd_tools.diagnose.regression.noise_fit import by_direction
from drd_tools.diagnose.results import Figures, Fit, NextDrive, Result, Scatter, Train, Unexplained
from drd_tools.diagnose.series import Bar, Course, Drive, Series, Spread
from drd_tools.diagnose.validate.held_out import Prepared, prepared
from drd_tools.diagnose.validate.trajectory import checked, figures_of, judged, path_from, paths, replayed, with_path
from drd_tools.diagnose.validate.validation import Validated, validate
from drd_tools.processes import Map, mapped, pool_of
from drd_tools.recordings.folder import Recording

OTHER_HALF: Final = "other half of the blocks"
WHITENED: Final = "whitened_rms"


class Written(NamedTuple):
    """A diagnosis and its files."""

    diagnosis: Diagnosis
    files: list[Path]


def run_all(
    recordings: Sequence[Recording], held_out: Sequence[Recording], folder: Path, jobs: int, names: str
) -> Iterator[Written]:
    """Diagnose one recording into a folder; several into subfolders, in the order given, and then all together.

    The results are bit-identical for any `jobs`. SIGTERM and Ctrl-C end the processes immediately.
    `names`: of all recordings. Raises ConfigError and OSError.
    """
    if len(recordings) == 1:
        with mapped(jobs) as each:
            yield _saved(run(recordings[0], each(prepared, held_out), each=each), folder)
        return
    with (
        pool_of(min(jobs, len(recordings) + len(held_out))) as pool,
        tqdm(total=len(recordings), desc="diagnosing", unit="recording", disable=None, leave=False) as bar,
    ):
        # The longest first, so that no process waits long at the end.
        by_length = sorted(recordings, key=_samples, reverse=True)
        futures = {r.name: pool.submit(_written, r, folder / r.name) for r in by_length}
        for future in futures.values():
            future.add_done_callback(lambda _: bar.update())
        others = pool.map(prepared, held_out)
        made = _in_agreement(recordings, [futures[r.name].result() for r in recordings], folder, pool)
        yield from made
        yield _saved(together(recordings, list(others), [w.diagnosis for w in made], names, pool.map), folder)


def _samples(recording: Recording) -> int:
    return sum(len(log.time_s) for log in (recording.wheels, recording.fog) if log is not None)


def _in_agreement(
    recordings: Sequence[Recording], made: Sequence[Written], folder: Path, pool: Executor
) -> list[Written]:
    """Repeat the diagnosis of each recording in which effects of the others are expected."""
    diagnoses = [w.diagnosis for w in made]
    found = expected([d.result for d in diagnoses], [d.statistics for d in diagnoses if d.statistics is not None])
    again = [
        pool.submit(_written, recording, folder / recording.name, effects) if effects else None
        for recording, effects in zip(recordings, found, strict=True)
    ]
    return [w if new is None else new.result() for w, new in zip(made, again, strict=True)]


def _written(recording: Recording, folder: Path, expected: Sequence[Expected] = ()) -> Written:
    """Diagnose one of several recordings; only the model of all of them is validated on others."""
    return _saved(run(recording, expected=expected), folder)


def _saved(diagnosis: Diagnosis, folder: Path) -> Written:
    return Written(diagnosis, diagnosis.report(folder))


def run(
    recording: Recording, held_out: Iterable[Prepared] = (), expected: Sequence[Expected] = (), each: Map = map
) -> Diagnosis:
    """Diagnose a recording, and validate its model on others. Raises ConfigError."""
    with in_one_thread():
        poses = each(replayed, [recording])  # with processes, while this one analyses
        return concluded(analyse(recording, expected), held_out, poses, each)


@contextmanager
def in_one_thread() -> Iterator[None]:
    """Limit numerical libraries to one thread: two are no faster here, and sums would depend on the processors."""
    with threadpool_limits(limits=1), no_garbage():
        yield


def concluded(
    analysis: Analysis, held_out: Iterable[Prepared] = (), poses: Iterable[Array] | None = None, each: Map = map
) -> Diagnosis:
    """Make the diagnosis from an analysis, with its model validated on other recordings. Raises ConfigError.

    `poses`: one item, the recording's replay with the nominal model, if that is already under way.
    """
    recording, conclusion = analysis.recording, analysis.conclusion
    with tempfile.TemporaryDirectory() as folder:
        model_file, findings = Path(folder) / "model.yaml", outcome.findings_of(conclusion)
        build = partial(outcome.model_of, recording=recording, names=recording.name, version=drd.__version__)
        validated = validate(model_file, build, outcome.terms_found(findings), findings, list(held_out), each)
        corrected = each(partial(replayed, model=model_file), [recording] if validated.model.terms else [])
        answers, unseen = next_drive(conclusion, recording.nominal), _unseen(analysis)
        train, drive = _trained(analysis, poses or map(replayed, [recording]), corrected, model_file)
    scatter, spreads = analysis.scatter()
    result = _result(analysis, validated, train, unseen, scatter, answers)
    series = _series(analysis, validated, drive, unseen, spreads)
    found = conclusion.found
    surrogates = [f.effect for f in validated.findings if may_stand_for_shared(f)]
    statistics = sufficient_statistics(by_direction(found.problem, found.fit), found.fit, surrogates)
    return Diagnosis(result, series, validated.model, statistics, [f.surrogate for f in findings])


def together(
    recordings: Sequence[Recording],
    held_out: Sequence[Prepared],
    made: Sequence[Diagnosis],
    names: str,
    each: Map = map,
) -> Diagnosis:
    """Combine the diagnoses of several recordings, or parts of one. `names`: of all of them."""
    statistics = [d.statistics for d in made if d.statistics is not None]
    result = combined([d.with_stand_ins() for d in made], statistics)
    build = partial(outcome.model_of, recording=recordings[0], names=names, version=drd.__version__)
    with tempfile.TemporaryDirectory() as folder:
        terms = outcome.terms_found([f for f in result.findings if not f.contradicted_by])
        model_file = Path(folder) / "model.yaml"
        validated = validate(model_file, build, terms, result.findings, held_out, each)
        own = _with_common_model(recordings, made, model_file if validated.model.terms else None, each)
    verdict = checked(result.verdict, validated.findings, [figures for figures, _ in own], validated.poses_after)
    after = {f"{drive.name}: {q}": v for figures, drive in own for q, v in figures.items()}
    fit = Fit(Train(result.fit.train.before, result.fit.train.after | after), validated.figures)
    end_m = largest(figures.get("end_error_m") for figures, _ in own)
    unexplained = msgspec.structs.replace(result.unexplained, end_error_m=end_m)
    result = msgspec.structs.replace(
        result,
        recording=names,
        verdict=verdict,
        findings=tuple(validated.findings),
        fit=fit,
        unexplained=unexplained,
    )
    courses = {c.effect: c for d in reversed(made) for c in d.series.findings}
    series = msgspec.structs.replace(
        made[0].series,
        recordings=[drive for _, drive in own],
        findings=[courses.get(f.effect, Course(f.effect)) for f in result.findings],
        held_out=validated.bars,
    )
    return Diagnosis(result, series, validated.model)


def _with_common_model(
    recordings: Sequence[Recording], made: Sequence[Diagnosis], model: Path | None, each: Map
) -> list[tuple[Figures, Drive]]:
    """Figures and path of each recording with the common model instead of its own."""
    drives = [d.series.recordings[0] for d in made]
    if model is None:
        return [(d.result.fit.train.before, with_path(drive, None)) for d, drive in zip(made, drives, strict=True)]
    in_time = [_in_time(r, d.result) for r, d in zip(recordings, made, strict=True)]
    found = zip(each(partial(judged, model=model), in_time), drives, in_time, strict=True)
    return [(figures, with_path(drive, path_from(r.reference, rows))) for (figures, rows), drive, r in found]


def _in_time(recording: Recording, result: Result) -> Recording:
    """The recording with its reference's stamps corrected by the lag found."""
    lag = result.reference.get("lag") if result.reference else None
    if recording.reference is None or lag is None:
        return recording
    return replace(recording, reference=replace(recording.reference, time_s=recording.reference.time_s - lag.value))


def _trained(
    analysis: Analysis, poses: Iterable[Array], corrected: Iterable[Array], model: Path
) -> tuple[Train, Drive]:
    """Figures of the fitted data, without and with the model, and the paths. `corrected` is empty without effects."""
    recording, e = analysis.recording, analysis.conclusion.found.problem.evidence
    (nominal,), with_model = poses, next(iter(corrected), None)
    before = figures_of(recording, nominal)
    after = before if with_model is None else figures_of(recording, with_model, model)
    train = Train(
        {**before, WHITENED: rms(analysis.null)}, {**after, WHITENED: rms(analysis.conclusion.found.fit.left)}
    )
    duration_s, path_m = float(e.time_s[-1] - e.time_s[0]), float(0.5 * e.travel_m.sum())
    return train, Drive(recording.name, duration_s, path_m, paths(recording, nominal, with_model))


def _unseen(analysis: Analysis) -> Bar:
    found = analysis.conclusion.found
    quantity = WHITENED.replace("_", " ")
    return Bar(OTHER_HALF, quantity, "1", *unseen_rms(found.problem, found.fit))


def _result(
    analysis: Analysis,
    validated: Validated,
    train: Train,
    unseen: Bar,
    scatter: Sequence[Scatter],
    answers: NextDrive | None,
) -> Result:
    conclusion, e = analysis.conclusion, analysis.conclusion.found.problem.evidence
    figures = msgspec.structs.replace(
        validated.figures,
        before={**validated.figures.before, unseen.name: {WHITENED: unseen.before}},
        after={**validated.figures.after, unseen.name: {WHITENED: unseen.after}},
    )
    cut = cut_off(analysis.recording, e)
    return Result(
        recording=analysis.recording.name,
        verdict=checked(outcome.verdict(conclusion), validated.findings, [train.after], validated.poses_after),
        findings=tuple(validated.findings),
        unexplained=Unexplained(conclusion.unexplained, train.after.get("end_error_m")),
        ruled_out=conclusion.ruled_out,
        detectable=conclusion.detectable,
        not_observable=not_observable(e, conclusion.detectable, outcome.names_of(validated.findings)),
        classes=conclusion.classes,
        fit=Fit(train, figures),
        next_drive=answers,
        cut=UNSET if cut is None else cut,
        noise=analysis.noise_ratios(),
        scatter=tuple(scatter),
        reference=analysis.reference or UNSET,
        notes=tuple(analysis.recording.notes) or UNSET,
    )


def _series(analysis: Analysis, validated: Validated, drive: Drive, unseen: Bar, spreads: list[Spread]) -> Series:
    return Series(
        recordings=[drive],
        findings=[outcome.course_of(c) for c in analysis.conclusion.causes],
        residual=outcome.residual_of(analysis.null, analysis.null_problem, analysis.conclusion),
        held_out=[*validated.bars, unseen],
        noise=analysis.noise_ratios(),
        scatter=spreads,
    )
