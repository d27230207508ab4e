"""The pose of each drive with what the robot's other drives tell: by `drd calibrate wheels`, and by model.yaml.

Beside them stands the simplest that can be learned: the gyro's heading with the bias from stops, one scale of the way
and one delay of the wheels, which fit the other drives best.

`python -m held_out_pose RECORDING ...` (in tests/): recordings of one robot with a dense reference. Printed is the rms
of the position, m, on the reference as it would show the robot's centre (`drd_tools.honesty`).
"""

import argparse
import io
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import redirect_stdout
from pathlib import Path

import numpy as np

from drd.arrays import Array
from drd_tools.diagnose.command import main as diagnose
from drd_tools.evaluate.replayed import poses_of
from drd_tools.evaluate.trajectory import reference_of
from drd_tools.honesty import configurations as c
from drd_tools.honesty.baselines import STOPS, baselines, path, travels
from drd_tools.honesty.drives import ROBOTS, at_centre
from drd_tools.honesty.figures import Estimated, Yardstick, figures_of
from drd_tools.recordings.folder import Recording, read_recording
from drd_tools.replay.folder_source import replay_folder

SCALES, DELAYS_S = np.arange(0.91, 1.0, 0.005), (0.1, 0.13, 0.15, 0.17, 0.19)


def rms_m(recording: Recording, config: Path | None, yardstick: Yardstick) -> float:
    """Rms of the daemon's position with a piece of configuration."""
    poses = poses_of(replay_folder(recording, config), recording.name)
    return figures_of(Estimated(poses), yardstick).position_rms_m


def modelled(folders: Sequence[Path], folder: Path) -> Path:
    """A piece of configuration with the model that these recordings have in common."""
    with redirect_stdout(io.StringIO()):
        if diagnose([*map(str, folders), "--output", str(folder)]):
            raise SystemExit("drd diagnose failed")
    made = folder / "config.yaml"
    made.write_text(f"model: {{file: {folder / 'model.yaml'}}}\n")
    return made


def scaled_and_delayed(recording: Recording, yardstick: Yardstick) -> Array:
    """Rms of the position for each of SCALES and DELAYS_S, m: of the gyro's heading, and the way of wheels so late."""
    stops = baselines(recording)[STOPS]
    time_s, left_m, right_m = travels(recording)
    distance_m = 0.5 * np.diff(left_m + right_m)
    found = np.zeros((len(SCALES), len(DELAYS_S)))
    for j, delay_s in enumerate(DELAYS_S):
        heading_rad = np.interp(time_s - delay_s, stops.time_s, stops.pose[:, 2])
        for i, scale in enumerate(SCALES):
            poses = path(STOPS, time_s - delay_s, scale * distance_m, heading_rad)
            found[i, j] = figures_of(Estimated(poses), yardstick).position_rms_m
    return found


def row(recording: Recording, others: Sequence[Recording], models: Mapping[str, Path]) -> dict[str, float]:
    """The drive's figures: nominal, calibrated on the others, and with the models."""
    with tempfile.TemporaryDirectory() as place:
        found = c.calibrate(others, Path(place) / "wheels.yaml")
        configs = {"nominal": None, "calibrate wheels": found.file, **models}
        own = yardstick_of(recording, found)
        figures = {name: rms_m(recording, config, own) for name, config in configs.items()}
        of_others = np.mean([scaled_and_delayed(r, yardstick_of(r, found)) for r in others], axis=0)
        best = np.unravel_index(np.argmin(of_others), of_others.shape)
        return {**figures, "scale and delay": float(scaled_and_delayed(recording, own)[best])}


def yardstick_of(recording: Recording, found: c.Calibration) -> Yardstick:
    """The recording's reference, as it would show the robot's centre."""
    robot = ROBOTS["warthog"]
    return Yardstick(at_centre(reference_of(recording), found.mounting), False, robot.allowed_m, robot.moving_m_s)


def main() -> None:
    """Print each drive's row, and what they have in common."""
    parser = argparse.ArgumentParser(prog="python -m held_out_pose", description=__doc__)
    parser.add_argument("recordings", type=Path, nargs="+", metavar="RECORDING")
    recordings = [read_recording(path) for path in parser.parse_args().recordings]
    rows = []
    with tempfile.TemporaryDirectory() as place:
        of_one = {r.name: modelled([r.folder], Path(place) / r.name) for r in recordings}
        for recording in recordings:
            others = [r for r in recordings if r is not recording]
            models = {"their model": modelled([r.folder for r in others], Path(place) / f"all but {recording.name}")}
            models |= {f"model {k}": of_one[r.name] for k, r in enumerate(others, 1)}
            rows.append(row(recording, others, models))
            print(recording.name, {name: round(value, 3) for name, value in rows[-1].items()}, flush=True)
    for name in rows[0]:
        values = np.array([row[name] for row in rows])
        print(
            f"{name:18} median {np.median(values):.3f}  mean {values.mean():.3f}  rms {np.sqrt(np.mean(values**2)):.3f}"
        )


if __name__ == "__main__":
    main()
