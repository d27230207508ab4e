"""The pose of each drive with what the robot's other drives tell: by `drd calibrate wheels`, and by model.yaml.

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

from drd_tools.diagnose.command import main as diagnose
from drd_tools.evaluate.replayed import poses_of
from drd_tools.evaluate.trajectory import reference_of
from drd_tools.honesty import configurations as c
from drd_tools.honesty.drives import ROBOTS, at_centre
from drd_tools.honesty.figures import Estimated, Yardstick, figures_of
from drd_tools.recordings.folder import Recording, read_recording
from drd_tools.replay.folder_source import replay_folder


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


def row(recording: Recording, others: Sequence[Recording], models: Mapping[str, Path]) -> dict[str, float]:
    """The drive's figures: nominal, calibrated on the others, and with the models."""
    robot = ROBOTS["warthog"]
    with tempfile.TemporaryDirectory() as place:
        found = c.calibrate(others, Path(place) / "wheels.yaml")
        reference = at_centre(reference_of(recording), found.mounting)
        yardstick = Yardstick(reference, False, robot.allowed_m, robot.moving_m_s)
        configs = {"nominal": None, "calibrate wheels": found.file, **models}
        return {name: rms_m(recording, config, yardstick) for name, config in configs.items()}


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
