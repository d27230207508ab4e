"""`drd compare`: recorded sensor increments against those of the nominal model."""

import argparse
from pathlib import Path

from drd.commands import command
from drd_tools.compare.analysis import compare
from drd_tools.compare.report import print_comparison, write_report
from drd_tools.compare.results import Comparison
from drd_tools.options import kept, model, seed
from drd_tools.recordings.daemon_log import read
from drd_tools.recordings.folder import Recording
from drd_tools.replay.nominal import with_model
from drd_tools.report.saved import keep_and_show

DESCRIPTION = """\
Simulate the nominal model along a recording's path and compare recorded with simulated sensor increments, channel by
channel, without assuming a cause: gyro, left and right wheel, their mean (distance) and difference (turn), the turn of
wheels against gyro, and the lateral motion, which the model excludes.

RECORDING is a recording folder (robot.yaml, encoders.csv; optionally fog.csv and reference.csv) or a file recorded by
the daemon (FILE.mcap, optionally with a reference next to it in FILE.reference.csv). The path is the best estimate from
reference and sensors; without a reference it is that of gyro and wheels, and only the turn of wheels against gyro can
be compared.

For each channel: the rms of the mismatch and its expected value from noise alone, the mean, the sum at the end, and how
much of it is predicted by a curve of time, yaw rate, yaw acceleration, speed, acceleration, temperature, heading or
place in blocks that the curve was not fitted to; or "nothing beyond noise".
"""
EXAMPLES = """\
examples:
  drd compare recordings/run1 --output out/run1
  drd compare recordings/run1 --model model.yaml --output out/corrected
  drd compare --draw out/run1

DIR receives results.json, report.html and pictures; --draw redraws report and pictures from results.json.
Exit code: 0 done, whatever was found; 2 bad usage or input.
"""


def main(argv: list[str]) -> int:
    """Compare or draw, print, and return the exit code. Raises ConfigError on bad input."""
    parser = _parser()
    chosen = parser.parse_args(argv)
    if (chosen.recording is None) == (chosen.draw is None):
        parser.error("give a RECORDING, or --draw DIR")
    if chosen.draw is not None and chosen.model is not None:
        parser.error("--model: the results that --draw reads have theirs")
    return keep_and_show(
        chosen,
        Comparison,
        lambda: compare(_read(chosen.recording, chosen.model), chosen.seed),
        print_comparison,
        write_report,
    )


def _read(path: Path, replacing: Path | None) -> Recording:
    recording = read(path)
    assert recording.encoders  # raises if there are none
    return recording if replacing is None else with_model(recording, replacing)


def _parser() -> argparse.ArgumentParser:
    parents = [model(), seed("the simulated noise"), kept()]
    parser = command("drd compare", DESCRIPTION, EXAMPLES, parents)
    parser.add_argument("recording", nargs="?", type=Path, metavar="RECORDING", help="recording folder or .mcap file")
    return parser
