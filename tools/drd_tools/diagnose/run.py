"""Recordings diagnosed and their files written: one here, several in processes of their own."""

import multiprocessing
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits
from tqdm import tqdm

import drd
from drd.effects.catalogue import catalogue
from drd.schema import ConfigError
from drd_tools.diagnose import outcome
from drd_tools.diagnose.advise import next_drive
from drd_tools.diagnose.confirm import unseen_rms
from drd_tools.diagnose.diagnose import Diagnosis, diagnose
from drd_tools.diagnose.evidence import Evidence
from drd_tools.diagnose.joint import Share, share_of
from drd_tools.diagnose.library import AUDITED
from drd_tools.diagnose.prove import judged, save_proven
from drd_tools.diagnose.report import write_report
from drd_tools.recordings.folder import Recording

CUT_S: Final = 60.0
Content = dict[str, Any]


class Written(NamedTuple):
    """diagnosis.json and series.json of a recording, the files that were written, and its part in what several say."""

    content: Content
    series: Content
    files: list[Path]
    share: Share


def run_all(
    recordings: Sequence[Recording], held_out: Sequence[Recording], folders: Sequence[Path], jobs: int
) -> Iterator[Written]:
    """Diagnose each recording into its folder; results in the order given, the same to the bit for any `jobs`.

    Raises ConfigError and OSError.
    """
    if len(recordings) == 1:
        yield run(recordings[0], held_out, folders[0])
        return
    context = multiprocessing.get_context("spawn")  # a forked child of a process with threads may lock up
    with (
        ProcessPoolExecutor(min(jobs, len(recordings)), context) as pool,
        tqdm(total=len(recordings), desc="diagnosing", unit="recording", disable=None, leave=False) as bar,
    ):
        futures = [pool.submit(_apart, r, held_out, f) for r, f in zip(recordings, folders, strict=True)]
        for future in futures:
            future.add_done_callback(lambda _: bar.update())
        try:
            for future in futures:
                made = future.result()
                if not isinstance(made, Written):
                    raise ConfigError(*made)
                yield made
        except BrokenProcessPool as error:
            got = "a process that was killed: with --jobs 1 each has all of the memory"
            raise ConfigError(", ".join(r.name for r in recordings), "", "a diagnosis", got) from error
        finally:
            pool.shutdown(cancel_futures=True)


def _apart(recording: Recording, held_out: Sequence[Recording], folder: Path) -> Written | tuple[str, str, str, str]:
    """As `run`; what a ConfigError says comes back as it is, since the error itself cannot be sent."""
    try:
        return run(recording, held_out, folder)
    except ConfigError as error:
        return error.where, error.path, error.expected, error.got


def run(recording: Recording, held_out: Sequence[Recording], folder: Path) -> Written:
    """Diagnose a recording and write all files into `folder`. Raises ConfigError and OSError."""
    folder.mkdir(parents=True, exist_ok=True)
    # So small products are no sooner done by two threads, and their sums would depend on the processors.
    with threadpool_limits(limits=1):
        result = diagnose(recording)
        content, series = _write(result, held_out, folder)
    found = result.conclusion.found
    files = [folder / "diagnosis.json", folder / "model.yaml", *write_report(folder)]
    return Written(content, series, files, share_of(found.problem, found.fit))


def _write(result: Diagnosis, held_out: Sequence[Recording], folder: Path) -> tuple[Content, Content]:
    conclusion, recording = result.conclusion, result.recording
    found = conclusion.found
    model_file = folder / "model.yaml"
    findings = [outcome.plain_finding(f, found.problem) for f in conclusion.findings]
    make = partial(outcome.model_of, conclusion, recording, drd.__version__)
    model, proof, bars = save_proven(model_file, make, findings, held_out)
    has_model = bool(model.terms)
    before, nominal = judged(recording, None)
    after, corrected = judged(recording, model_file) if has_model else (dict(before), nominal)
    train = {"before": before, "after": after}
    train["before"]["whitened_rms"] = _rms(result.null)
    train["after"]["whitened_rms"] = _rms(found.fit.left)
    unseen = unseen_rms(found.problem, found.fit)
    for name, value in zip(("before", "after"), unseen, strict=True):
        proof[name]["other half of the blocks"] = {"whitened_rms": value}
    bars.append(
        {
            "name": "other half of the blocks",
            "quantity": "whitened rms",
            "unit": "1",
            "before": unseen[0],
            "after": unseen[1],
        }
    )
    e = found.problem.evidence
    content = {
        "schema": 1,
        "recording": recording.name,
        "verdict": outcome.verdict(conclusion),
        "findings": findings,
        "unexplained": {"share_of_residual": conclusion.unexplained, "end_error_m": after.get("end_error_m")},
        "ruled_out": conclusion.ruled_out,
        "detectable": conclusion.detectable,
        "not_observable": not_observable(e, {*conclusion.detectable, *(f["effect"] for f in findings)}),
        "classes": conclusion.classes,
        "fit": {"train": train, "held_out": proof},
        "next_drive": next_drive(result),
    }
    if (cut := cut_off(recording, e)) is not None:
        content["cut"] = cut
    outcome.write_json(folder / "diagnosis.json", content)
    series = {
        "format": "drd-diagnosis-series/1",
        "recordings": [
            {
                "name": recording.name,
                "duration_s": float(e.time_s[-1] - e.time_s[0]),
                "path_m": float(0.5 * e.travel_m.sum()),
                "path": outcome.paths(recording, nominal, corrected if has_model else None),
            }
        ],
        "findings": [outcome.plain_series(f) for f in conclusion.findings],
        "residual": outcome.residual_series(result.null, conclusion, result.null_problem),
        "held_out": bars,
        "noise": result.noise_ratios(),
    }
    outcome.write_json(folder / "series.json", series)
    return content, series


def _rms(rows: Any) -> float:
    return float(np.sqrt(np.mean(rows**2))) if len(rows) else 0.0


def cut_off(recording: Recording, e: Evidence) -> str | None:
    """What is said where a recording is longer than what can be looked at."""
    ends_s = [float(log.time_s[-1]) for log in (recording.fog, recording.wheels) if log is not None]
    end_s, begin_s = min(ends_s), float(e.edges_s[0])
    if end_s - e.time_s[-1] < CUT_S:
        return None
    seen_min, whole_min = (e.time_s[-1] - begin_s) / 60.0, (end_s - begin_s) / 60.0
    return f"only the first {seen_min:.0f} of {whole_min:.0f} minutes were looked at"


def not_observable(e: Evidence, seen: set[str]) -> list[dict[str, str]]:
    """Effects of which the recording says nothing, whatever their size. `seen`: those that it would show."""
    no_wheels = "the recording has no wheel encoders"
    missing = {"gyro": "the recording has no gyro", "wheels": no_wheels, "body": no_wheels}
    found = []
    for name, effect in catalogue().items():
        if effect.channel not in e.channels:
            found.append({"effect": name, "because": missing[effect.channel]})
        elif name == "gyro_saturation" and not e.has_wheels:
            found.append({"effect": name, "because": "without wheels nothing tells that the robot turned faster"})
        elif name not in seen and name not in AUDITED:
            because = "nothing in this drive and its reference shows it"
            if effect.driver in ("speed", "acceleration") and not e.travel_m.any():
                because = "without a dense reference or wheels its speed is not known: its error may pass for another's"
            found.append({"effect": name, "because": because})
    return found
