"""Real drives that no threshold was chosen on: the shared ones mirrored left to right, and parts of them.

`python -m other_drives OUT RECORDING ...` (in tests/) writes of each three recordings: NAME_m, mirrored; NAME_a, its
first 65 %; NAME_z, its last 65 %, mirrored. What holds for a robot holds for its mirror image.
"""

import argparse
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from drd_tools.recordings.folder import write_table

Log = npt.NDArray[np.void]
SIDES: Final = (("left_counts", "right_counts"), ("left_rad_s", "right_rad_s"))
SIGNED: Final = ("rate_deg_s", "y_m", "heading_deg")
KINDS: Final = {"m": (True, 0.0, 1.0), "a": (False, 0.0, 0.65), "z": (True, 0.35, 1.0)}  # mirrored; from, to: shares


def mirrored(log: Log) -> Log:
    """The log of the mirror image of the robot on the mirror image of its path."""
    names, made = log.dtype.names or (), log.copy()
    for left, right in SIDES:
        if left in names:
            made[left], made[right] = log[right], log[left]
    for name in SIGNED:
        if name in names:
            made[name] = -log[name]
    return made


def part(log: Log, begin_s: float, end_s: float) -> Log:
    """The rows from `begin_s`, which becomes time 0, to `end_s`."""
    made = log[(log["time_s"] >= begin_s) & (log["time_s"] <= end_s)].copy()
    made["time_s"] -= begin_s
    return made


def write_others(recording: Path, out: Path) -> None:
    """Write the three recordings made of one."""
    logs = {file: np.genfromtxt(file, delimiter=",", names=True) for file in sorted(recording.glob("*.csv"))}
    time_s = logs[recording / "encoders.csv"]["time_s"]
    for kind, (is_mirrored, begin, end) in KINDS.items():
        name = f"{recording.name}_{kind}"
        (out / name).mkdir(parents=True)
        (out / name / "robot.yaml").write_text((recording / "robot.yaml").read_text().replace(recording.name, name))
        begin_s, end_s = (float(time_s[0] + share * (time_s[-1] - time_s[0])) for share in (begin, end))
        for file, log in logs.items():
            made = part(log, begin_s, end_s)
            rows = np.column_stack([(mirrored(made) if is_mirrored else made)[n] for n in log.dtype.names or ()])
            write_table(out / name / file.name, log.dtype.names or (), rows, ",".join(["%.10g"] * rows.shape[1]))


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m other_drives", description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("recordings", type=Path, nargs="+")
    arguments = parser.parse_args()
    for recording in arguments.recordings:
        write_others(recording, arguments.out)


if __name__ == "__main__":
    main()
