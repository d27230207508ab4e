"""How many times faster than life a recording folder is estimated again, as `drd replay` does it."""

import tempfile
import time
from pathlib import Path
from statistics import median

from drd_tools.bench.report import Figure, Refused, Report
from drd_tools.recordings.folder import read_recording
from drd_tools.replay.folder_source import replay_folder
from drd_tools.simulate.files import write_folder
from drd_tools.simulate.missions import make_drive
from drd_tools.simulate.robot import DEFAULT
from drd_tools.simulate.simulator import simulate
from drd_tools.simulate.truth import make_truth


def run(quick: bool) -> Report:
    """Simulate a drive with a gyro at 10 Hz and encoders at 20 Hz, write it, read it, and estimate it again."""
    driven_s, repeats = (60.0, 1) if quick else (3600.0, 3)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run"
        write_folder(simulate(make_truth(make_drive("warehouse", driven_s)), DEFAULT, seed=1), path, {})
        read_s, replayed_s, poses = [], [], 0
        for _ in range(repeats):
            began_s = time.perf_counter()
            recording = read_recording(path)
            middle_s = time.perf_counter()
            poses = len(replay_folder(recording).poses)
            read_s.append(middle_s - began_s)
            replayed_s.append(time.perf_counter() - middle_s)
    if poses < 0.9 * 20.0 * driven_s:
        raise Refused(f"replay: {poses} poses of {driven_s:g} s")
    whole_s = median(a + b for a, b in zip(read_s, replayed_s, strict=True))
    return Report(
        f"replay: a recording folder of {driven_s:g} s, gyro at 10 Hz and encoders at 20 Hz",
        "times real time, from the CSV files to the poses; the estimator alone",
        (
            Figure("read and replayed", driven_s / whole_s, "x life"),
            Figure("replayed", driven_s / median(replayed_s), "x life"),
        ),
    )
