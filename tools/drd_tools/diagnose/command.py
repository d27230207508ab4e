"""The command `drd diagnose`: find the physics that the nominal model leaves out."""

import os
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from drd.commands import command, whole, writing
from drd.config.schema import ConfigError
from drd.effects.catalogue import catalogue
from drd_tools.diagnose.diagnosis import Diagnosis
from drd_tools.diagnose.observe.conventions import check_conventions
from drd_tools.diagnose.observe.evidence import gather
from drd_tools.diagnose.observe.parts import from_its_start, parts
from drd_tools.diagnose.report.page import write_report
from drd_tools.diagnose.report.text import in_words, reference_faults
from drd_tools.diagnose.report.verdict import MOST_IN_WORDS
from drd_tools.diagnose.results import Verdict
from drd_tools.diagnose.run import run_all
from drd_tools.recordings.daemon_log import read
from drd_tools.recordings.folder import Recording

DESCRIPTION = """\
Find the physics that the nominal model (robot.yaml) leaves out: which effects of the catalogue, with what certainty,
which alternatives fit equally well, and whether correcting for them helps on data not used in the fit. Reports
"nothing" or "unknown" where that is the answer.

RECORDING is a recording folder or a file recorded by the daemon (FILE.mcap, optionally with a reference next to it in
FILE.reference.csv: time_s since the daemon's start, as in drd replay, or since 1970; x_m, y_m, heading_deg). The
reference may be full, sparse, start and end only, or absent. Two of gyro, encoders and reference are enough; nothing is
concluded about an absent sensor, and without encoders only the gyro's heading is examined.

The output folder receives diagnosis.json, model.yaml (for drd replay --model, the daemon and the simulator) and
report.html; with several recordings, one such folder for each and the combined result, of which only the model is
validated on the recordings held out. Recordings longer than 20 minutes are diagnosed in parts, as if each were a
recording of its own.
"""
EXAMPLES = """\
examples:
  drd diagnose run_07/ --output out/run_07
  drd diagnose monday/ tuesday/ --held-out friday/ --output out/week
  drd diagnose mybot-20260314T071500Z-1f0c9a55-0001.mcap --output out/morning
  drd replay friday/ --model out/week/model.yaml --output poses.csv
  drd diagnose --draw out/week                              (redraw the report only)

Exit code: 0 done, whether or not something was found; 2 bad usage or input.
"""


def main(argv: list[str]) -> int:
    """Diagnose, print the findings, write the files. Raises ConfigError on bad input."""
    parser = command("drd diagnose", DESCRIPTION, EXAMPLES)
    add, cores = parser.add_argument, os.cpu_count() or 1
    add("recordings", nargs="*", type=Path, metavar="RECORDING", help="folders or .mcap files")
    add("--held-out", nargs="+", type=Path, default=[], metavar="RECORDING", help="recordings to validate the model on")
    add("--jobs", type=whole(1), default=cores, metavar="N", help=f"parallel processes (default: {cores})")
    add = parser.add_mutually_exclusive_group(required=True).add_argument
    add("--output", type=Path, metavar="DIR", help="folder for the results")
    add("--draw", type=Path, metavar="DIR", help="only redraw the report of the results in DIR")
    chosen = parser.parse_args(argv)
    if chosen.draw is not None:
        print(", ".join(map(str, write_report(chosen.draw))))
        return 0
    if not chosen.recordings:
        parser.error("give a RECORDING")
    recordings, held_out = _read(chosen.recordings), _read(chosen.held_out)
    if fitted := {r.folder.resolve() for r in recordings} & {r.folder.resolve() for r in held_out}:
        raise ConfigError("--held-out", "", "other recordings than those of the fit", ", ".join(map(str, fitted)))
    names = ", ".join(r.name for r in recordings)
    pieces = [part for recording in recordings for part in parts(recording)]
    # One part of 20 minutes at a time: each needs half a gigabyte.
    jobs = chosen.jobs if len(pieces) == len(recordings) else 1
    with writing(chosen.output):
        chosen.output.mkdir(parents=True, exist_ok=True)
        for diagnosis, files in run_all(pieces, held_out, chosen.output, jobs, names):
            _tell(diagnosis, files)
    return 0


def _read(paths: Sequence[Path]) -> list[Recording]:
    """Read all input, and check it before minutes of work begin."""
    recordings = [read(path) for path in paths]
    if repeated := [name for name, n in Counter(r.name for r in recordings).items() if n > 1]:
        raise ConfigError("RECORDING", "", "recordings of different names", f"{', '.join(repeated)} more than once")
    for recording in recordings:
        gather(recording)
        check_conventions(recording)
    return [from_its_start(recording) for recording in recordings]


WORDS = {
    Verdict.NOTHING: "nothing is missing: the nominal model explains the recording up to its noise",
    Verdict.EXPLAINED: "explained",
    Verdict.PARTLY: "partly explained",
    Verdict.UNKNOWN: "something outside the catalogue is missing",
}


def _tell(diagnosis: Diagnosis, files: Sequence[Path]) -> None:
    result = diagnosis.result
    print(f"{result.recording}: {WORDS[result.verdict]}")
    for finding in result.findings:
        p = finding.evidence.family_wise_p
        print(f"  {finding.status}: {finding.effect} ({finding.gain_nats:.0f} nats, p {p or 0.0:.2g})")
        print(f"    {in_words(finding)}")
    for noise in result.scatter[:MOST_IN_WORDS]:
        print(f"  noise: {noise.sentence}")
    if (more := len(result.scatter) - MOST_IN_WORDS) > 0:
        print(f"  noise: the report lists {more} more")
    for fault in reference_faults(result):
        print(f"  reference: {fault}")
    if result.next_drive:
        print(f"  {result.next_drive.sentence}".rstrip())
    if result.cut:
        print(f"  {result.cut}: split the recording and diagnose its parts")
    reasons, every = Counter(row.because for row in result.unobservable), catalogue().values()
    for because, count in reasons.items():
        print(f"  {count} of the {sum(e.is_diagnosed for e in every)} effects are not observable: {because}")
    for note in diagnosis.notes:
        print(f"  {note}")
    print("  files: " + ", ".join(str(f) for f in files[:3]))
