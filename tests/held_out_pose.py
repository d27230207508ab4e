"""The pose of each drive with what the robot's other drives tell: by `drd calibrate wheels`, and by model.yaml.

Beside them stands, where there is a gyro, the simplest that can be learned: its heading with the bias from stops, one
scale of the way and one delay of the wheels, which fit the other drives best.

`python -m held_out_pose RECORDING ...` (in tests/): recordings of one robot with a dense reference. Printed are the rms
of the position, m, and the drift, %, on the reference as it would show the robot's centre (`drd_tools.honesty`), and by
how much both differ from those by `drd calibrate wheels`, drive for drive: mean and standard error. The centre is where
that calibration puts it, whose lever arm takes a sideways slip for its own where a drive hardly changes its speed.
With `--folds N` drives are held out N-th by N-th, else one by one, and what each other drive tells alone stands there,
too.
"""

import argparse
import io
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import redirect_stdout
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from drd.arrays import Array
from drd_tools.diagnose.command import main as diagnose
from drd_tools.evaluate.replayed import poses_of
from drd_tools.evaluate.trajectory import Poses, reference_of
from drd_tools.honesty import configurations as c
from drd_tools.honesty.baselines import STOPS, baselines, path, travels
from drd_tools.honesty.drives import ROBOTS, at_centre
from drd_tools.honesty.figures import Estimated, Yardstick, figures_of
from drd_tools.recordings.folder import Recording, read_recording
from drd_tools.replay.folder_source import replay_folder

SCALES, DELAYS_S = np.arange(0.91, 1.0, 0.005), (0.1, 0.13, 0.15, 0.17, 0.19)
CALIBRATED: Final = "calibrate wheels"


class Off(NamedTuple):
    """Pose errors: rms of the position over a drive, and drift over its segments, each aligned anew."""

    position_rms_m: float
    drift_percent: float


def off(poses: Poses, yardstick: Yardstick) -> Off:
    """Both figures for an estimate."""
    figures = figures_of(Estimated(poses), yardstick)
    return Off(figures.position_rms_m, np.nan if figures.drift_percent is None else figures.drift_percent)


def replayed(recording: Recording, config: Path | None, yardstick: Yardstick) -> Off:
    """The daemon's figures with a piece of configuration."""
    return off(poses_of(replay_folder(recording, config), recording.name), yardstick)


def modelled(folders: Sequence[Path], folder: Path) -> Path:
    """A piece of configuration with the model that these recordings have in common."""
    with redirect_stdout(io.StringIO()):
        if diagnose([*map(str, folders), "--output", str(folder)]):
            raise SystemExit("drd diagnose failed")
    made = folder / "config.yaml"
    made.write_text(f"model: {{file: {folder / 'model.yaml'}}}\n")
    return made


def scaled_and_delayed(recording: Recording, yardstick: Yardstick) -> Array:
    """`Off` for each of SCALES and DELAYS_S, (18, 5, 2), with the gyro's heading and wheels scaled and delayed so."""
    stops = baselines(recording)[STOPS]
    time_s, left_m, right_m = travels(recording)
    distance_m = 0.5 * np.diff(left_m + right_m)
    found = np.zeros((len(SCALES), len(DELAYS_S), 2))
    for j, delay_s in enumerate(DELAYS_S):
        heading_rad = np.interp(time_s - delay_s, stops.time_s, stops.pose[:, 2])
        for i, scale in enumerate(SCALES):
            poses = path(STOPS, time_s - delay_s, scale * distance_m, heading_rad)
            found[i, j] = off(poses, yardstick)
    return found


def row(recording: Recording, others: Sequence[Recording], models: Mapping[str, Path]) -> dict[str, Off]:
    """The drive's figures: nominal, calibrated on the others, and with the models."""
    with tempfile.TemporaryDirectory() as place:
        found = c.calibrate(others, Path(place) / "wheels.yaml")
        configs = {"nominal": None, CALIBRATED: found.file, **models}
        own = yardstick_of(recording, found)
        figures = {name: replayed(recording, config, own) for name, config in configs.items()}
        if recording.fog is None:
            return figures
        of_others = np.mean([scaled_and_delayed(r, yardstick_of(r, found))[..., 0] for r in others], axis=0)
        best = np.unravel_index(np.argmin(of_others), of_others.shape)
        return {**figures, "scale and delay": Off(*scaled_and_delayed(recording, own)[best])}


def yardstick_of(recording: Recording, found: c.Calibration) -> Yardstick:
    """The recording's reference, as it would show the robot's centre."""
    robot = next(r for name, r in ROBOTS.items() if recording.name.startswith(name))
    return Yardstick(at_centre(reference_of(recording), found.mounting), False, robot.allowed_m, robot.moving_m_s)


def in_common(rows: Sequence[Mapping[str, Off]], which: int) -> list[str]:
    """Lines on one figure of `Off`: for each name over all drives, and against the calibration, drive by drive."""
    lines = []
    for name in rows[0]:
        values = np.array([row[name][which] for row in rows])
        apart = values - [row[CALIBRATED][which] for row in rows]
        error = apart.std(ddof=1) / np.sqrt(len(rows)) if len(rows) > 1 else np.nan
        lines.append(
            f"{name:18} median {np.median(values):.4f}  mean {values.mean():.4f}  "
            f"rms {np.sqrt(np.mean(values**2)):.4f}  against {CALIBRATED} {apart.mean():+.4f} +- {error:.4f}"
        )
    return lines


def main() -> None:
    """Print each drive's row, and what they have in common."""
    parser = argparse.ArgumentParser(prog="python -m held_out_pose", description=__doc__)
    parser.add_argument("recordings", type=Path, nargs="+", metavar="RECORDING")
    parser.add_argument("--folds", type=int, metavar="N", help="hold out every N-th drive at a time")
    arguments = parser.parse_args()
    recordings = [read_recording(path) for path in arguments.recordings]
    alone, folds = arguments.folds is None, arguments.folds or len(recordings)
    rows = []
    with tempfile.TemporaryDirectory() as place:
        of_one = {r.name: modelled([r.folder], Path(place) / r.name) for r in recordings if alone}
        for fold in range(folds):
            others = [r for i, r in enumerate(recordings) if i % folds != fold]
            models = {"their model": modelled([r.folder for r in others], Path(place) / f"all but {fold}")}
            models |= {f"model {k}": of_one[r.name] for k, r in enumerate(others, 1) if alone}
            for recording in recordings[fold::folds]:
                rows.append(row(recording, others, models))
                figures = {name: np.round(value, 4).tolist() for name, value in rows[-1].items()}
                print(recording.name, figures, flush=True)
    for which, quantity in enumerate(Off._fields):
        print(quantity, *in_common(rows, which), sep="\n")


if __name__ == "__main__":
    main()
