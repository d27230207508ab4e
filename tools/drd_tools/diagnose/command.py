"""`drd diagnose`: what physics the nominal model leaves out."""

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

import drd
from drd.model import save_model
from drd.schema import ConfigError
from drd_tools.diagnose import outcome
from drd_tools.diagnose.advise import next_drive
from drd_tools.diagnose.confirm import unseen_rms
from drd_tools.diagnose.diagnose import Diagnosis, diagnose
from drd_tools.diagnose.pool import pooled
from drd_tools.diagnose.report import write_report
from drd_tools.recordings.folder import Recording, read_recording

DESCRIPTION = """\
Find the physics that the nominal model (robot.yaml) leaves out: which effect of the catalogue it is and how sure, what
else it could be, and whether taking it off helps on data that it was not fitted to. Says "nothing" and "unknown" where
that is the truth.

RECORDING is a recording folder; its reference may be full, sparse, start and end only, or absent. The output folder
gets diagnosis.json, model.yaml (for drd replay --model, the daemon and the simulator) and report.html. Several
recordings get a folder each, and what they say together.
"""
EXAMPLES = """\
examples:
  drd diagnose run_07/ --output out/run_07
  drd diagnose monday/ tuesday/ --held-out friday/ --output out/week
  drd replay friday/ --model out/week/model.yaml --output poses.csv
  drd diagnose --draw out/week                              (only the report again)

Exit code: 0 done, whether or not something was found; 2 bad usage or input.
"""


def main(argv: list[str]) -> int:
    """Diagnose, print the findings, write the files. Raises ConfigError on bad input."""
    parser = argparse.ArgumentParser(
        prog="drd diagnose",
        description=DESCRIPTION,
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("recordings", nargs="*", type=Path, metavar="RECORDING", help="recording folders")
    parser.add_argument("--held-out", nargs="+", type=Path, default=[], metavar="RECORDING", help="to prove it on")
    parser.add_argument("--output", type=Path, metavar="DIR", help="folder for the results")
    parser.add_argument("--draw", type=Path, metavar="DIR", help="only draw the report of results that DIR holds")
    chosen = parser.parse_args(argv)
    if chosen.draw is not None:
        return _drawn(chosen.draw)
    if not chosen.recordings or chosen.output is None:
        parser.error("give RECORDING and --output DIR, or --draw DIR")
    recordings = [read_recording(path) for path in chosen.recordings]
    held_out = [read_recording(path) for path in chosen.held_out]
    try:
        chosen.output.mkdir(parents=True, exist_ok=True)
        return _diagnosed(recordings, held_out, chosen.output)
    except OSError as error:
        raise ConfigError(str(chosen.output), "", "a folder to write to", str(error.strerror)) from error


def _diagnosed(recordings: list[Recording], held_out: list[Recording], folder: Path) -> int:
    names = [r.name for r in recordings]
    if len(set(names)) < len(names):
        raise ConfigError("RECORDING", "", "folders of different names", ", ".join(names))
    contents, series = [], []
    for recording in tqdm(recordings, desc="diagnosing", disable=None if len(recordings) > 1 else True, leave=False):
        where = folder if len(recordings) == 1 else folder / recording.name
        where.mkdir(parents=True, exist_ok=True)
        written = _write(diagnose(recording), held_out, where)
        contents.append(written[0])
        series.append(written[1])
        _tell(written[0], where)
    if len(recordings) > 1:
        _write_together(recordings, held_out, contents, series, folder)
    return 0


def _write(result: Diagnosis, held_out: list[Recording], folder: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    conclusion, recording = result.conclusion, result.recording
    found = conclusion.found
    model_file = folder / "model.yaml"
    save_model(model_file, outcome.model_of(conclusion, recording, drd.__version__))
    has_model = any(f.claim is not None for f in conclusion.findings)
    before, nominal = outcome.judged(recording, None)
    after, corrected = outcome.judged(recording, model_file) if has_model else (before, nominal)
    train = {"before": outcome.figures(before), "after": outcome.figures(after)}
    train["before"]["whitened_rms"] = _rms(result.null)
    train["after"]["whitened_rms"] = _rms(found.fit.left)
    proof, bars = _proof(held_out, model_file)
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
    content = {
        "schema": 1,
        "recording": recording.name,
        "verdict": outcome.verdict(conclusion),
        "findings": [outcome.plain_finding(f, found.problem) for f in conclusion.findings],
        "unexplained": {
            "share_of_residual": conclusion.unexplained,
            "end_error_m": after.end.position_m if after is not None else None,
        },
        "ruled_out": conclusion.ruled_out,
        "detectable": conclusion.detectable,
        "classes": conclusion.classes,
        "fit": {"train": train, "held_out": proof},
        "next_drive": next_drive(result),
    }
    outcome.write_json(folder / "diagnosis.json", content)
    e = found.problem.evidence
    paths = outcome.paths(recording, nominal, corrected if has_model else None)
    series = {
        "format": "drd-diagnosis-series/1",
        "recordings": [
            {
                "name": recording.name,
                "duration_s": float(e.time_s[-1] - e.time_s[0]),
                "path_m": float(0.5 * e.travel_m.sum()),
                "path": paths,
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


def _proof(held_out: list[Recording], model: Path) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """What the model makes of recordings that it was not fitted to."""
    proof: dict[str, Any] = {"before": {}, "after": {}}
    bars = []
    for other in held_out:
        first, second = (outcome.figures(outcome.judged(other, m)[0]) for m in (None, model))
        proof["before"][other.name], proof["after"][other.name] = first, second
        for q in first:
            quantity, unit = q.rsplit("_", 1)
            unit = "%" if unit == "percent" else unit
            bars.append({"name": other.name, "quantity": quantity.replace("_", " "), "unit": unit,
                         "before": first[q], "after": second[q]})  # fmt: skip
    return proof, bars


def _write_together(
    recordings: list[Recording],
    held_out: list[Recording],
    contents: list[dict[str, Any]],
    series: list[dict[str, Any]],
    folder: Path,
) -> None:
    """What several recordings say, beside each one's own folder."""
    content = pooled(contents)
    model = outcome.model_of_findings(content["findings"], recordings[0], content["recording"], drd.__version__)
    save_model(folder / "model.yaml", model)
    content["fit"]["held_out"], bars = _proof(held_out, folder / "model.yaml")
    outcome.write_json(folder / "diagnosis.json", content)
    by_effect = {f["effect"]: f for one in reversed(series) for f in one["findings"]}
    whole = {
        **series[0],
        "recordings": [r for one in series for r in one["recordings"]],
        "findings": [by_effect[f["effect"]] for f in content["findings"]],
        "held_out": bars,
    }
    outcome.write_json(folder / "series.json", whole)
    _tell(content, folder)


WORDS = {
    outcome.NOTHING: "nothing is missing: the nominal model explains the recording up to its noise",
    outcome.EXPLAINED: "explained",
    outcome.PARTLY: "partly explained",
    outcome.UNKNOWN: "something is missing that is in no catalogue",
}


def _tell(content: dict[str, Any], folder: Path) -> None:
    print(f"{content['recording']}: {WORDS[content['verdict']]}")
    for finding in content["findings"]:
        evidence = finding["evidence"]
        sure = f"{evidence['gain_nats']:.0f} nats, p {evidence['family_wise_p']:.2g}"
        print(f"  {finding['status']}: {finding['effect']} ({sure})")
        print(f"    {finding['sentence']}")
    if content["next_drive"]:
        print(f"  {content['next_drive'].get('sentence', '')}".rstrip())
    files = [folder / "diagnosis.json", folder / "model.yaml", *write_report(folder)]
    print("  files: " + ", ".join(str(f) for f in files[:3]))


def _drawn(folder: Path) -> int:
    print(", ".join(str(f) for f in write_report(folder)))
    return 0
