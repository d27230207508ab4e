"""The command line of `drd import`."""

import argparse
from pathlib import Path
from typing import Final

from drd.commands import command, number, whole
from drd_tools.importing.streams import GYRO_UNITS, WHEEL_UNITS

TIME_UNITS: Final = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
POSITIVE: Final = number(0.0, above=True)
DESCRIPTION = """\
Convert another system's recording to a recording folder, as read by `drd replay` and the calibrations, and check it for
the usual pitfalls: wrong gyro axis, wrong signs, swapped sides, degrees instead of radians, clock offsets.

FILE alone lists its contents. It may be
  .bag, .db3, .mcap, or a ROS 2 bag's folder   topics; --gyro TOPIC (Imu, Vector3Stamped), --wheels TOPIC (Odometry,
                JointState, TwistStamped, ...), --reference TOPIC (Odometry, PoseStamped, TransformStamped, ...)
                any other message by its fields: --gyro TOPIC:FIELD, --wheels TOPIC:FIELD,TOPIC:FIELD --wheels-unit U
  a CAN log, .asc, .blf, .trc, candump -l or -ta, python-can's .csv or .db
                --wheels can, decoded as `encoders` of --config CONFIG says
  .bin, .raw, .dat                             --gyro fog: a gyro's bytes, as `fog` of --config CONFIG says
  any other text, CSV or columns               --gyro X,Y,Z or ONE, --wheels LEFT,RIGHT, --reference X,Y,HEADING:
                columns by name or by number from 1, with --time COLUMN and the units
Text and CAN logs may be gzip-compressed (.gz). Gyro, wheels and reference may come from different files.
"""
EPILOG = """\
Options state what the data mean; the checks report whether the data agree. With `auto`, the result of the check is
applied, and the import is refused if the data do not determine it. import.yaml in DIR records sources and findings.

examples:
  drd import run.bag
  drd import run.bag --gyro /imu/data --axis auto --sign auto --wheels /odom --robot robot.yaml --output run
  drd import log.blf --config mybot.yaml --wheels can --gyro-file gyro.csv --gyro rate --gyro-unit deg_s --output run
  drd import imu.log.gz --time 3 --time-unit ms --gyro 7,8,9 --gyro-unit rad --axis x --output run

Exit code: 0 done, 2 bad usage or input, or data that do not determine what was requested
"""


def parser() -> argparse.ArgumentParser:
    """Make the parser of all options."""
    made = command("drd import", DESCRIPTION, EPILOG)
    made.add_argument("file", type=Path, metavar="FILE", help="file to import; alone: list its contents")
    made.add_argument("--output", type=Path, metavar="DIR", help="the recording folder to make")
    _add_streams(made)
    _add_meanings(made)
    _add_robot(made)
    return made


def _add_streams(made: argparse.ArgumentParser) -> None:
    add = made.add_argument_group("what to take").add_argument
    for name, what in (("gyro", "rates"), ("wheels", "wheels' motion"), ("reference", "poses to compare with")):
        add(f"--{name}", metavar="NAME", help=f"topic or columns of the {what}")
    for name in ("gyro", "wheels", "reference"):
        add(f"--{name}-file", type=Path, metavar="FILE", help=f"another file for the {name}")
    add("--config", type=Path, metavar="CONFIG", help="a configuration of the daemon, for CAN frames and gyro bytes")
    add("--channel", help="only this channel of a CAN log")
    add("--time", metavar="COLUMN", help="of a table: the column of times")
    add("--temperature", metavar="COLUMN", help="of a table: the gyro's temperature in degC")
    text = "a side's joints, several with +; default: by their names"
    add("--joints", type=_joints, metavar="LEFT:RIGHT", help=text)
    text = "of an Odometry: its speeds (default), or the differences of its poses"
    add("--wheels-from", choices=("twist", "pose"), default="twist", help=text)
    text = "times of ROS messages: the header's, of the measurement (default), or those of receipt"
    add("--stamps", choices=("header", "receive"), default="header", help=text)


def _add_meanings(made: argparse.ArgumentParser) -> None:
    add = made.add_argument_group("what it means").add_argument
    add("--axis", choices=("x", "y", "z", "auto"), default="z", help="the gyro's vertical axis (default z)")
    add("--sign", choices=("+", "-", "auto"), default="+", help="+: its counter-clockwise is positive (default)")
    add("--swap", choices=("no", "yes", "auto"), default="no", help="exchange left and right (default no)")
    add("--reverse", choices=("left", "right", "both"), help="reverse the sign of these wheels, after --swap")
    text = "the gyro's values; rad and deg: angle since the row before (default rad_s for topics)"
    add("--gyro-unit", choices=GYRO_UNITS, help=text)
    add("--gyro-scale", type=POSITIVE, default=1.0, metavar="F", help="factor on the gyro's values (default 1)")
    text = "of two columns or fields; counts, rad and m: cumulative; twist: speed in m/s and yaw rate in rad/s"
    add("--wheels-unit", choices=WHEEL_UNITS, help=text)
    add("--modulus", type=whole(4), metavar="COUNTS", help="count at which the counters start again")
    add("--heading-unit", choices=("deg", "rad"), help="of a table's reference")
    text = "unit of a table's times: s (default), ms, us, ns, or a number of seconds"
    add("--time-unit", type=_time_unit, default=1.0, metavar="UNIT", help=text)
    for name in ("wheels", "reference"):
        text = f"add this to the {name}' times" if name == "wheels" else f"add this to the {name}'s times"
        add(f"--shift-{name}", type=_shift, default=0.0, metavar="S", help=f"{text}, s; or auto")
    add("--max-lag", type=POSITIVE, default=2.0, metavar="S", help="look for clock offsets up to this, s (default 2)")


def _add_robot(made: argparse.ArgumentParser) -> None:
    add = made.add_argument_group("the robot (robot.yaml)").add_argument
    add("--robot", type=Path, metavar="FILE", help="a robot.yaml; the options below replace its values")
    add("--wheel-radius", type=POSITIVE, metavar="M", help="rolling radius, m")
    add("--tread", type=POSITIVE, metavar="M", help="distance between left and right wheels, m")
    add("--counts-per-revolution", type=POSITIVE, metavar="N", help="counts of one turn of the wheel")
    add("--standstill", type=number(0.0), metavar="S", help="how long the robot stands at first, s")
    add("--name", help="default: the output folder's")


def _time_unit(text: str) -> float:
    return TIME_UNITS[text] if text in TIME_UNITS else POSITIVE(text)


def _shift(text: str) -> float | str:
    return text if text == "auto" else number()(text)


def _joints(text: str) -> tuple[str, str]:
    left, colon, right = text.partition(":")
    if not (left and colon and right) or ":" in right:
        raise argparse.ArgumentTypeError(f"expected LEFT:RIGHT, got {text!r}")
    return left, right
