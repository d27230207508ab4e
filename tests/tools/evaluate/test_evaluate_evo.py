"""Absolute and relative trajectory errors agree with evo (Grupp), poses of the plane being poses in space."""

from pathlib import Path

import numpy as np
import pytest
from evo.core import metrics
from evo.core.metrics import PoseRelation
from evo.core.trajectory import PosePath3D
from evo.core.units import Unit
from hypothesis import given, settings
from hypothesis import strategies as st
from pose_files import dead_reckoned, moved

from drd.arrays import Array
from drd_tools.evaluate.alignment import align
from drd_tools.evaluate.metrics import Indices, absolute_error, relative_errors
from drd_tools.evaluate.trajectory import Pairs, associate, read_reference
from drd_tools.recordings.folder import read_recording
from drd_tools.recordings.path_length import path_length_m

SHARED = Path(__file__).resolve().parents[4] / "shared/recordings"
ACCURACY = 1e-9


def in_space(pose: Array) -> PosePath3D:
    matrices = []
    for x, y, h in pose:
        c, s = np.cos(h), np.sin(h)
        matrices.append(np.array([[c, -s, 0, x], [s, c, 0, y], [0, 0, 1, 0], [0, 0, 0, 1.0]]))
    return PosePath3D(poses_se3=matrices)


def evo_absolute(reference: PosePath3D, estimate: PosePath3D, relation: PoseRelation) -> dict[str, float]:
    metric = metrics.APE(relation)
    metric.process_data((reference, estimate))
    found: dict[str, float] = metric.get_all_statistics()
    return found


def assert_agrees(pairs: Pairs) -> None:
    for kind in ("none", "se2"):
        ours = absolute_error(align(pairs, kind)[0])
        reference, estimate = in_space(pairs.reference), in_space(pairs.estimate)
        if kind == "se2":
            estimate.align(reference, correct_scale=False)
        position = evo_absolute(reference, estimate, PoseRelation.translation_part)
        heading = evo_absolute(reference, estimate, PoseRelation.rotation_angle_deg)
        assert ours.position_rmse_m == pytest.approx(position["rmse"], rel=ACCURACY, abs=ACCURACY)
        assert ours.position_mean_m == pytest.approx(position["mean"], rel=ACCURACY, abs=ACCURACY)
        assert ours.position_max_m == pytest.approx(position["max"], rel=ACCURACY, abs=ACCURACY)
        assert ours.heading_rmse_deg == pytest.approx(heading["rmse"], rel=ACCURACY, abs=ACCURACY)
        assert ours.heading_max_deg == pytest.approx(heading["max"], rel=ACCURACY, abs=ACCURACY)
    reference, estimate = in_space(pairs.reference), in_space(pairs.estimate)
    length_m = 0.3 * float(path_length_m(pairs.reference[:, :2], 0.0)[-1])
    for delta, unit in ((7, Unit.frames), (length_m, Unit.meters)):
        translation, rotation = (
            metrics.RPE(relation, delta, unit, all_pairs=True, pairs_from_reference=True)
            for relation in (PoseRelation.translation_part, PoseRelation.rotation_angle_rad)
        )
        translation.process_data((reference, estimate))
        rotation.process_data((reference, estimate))
        last = np.array(translation.delta_ids)
        if unit is Unit.frames:
            first = last - 7
        else:
            travelled_m = path_length_m(pairs.reference[:, :2], 0.0)
            first, last = nearest_pairs(travelled_m, length_m)
            assert last.tolist() == translation.delta_ids
        error = relative_errors(pairs, first, last)
        assert np.abs(np.hypot(*error[:, :2].T) - translation.error).max() < ACCURACY
        assert np.abs(np.abs(error[:, 2]) - rotation.error).max() < ACCURACY


def nearest_pairs(travelled_m: Array, length_m: float) -> tuple[Indices, Indices]:
    """The row that is nearest to a length from each row on, and fits within 10 %."""
    first, last = [], []
    for i in range(len(travelled_m) - 1):
        off_m = np.abs(travelled_m[i + 1 :] - travelled_m[i] - length_m)
        if off_m.min() <= 0.1 * length_m:
            first.append(i)
            last.append(i + 1 + int(np.argmin(off_m)))
    return np.array(first), np.array(last)


@given(seed=st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=10)
def test_simulated_drives(seed: int) -> None:
    estimate, reference = dead_reckoned(np.random.default_rng(seed), rows=200)
    assert_agrees(associate(estimate, reference, 1.0))


@given(seed=st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=10)
def test_random_poses(seed: int) -> None:
    """Positions far off and headings that have nothing to do with each other.

    Were positions unrelated too, evo would turn the plane over where its mirror image fits better.
    """
    rng = np.random.default_rng(seed)
    poses = rng.normal(0.0, 3.0, (2, 60, 3))
    poses[0, :, :2] = moved(poses[1], *rng.normal(0.0, 5.0, 3))[:, :2] + rng.normal(0.0, 1.0, (60, 2))
    time_s = np.arange(60.0)
    pairs = Pairs(time_s, poses[0], poses[1], None, None, path_length_m(poses[1, :, :2], 0.0), True, 0, 0)
    assert_agrees(pairs)


@pytest.mark.recordings
@pytest.mark.parametrize("name", ["warthog_grass_2024_7_29_14h4s53", "optiodom_square_230620202144_run-03"])
def test_real_drives_by_wheels_alone(name: str) -> None:
    if not SHARED.is_dir():
        pytest.skip("no shared recordings")
    recording, reference = read_recording(SHARED / name), read_reference(SHARED / name)
    left, right = recording.wheel_angles_rad()
    wheel, tread_m = recording.nominal.wheel_radius_m, recording.nominal.tread_m
    heading = wheel * (right - left) / tread_m
    step_m = 0.5 * wheel * np.diff(left + right, prepend=0.0)
    xy = np.column_stack([np.cumsum(step_m * np.cos(heading)), np.cumsum(step_m * np.sin(heading))])
    at_s = reference.time_s[(reference.time_s >= recording.encoders.time_s[0])][:600]
    rows = np.isin(reference.time_s, at_s) & (reference.time_s <= recording.encoders.time_s[-1])
    estimate = np.column_stack(
        [np.interp(reference.time_s[rows], recording.encoders.time_s, column) for column in (*xy.T, heading)]
    )
    pose = reference.pose[rows]
    assert_agrees(
        Pairs(reference.time_s[rows], estimate, pose, None, None, path_length_m(pose[:, :2], 0.0), True, 0, 0)
    )
