"""The baselines against motion in closed form."""

import math
from pathlib import Path

import numpy as np
import pytest
from replay_folders import write_perfect
from wheel_recordings import SPIN, TREAD_M

from drd_tools.evaluate.trajectory import Poses
from drd_tools.honesty.baselines import BASELINES, GYRO, LEAST_SAMPLES, STOPS, WHEELS, baselines, stop_bias, stops
from drd_tools.recordings.folder import read_recording

BIAS_DEG_S = 0.05
SPEED_M_S, RATE_RAD_S, SECONDS = 0.4, 0.2, 30.0
ARC = ((0.0, 0.0, 20.0), (SPEED_M_S, RATE_RAD_S, SECONDS), (0.0, 0.0, 5.0))


def driven(tmp_path: Path, *, gyro: bool = True, bias_deg_s: float = 0.0) -> dict[str, Poses]:
    return baselines(read_recording(write_perfect(tmp_path / "drive", gyro=gyro, bias_deg_s=bias_deg_s, legs=ARC)))


def test_all_three_end_where_the_arc_ends(tmp_path: Path) -> None:
    found = driven(tmp_path)
    assert tuple(found) == BASELINES
    radius_m, turn = SPEED_M_S / RATE_RAD_S, RATE_RAD_S * SECONDS
    end = (radius_m * math.sin(turn), radius_m * (1.0 - math.cos(turn)), turn)
    for poses in found.values():
        assert poses.pose[0] == pytest.approx((0.0, 0.0, 0.0))
        assert poses.pose[-1] == pytest.approx(end, abs=0.02)  # counts are whole


def test_a_bias_turns_b_and_not_c(tmp_path: Path) -> None:
    found = driven(tmp_path, bias_deg_s=BIAS_DEG_S)
    seconds = ARC[0][2] + ARC[1][2] + ARC[2][2]
    turn = RATE_RAD_S * SECONDS
    assert found[WHEELS].pose[-1, 2] == pytest.approx(turn, abs=0.01)
    assert found[GYRO].pose[-1, 2] - turn == pytest.approx(math.radians(BIAS_DEG_S) * seconds, abs=0.01)
    assert found[STOPS].pose[-1, 2] == pytest.approx(turn, abs=0.005)


def test_a_spin_moves_nothing(tmp_path: Path) -> None:
    for poses in baselines(read_recording(write_perfect(tmp_path / "drive", gyro=True, legs=SPIN))).values():
        assert np.abs(poses.pose[:, :2]).max() < 0.01 * TREAD_M


def test_without_a_gyro_there_is_odometry_alone(tmp_path: Path) -> None:
    assert tuple(driven(tmp_path, gyro=False)) == (WHEELS,)


def test_a_stop_is_a_second_away_from_any_motion() -> None:
    time_s = np.arange(0.0, 10.0, 0.1)
    travel_m = np.clip(time_s - 4.0, 0.0, 1.0)  # moves from 4 to 5 s
    at_s = np.array([0.0, 2.9, 3.5, 4.5, 5.9, 6.2, 9.0])
    assert stops(at_s, time_s, travel_m, travel_m).tolist() == [True, True, False, False, False, True, True]
    assert stops(at_s, time_s, 0.0 * time_s, 0.0 * time_s).all()


def test_the_bias_of_a_stop_is_its_mean_so_far_and_stays_until_the_next() -> None:
    stopped = np.zeros(200, bool)
    stopped[10:60] = stopped[150:155] = True  # the second one is too short
    rate = np.where(stopped, 0.3, 5.0)
    bias = stop_bias(rate, stopped)
    assert (bias[: 10 + LEAST_SAMPLES] == 0.0).all()
    assert bias[10 + LEAST_SAMPLES :] == pytest.approx(0.3)
