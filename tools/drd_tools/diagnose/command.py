"""`drd diagnose`: what physics the nominal model leaves out."""

import argparse
import os
from collections import Counter
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import drd
from drd.effects.catalogue import catalogue
from drd.schema import ConfigError
from drd_tools.diagnose import outcome
from drd_tools.diagnose.evidence import gather
from drd_tools.diagnose.parts import parts
from drd_tools.diagnose.pool import pooled
from drd_tools.diagnose.prove import save_proven
from drd_tools.diagnose.report import write_report
from drd_tools.diagnose.report_text import in_words
from drd_tools.diagnose.run import Written, run_all
from drd_tools.recordings.daemon_log import read
from drd_tools.recordings.folder import Recording

DESCRIPTION = """\
Find the physics that the nominal model (robot.yaml) leaves out: which effect of the catalogue it is and how sure, what
else it could be, and whether taking it off helps on data that it was not fitted to. Says "nothing" and "unknown" where
that is the truth.

RECORDING is a recording folder, or a file that the daemon recorded (FILE.mcap; a reference may lie beside it as
FILE.reference.csv: time_s since the daemon's start, as drd replay counts it, or since 1970; x_m, y_m, heading_deg).
The reference may be full, sparse, start and end only, or absent; gyro or encoders may be absent too, if two of the
three are there. Without encoders only the gyro's heading is judged. Of absent sensors nothing is said.

The output folder gets diagnosis.json, model.yaml (for drd replay --model, the daemon and the simulator) and
report.html.
Several recordings get a folder each, and what they say together. What is longer than about an hour is looked at in
parts, as if they were recordings of their own.
"""
EXAMPLES = """\
examples:
  drd diagnose run_07/ --output out/run_07
  drd diagnose monday/ tuesday/ --held-out friday/ --output out/week
  drd diagnose mybot-20260314T071500Z-1f0c9a55-0001.mcap --output out/morning
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
    parser.add_argument("recordings", nargs="*", type=Path, metavar="RECORDING", help="folders or .mcap files")
    parser.add_argument("--held-out", nargs="+", type=Path, default=[], metavar="RECORDING", help="to prove it on")
    cores = os.cpu_count() or 1
    parser.add_argument(
        "--jobs", type=_jobs, default=cores, metavar="N", help=f"recordings at a time (default: {cores})"
    )
    parser.add_argument("--output", type=Path, metavar="DIR", help="folder for the results")
    parser.add_argument("--draw", type=Path, metavar="DIR", help="only draw the report of results that DIR holds")
    chosen = parser.parse_args(argv)
    if chosen.draw is not None:
        return _drawn(chosen.draw)
    if not chosen.recordings or chosen.output is None:
        parser.error("give RECORDING and --output DIR, or --draw DIR")
    recordings, held_out = _read(chosen.recordings), _read(chosen.held_out)
    names = ", ".join(r.name for r in recordings)
    pieces = [part for recording in recordings for part in parts(recording)]
    # A part of an hour needs the memory of an hour: one at a time.
    jobs = chosen.jobs if len(pieces) == len(recordings) else 1
    try:
        chosen.output.mkdir(parents=True, exist_ok=True)
        return _diagnosed(pieces, held_out, chosen.output, jobs, names)
    except BrokenPipeError:
        raise  # not the folder: whoever read the output has left
    except OSError as error:
        raise ConfigError(str(chosen.output), "", "a folder to write to", str(error.strerror)) from error


def _read(paths: Sequence[Path]) -> list[Recording]:
    """All input, looked at before work begins that takes minutes."""
    recordings = [read(path) for path in paths]
    names = [r.name for r in recordings]
    if len(set(names)) < len(names):
        raise ConfigError("RECORDING", "", "recordings of different names", ", ".join(names))
    for recording in recordings:
        gather(recording)
    return recordings


def _diagnosed(recordings: list[Recording], held_out: list[Recording], folder: Path, jobs: int, names: str) -> int:
    folders = [folder] if len(recordings) == 1 else [folder / r.name for r in recordings]
    made = []
    for recording, written in zip(recordings, run_all(recordings, held_out, folders, jobs), strict=True):
        made.append(written)
        _tell(written.content, written.files, recording.notes)
    if len(recordings) > 1:
        _write_together(recordings, held_out, made, folder, names)
    return 0


def _write_together(
    recordings: list[Recording],
    held_out: list[Recording],
    made: list[Written],
    folder: Path,
    names: str,
) -> None:
    """What several recordings say, or parts of one, beside each one's own folder."""
    content, series = pooled([w.content for w in made], [w.share for w in made]), [w.series for w in made]
    content["recording"] = names
    findings = content["findings"]
    make = partial(outcome.model_of_findings, findings, recordings[0], content["recording"], drd.__version__)
    _, content["fit"]["held_out"], bars = save_proven(folder / "model.yaml", make, findings, held_out)
    outcome.write_json(folder / "diagnosis.json", content)
    by_effect = {f["effect"]: f for one in reversed(series) for f in one["findings"]}
    whole = {
        **series[0],
        "recordings": [r for one in series for r in one["recordings"]],
        "findings": [
            by_effect.get(f["effect"], {"effect": f["effect"], **outcome.NO_CURVE}) for f in content["findings"]
        ],
        "held_out": bars,
    }
    outcome.write_json(folder / "series.json", whole)
    _tell(content, [folder / "diagnosis.json", folder / "model.yaml", *write_report(folder)])


WORDS = {
    outcome.NOTHING: "nothing is missing: the nominal model explains the recording up to its noise",
    outcome.EXPLAINED: "explained",
    outcome.PARTLY: "partly explained",
    outcome.UNKNOWN: "something is missing that is in no catalogue",
}


def _tell(content: dict[str, Any], files: Sequence[Path], notes: Sequence[str] = ()) -> None:
    print(f"{content['recording']}: {WORDS[content['verdict']]}")
    for finding in content["findings"]:
        evidence = finding["evidence"]
        sure = f"{evidence['gain_nats']:.0f} nats, p {evidence['family_wise_p']:.2g}"
        print(f"  {finding['status']}: {finding['effect']} ({sure})")
        print(f"    {in_words(finding)}")
    if content["next_drive"]:
        print(f"  {content['next_drive'].get('sentence', '')}".rstrip())
    if "cut" in content:
        print(f"  {content['cut']}: cut a longer recording, and diagnose its parts")
    reasons = Counter(row["because"] for row in content.get("not_observable", ()))
    for because, count in reasons.items():
        print(f"  nothing can be said of {count} of the {len(catalogue())} effects: {because}")
    for note in notes:
        print(f"  {note}")
    print("  files: " + ", ".join(str(f) for f in files[:3]))


def _jobs(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"expected a whole number of at least 1, got {text!r}")
    return int(text)


def _drawn(folder: Path) -> int:
    print(", ".join(str(f) for f in write_report(folder)))
    return 0
