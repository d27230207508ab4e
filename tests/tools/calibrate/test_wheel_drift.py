"""How the lag of wheels or reference grows: a clock is found whenever the robot starts; few turns promise little."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from replay_folders import write_perfect
from wheel_recordings import TOUR, Leg, later

from drd_tools.calibrate.wheels.drift import find_drift, reference_drift
from drd_tools.calibrate.wheels.lag import find_lag
from drd_tools.recordings.folder import Recording, read_recording

# One turn that tells, in a drive of minutes; what the noise of the others tells hangs together.
ONE_TURN: tuple[Leg, ...] = (
    (0.0, 0.0, 5.0), (0.5, 0.0, 20.0), (0.2, 0.5, 4.0), (0.2, -0.5, 4.0), *((0.5, 0.0, 4.0), (0.5, 0.01, 4.0)) * 4,
)  # fmt: skip


def driven(folder: Path, legs: tuple[Leg, ...]) -> Recording:
    return read_recording(write_perfect(folder / "drive", gyro=True, legs=legs))


@pytest.mark.parametrize("ratio", [0.972, 1.03])
@pytest.mark.parametrize("stands_s", [2.0, 45.0])
def test_a_clock_is_found_whenever_the_robot_starts(tmp_path: Path, ratio: float, stands_s: float) -> None:
    recording = driven(tmp_path, ((0.0, 0.0, stands_s), *TOUR))
    assert recording.fog is not None
    counted = replace(recording, fog=replace(recording.fog, time_s=recording.fog.time_s * ratio))
    for found in (find_drift(counted, "gyro"), reference_drift(counted)):
        assert found is not None
        assert found.growth == pytest.approx(1.0 - ratio, abs=1e-4)
        assert found.lag_s == pytest.approx(0.0, abs=0.01)


@pytest.mark.parametrize("epoch_s", [-100.0, -4.2, 1.7e9])
def test_times_may_count_from_any_epoch(tmp_path: Path, epoch_s: float) -> None:
    recording = later(driven(tmp_path, TOUR), epoch_s)
    for found in (find_drift(recording, "gyro"), reference_drift(recording)):
        assert found is None or abs(found.growth) < 1e-3


def test_deviations_cover_the_errors_where_few_turns_tell(tmp_path: Path) -> None:
    recording = driven(tmp_path, ONE_TURN)
    fog = recording.fog
    assert fog is not None
    z = []
    for seed in range(40):
        noise = np.random.default_rng(seed).normal(0.0, 0.02, len(fog.time_s))
        shaken = replace(recording, fog=replace(fog, rate_rad_s=fog.rate_rad_s + noise))
        drift, lag = find_drift(shaken, "gyro"), find_lag([shaken])
        assert drift is not None
        assert lag is not None
        z.append((drift.growth / drift.sigma, lag.lag_s / lag.sigma_s))
    # 40 drives: the rms of a true z lies in 0.72 to 1.29 with 99 %; weights of few rows make it a little worse.
    assert all(0.4 < rms < 1.6 for rms in np.sqrt(np.mean(np.square(z), axis=0)))
