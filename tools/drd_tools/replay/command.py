"""`drd replay`: run the estimator on a recording."""

import argparse
import math
import sys
import time
from pathlib import Path

from drd.commands import command, writing
from drd.config.schema import ConfigError
from drd.units import RAD_PER_DEG
from drd_tools import options
from drd_tools.recordings.folder import Recording, read_recording
from drd_tools.replay.folder_source import replay_folder
from drd_tools.replay.nominal import with_model
from drd_tools.replay.reference import end_error, start_on_reference
from drd_tools.replay.result import ORIGIN, Replayed, Start, write_poses
from drd_tools.replay.summary import summary

DESCRIPTION = """\
Run the daemon's own estimator on a recording. The same input gives bit-identical poses; their SHA-256 is printed.

RECORDING is a file recorded by the daemon (.mcap), or a folder with
  robot.yaml      the nominal robot: wheel.radius_m, wheel.counts_per_revolution, tread_m, fog.*, encoders.*, ...
  encoders.csv    time_s, left_counts, right_counts (cumulative) or time_s, left_rad_s, right_rad_s
  fog.csv         time_s, rate_deg_s[, temperature_c]; the mean since the row before; without it: odometry alone
  reference.csv   time_s, x_m, y_m, heading_deg; optional, never given to the estimator

The output has one row per pose: time_s, x_m, y_m, heading_deg (unwrapped) and the upper triangle of the covariance, in
m and rad. The first row is the start. A JSON file of the same name records the provenance: digest, hashes of the
inputs, configuration in force, counters.
"""
EXAMPLES = """\
examples:
  drd replay run_07/ --output poses.csv
  drd replay run_07/ --config mybot.yaml --calibration gyro/calibration.yaml --output poses.csv
  drd replay run_07/ --model model.yaml --output poses.csv
  drd replay log.mcap --monitor                                (what is wrong with the robot)
  drd replay run_07/ --start=-1.5,2,90 --output poses.csv      (with = where it begins with a minus)

Exit code: 0 done, 1 the recording gives no pose, 2 bad usage or input.
"""


def main(argv: list[str]) -> int:
    """Replay, print the summary, write the poses. Raises ConfigError on bad input."""
    parser = _parser()
    chosen = parser.parse_args(argv)
    began_s = time.perf_counter()
    recording: Recording | None = None
    if chosen.recording.suffix == ".mcap" and not chosen.recording.is_dir():
        if chosen.start == "reference":
            parser.error("--start reference goes with a recording folder that has a reference.csv")
    else:
        recording = read_recording(chosen.recording)
        if chosen.model is not None:
            recording = with_model(recording, chosen.model)
    _check_output(chosen.output, recording)
    if recording is None:
        from drd_tools.replay.mcap_source import replay_mcap  # noqa: PLC0415  # the file's reader, where it is needed

        replayed = replay_mcap(
            chosen.recording,
            config=chosen.config,
            calibration=chosen.calibration,
            model=chosen.model,
            monitors=chosen.monitor,
        )
    else:
        replayed = replay_folder(recording, chosen.config, chosen.calibration, monitors=chosen.monitor)
    if not replayed.poses:
        print(f"drd replay: {chosen.recording}: no pose, for want of wheel samples close in time", file=sys.stderr)
        return 1
    start: Start = chosen.start
    if recording is not None and chosen.start == "reference":
        start = start_on_reference(replayed, recording)
    written = _write(chosen, replayed, start)
    taken_s = time.perf_counter() - began_s
    error = end_error(replayed, recording) if recording is not None else None
    print(summary(replayed, start, error, taken_s))
    if written:
        print(written)
    return 0


def _write(chosen: argparse.Namespace, replayed: Replayed, start: Start) -> str:
    """Write the poses if requested; return a sentence that says so."""
    if chosen.output is None:
        return ""
    files = {name: str(file) for name in ("config", "model", "calibration") if (file := getattr(chosen, name))}
    with writing(chosen.output, "a file to write to"):
        beside = write_poses(chosen.output, replayed, start, {"options": files})
    return f"wrote {chosen.output} and {beside}"


def _parser() -> argparse.ArgumentParser:
    parser = command("drd replay", DESCRIPTION, EXAMPLES, [options.replayed()])
    add = parser.add_argument
    add("recording", type=Path, metavar="RECORDING", help=".mcap file or recording folder")
    text = "pose at the start, or `reference`: pass through its first row (default 0,0,0)"
    add("--start", type=_start, default=ORIGIN, metavar="X_M,Y_M,HEADING_DEG", help=text)
    text = "print what the monitor finds, and whether the live one said the same; it takes longer than the poses"
    add("--monitor", action="store_true", help=text)
    add("--output", type=Path, metavar="POSES.csv", help="file for the poses; POSES.json is written beside it")
    return parser


def _start(text: str) -> Start | str:
    if text == "reference":
        return text
    try:
        x_m, y_m, heading_deg = map(float, text.split(","))
    except ValueError:
        x_m = y_m = heading_deg = math.nan
    if not all(map(math.isfinite, (x_m, y_m, heading_deg))):
        raise argparse.ArgumentTypeError(f"expected x_m,y_m,heading_deg or reference, got {text!r}")
    return Start(x_m, y_m, heading_deg * RAD_PER_DEG)


def _check_output(output: Path | None, recording: Recording | None) -> None:
    """Check the output file before the work starts, so that none of the recording's own is overwritten."""
    if output is None:
        return
    if output.suffix != ".csv":
        raise ConfigError("--output", "", "a file name that ends with .csv", repr(str(output)))
    if not output.parent.is_dir():
        raise ConfigError("--output", "", "a file in a folder that exists", repr(str(output)))
    if recording is not None and any(output.resolve() == (recording.folder / f).resolve() for f in recording.sha256):
        raise ConfigError("--output", "", "a file that is not the recording's own", repr(str(output)))
