"""`drd export`: export a recording's poses to other formats."""

import argparse
import importlib.util
import sys
from pathlib import Path
from typing import Final

from drd.commands import command, writing
from drd.config.schema import ConfigError
from drd_tools.export.poses import Exported, read_poses

DESCRIPTION: Final = """\
Export a recording's poses for other programs. RECORDING is a file recorded by the daemon (.mcap; earlier parts of the
same run in its folder are included) or a recording folder. The poses are the published ones or, if the recording has
none (a folder never has), those of `drd replay`. The output says which.

  --ros2     a ROS 2 bag in one MCAP file (profile ros2, CDR): /odom nav_msgs/Odometry, /tf tf2_msgs/TFMessage, /imu
             sensor_msgs/Imu and, of a daemon's recording, /diagnostics; stamps as published
  --csv      time_s (from the daemon's start), x_m, y_m, heading_deg, covariance and bound, as `drd evaluate` takes them
  --tum      TUM trajectory: seconds since 1970 (of a folder: its own time), x y z, quaternion x y z w
  --parquet  everything that a pose says, with names as in the JSON; needs the extra parquet
"""
EPILOG: Final = """\
examples:
  drd export run.mcap --ros2 bag.mcap                 then: ros2 bag play bag.mcap; evo_traj bag2 bag.mcap /odom
  drd export run.mcap --tum run.tum --csv run.csv
  drd export monday/ --parquet monday.parquet

Exit code: 0 done, 1 the recording gives no pose, 2 bad usage or input.
"""


def main(argv: list[str]) -> int:
    """Read once, and write each requested format. Raises ConfigError on bad input."""
    parser = _parser()
    chosen = parser.parse_args(argv)
    forms: dict[str, Path] = {name: getattr(chosen, name) for name in ("ros2", "csv", "tum", "parquet")}
    wanted = {name: file for name, file in forms.items() if file is not None}
    if not wanted:
        parser.error("nothing to write: give --ros2, --csv, --tum or --parquet")
    for name, file in wanted.items():
        _check(name, file, chosen.recording)
    exported = read_poses(chosen.recording)
    if not exported.poses:
        print(f"drd export: {chosen.recording}: no pose", file=sys.stderr)
        return 1
    print(f"{len(exported.poses)} {exported.notes[0]}")
    for note in exported.notes[1:]:
        print(f"note: {note}")
    for name, file in wanted.items():
        with writing(file, "a file to write to"):
            print(f"wrote {file}{_write(name, file, exported)}")
    return 0


def _write(name: str, file: Path, exported: Exported) -> str:
    """Write one format; return a text about it."""
    from drd_tools.export import tables  # noqa: PLC0415  # only loaded if written

    if name == "ros2":
        from drd_tools.export.ros2 import write_bag  # noqa: PLC0415

        counts = write_bag(file, exported)
        return ": " + ", ".join(f"{topic} {count}" for topic, count in counts.items())
    {"csv": tables.write_csv, "tum": tables.write_tum, "parquet": tables.write_parquet}[name](file, exported)
    return ""


def _check(name: str, file: Path, recording: Path) -> None:
    """Check an output before the work starts, so that no recording is overwritten. Raises ConfigError."""
    option = f"--{name}"
    if not file.parent.is_dir():
        raise ConfigError(option, "", "a file in a folder that exists", repr(str(file)))
    if file.resolve() == recording.resolve() or (recording.is_dir() and file.resolve().parent == recording.resolve()):
        raise ConfigError(option, "", "a file that is not in the recording", repr(str(file)))
    if name == "parquet" and importlib.util.find_spec("pyarrow") is None:
        raise ConfigError(option, "", "the Python package pyarrow (pip install 'drd[parquet]')", "none")


def _parser() -> argparse.ArgumentParser:
    parser = command("drd export", DESCRIPTION, EPILOG)
    add = parser.add_argument
    add("recording", type=Path, metavar="RECORDING", help=".mcap file or recording folder")
    add("--ros2", type=Path, metavar="OUT.mcap", help="write a ROS 2 bag")
    add("--csv", type=Path, metavar="OUT.csv", help="write a table for spreadsheets and `drd evaluate`")
    add("--tum", type=Path, metavar="OUT.tum", help="write a TUM trajectory, for evo among others")
    add("--parquet", type=Path, metavar="OUT.parquet", help="write a Parquet table, for pandas and polars")
    return parser
