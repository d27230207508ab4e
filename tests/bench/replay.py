"""How many times faster than life `drd replay` estimates a recording again: a folder, and an MCAP file."""

import tempfile
import time
from pathlib import Path
from statistics import median

from bench.report import Figure, Refused, Report
from drd.config.schema import Loaded
from drd_tools.emulate.raw import write_mcap
from drd_tools.recordings.folder import read_recording
from drd_tools.replay.folder_source import replay_folder
from drd_tools.replay.mcap_source import replay_mcap
from drd_tools.replay.nominal import configuration
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
        file = Path(folder) / "run.mcap"
        simulated = read_recording(path)
        written = write_mcap(file, simulated, Loaded(configuration(simulated), {}), path)
        read_s, replayed_s, mcap_s, poses, repeated = [], [], [], 0, 0
        for _ in range(repeats):
            began_s = time.perf_counter()
            recording = read_recording(path)
            middle_s = time.perf_counter()
            poses = len(replay_folder(recording).poses)
            read_s.append(middle_s - began_s)
            end_s = time.perf_counter()
            repeated = len(replay_mcap(file).poses)
            replayed_s.append(end_s - middle_s)
            mcap_s.append(time.perf_counter() - end_s)
    if poses < 0.9 * 20.0 * driven_s:
        raise Refused(f"replay: {poses} poses of {driven_s:g} s")
    if repeated != written:
        raise Refused(f"replay: {repeated} poses of an MCAP file with {written}")
    whole_s = median(a + b for a, b in zip(read_s, replayed_s, strict=True))
    return Report(
        f"replay: a drive of {driven_s:g} s as a folder and as an MCAP file, gyro at 10 Hz, encoders at 20 Hz",
        "times real time, from the CSV files to the poses; the estimator alone; from the MCAP file, against the folder",
        (
            Figure("read and replayed", driven_s / whole_s, "x life"),
            Figure("replayed", driven_s / median(replayed_s), "x life"),
            Figure("MCAP read and replayed", driven_s / median(mcap_s), "x life", whole_s / median(mcap_s)),
        ),
    )
