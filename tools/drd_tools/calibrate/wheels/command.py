"""`drd calibrate wheels`: radii and tread from recordings with a reference, or from UMBmark's squares."""

from pathlib import Path

from drd.commands import command, number, writing
from drd_tools.calibrate.wheels import recordings, squares

DESCRIPTION = """\
Calibrate the wheels: their radii and the effective tread.

1. From recordings that have a reference (motion capture, lidar, surveyed points; it may be sparse): least squares.
   RECORDING is a folder with robot.yaml, encoders.csv and reference.csv, all of the same robot with the reference
   mounted in the same place. Drive straights, and turns to both sides, as the robot will be driven. With a gyro they
   also give the lag of the wheels behind it, and its noise at standstill (half a minute in total, at least); without
   one, the lag is relative to the reference.
2. From UMBmark: with the nominal wheels, drive a square by odometry alone, five times clockwise and five times
   counter-clockwise, each turn on the spot, all four turns. Each time start at the origin, heading along +x
   (x forward, y left), and measure where the robot stands at the end. RETURNS.csv has a row for each run:
       direction,x_m,y_m
       ccw,0.031,-0.120
       cw,0.018,0.093
   x_m and y_m are the robot's true position minus its position by odometry.

It prints the values with their standard deviations, which of them the data do not determine, and how well the
calibration does on drives that it was not fitted to. DIR receives wheels.yaml (to be merged into the daemon's
configuration, or given as is to `drd replay --config`) and report.html with its pictures.
"""
EXAMPLES = """\
examples:
  drd calibrate wheels runs/circle_* --held-out runs/square_* --output out/wheels
  drd calibrate wheels --umbmark returns.csv --side 4 --tread 0.5 --output out/wheels

Exit code: 0 done, 1 nothing could be determined, 2 bad usage or input.
"""


def main(argv: list[str]) -> int:
    """Calibrate and return the exit code. Raises ConfigError on bad input."""
    parser = command("drd calibrate wheels", DESCRIPTION, EXAMPLES)
    add = parser.add_argument
    add("recordings", nargs="*", type=Path, metavar="RECORDING", help="recordings to fit")
    text = "recordings to test the fit on; without them each recording is tested by a fit of the others"
    add("--held-out", nargs="+", type=Path, default=[], metavar="RECORDING", help=text)
    add("--umbmark", type=Path, metavar="RETURNS.csv", help="return positions of UMBmark's squares")
    add("--side", type=number(0.02, 100.0), metavar="M", help="UMBmark: side of the square, m")
    add("--tread", type=number(0.02, 100.0), metavar="M", help="UMBmark: nominal tread that the robot drove with, m")
    add("--output", type=Path, metavar="DIR", help="folder for wheels.yaml and report.html (required with recordings)")
    chosen = parser.parse_args(argv)
    with writing(chosen.output):
        if chosen.umbmark is not None:
            if chosen.recordings or chosen.held_out:
                parser.error("--umbmark takes no recordings")
            if missing := [f"--{name}" for name in ("side", "tread") if getattr(chosen, name) is None]:
                parser.error(f"--umbmark needs {missing[0]}, in m")
            return squares.calibrate(chosen.umbmark, chosen.side, chosen.tread, chosen.output)
        if not chosen.recordings:
            parser.error("give recordings, or --umbmark RETURNS.csv")
        if chosen.side is not None or chosen.tread is not None:
            parser.error("--side and --tread go with --umbmark; a recording has its own robot.yaml")
        if chosen.output is None:
            parser.error("--output DIR is needed")
        return recordings.calibrate(chosen.recordings, chosen.held_out, chosen.output)
