"""The result of a replay: its digest, and the poses seen from another start."""

import copy
import dataclasses
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from replay_folders import long_drive, short_drive

from drd.config.schema import ConfigError
from drd.samples import Pose, Reason, Validity
from drd_tools.recordings.folder import Recording
from drd_tools.replay.folder_source import replay_folder
from drd_tools.replay.reference import start_on_reference
from drd_tools.replay.result import Replayed, Start, digest, table


@pytest.fixture(scope="module")
def with_gyro(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return long_drive(tmp_path_factory.mktemp("gyro"))


@pytest.fixture(scope="module")
def short(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return short_drive(tmp_path_factory.mktemp("short"))


@settings(deadline=None, max_examples=40)
@given(st.floats(-100.0, 100.0), st.floats(-100.0, 100.0), st.floats(-10.0, 10.0))
def test_the_start_turns_and_moves_poses_and_covariances(short: Recording, x_m: float, y_m: float, turn: float) -> None:
    replayed = _replayed_once(short)
    here, there = table(replayed), table(replayed, Start(x_m, y_m, turn))
    c, s = math.cos(turn), math.sin(turn)
    R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    assert there[0, 1:4] == pytest.approx([x_m, y_m, turn])
    for k in (-1, len(here) // 2):
        assert there[k, 1:4] == pytest.approx(R @ here[k, 1:4] + [x_m, y_m, turn], abs=1e-9)
        assert there[k, 10:].tolist() == here[k, 10:].tolist()  # a radius, and whether it is valid
        assert _square(there[k]) == pytest.approx(R @ _square(here[k]) @ R.T, rel=1e-9, abs=1e-15)


_CACHE: dict[Path, Replayed] = {}


def _replayed_once(recording: Recording) -> Replayed:
    if recording.folder not in _CACHE:
        _CACHE[recording.folder] = replay_folder(recording)
    return _CACHE[recording.folder]


def _square(row: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    xx, xy, xh, yy, yh, hh = row[4:10]
    return np.array([[xx, xy, xh], [xy, yy, yh], [xh, yh, hh]])


def test_started_on_the_reference_the_estimate_passes_through_its_first_row(short: Recording) -> None:
    assert short.reference is not None
    late = short.reference.time_s >= 3.0
    log = replace(
        short.reference,
        **{f.name: getattr(short.reference, f.name)[late] for f in dataclasses.fields(short.reference)},
    )
    moved = replace(short, reference=replace(log, x_m=log.x_m + 7.0, heading_rad=log.heading_rad + 1.0))
    replayed = replay_folder(moved)
    rows = table(replayed, start_on_reference(replayed, moved))
    assert moved.reference is not None
    for column, values in enumerate((moved.reference.x_m, moved.reference.y_m, moved.reference.heading_rad), 1):
        at_s = np.interp(moved.reference.time_s[0], rows[:, 0], rows[:, column])
        assert at_s == pytest.approx(values[0], abs=1e-9)
    with pytest.raises(ConfigError, match="overlaps the poses in time"):
        start_on_reference(replayed, replace(short, reference=None))


POSE = Pose(
    10**9, 1, 1.0, -2.0, 3.0, 0.5, 0.1, 0.01, 0.02, (1e-3, 0.0, 0.0, 1e-3, 0.0, 1e-4), 0.1, Validity.DEGRADED,
    (Reason("fog", "silent", 5),),
)  # fmt: skip


def _with(name: str, value: object) -> Pose:
    changed = copy.copy(POSE)
    setattr(changed, name, value)
    return changed


NUMBERS = [
    "x_m", "y_m", "heading_rad", "speed_m_s", "rate_rad_s", "speed_sigma_m_s", "rate_sigma_rad_s", "position_bound_m"
]  # fmt: skip


@settings(deadline=None, max_examples=60)
@given(st.sampled_from(NUMBERS), st.booleans())
def test_the_last_bit_of_any_number_changes_the_digest(name: str, up: bool) -> None:
    changed = _with(name, math.nextafter(getattr(POSE, name), math.inf if up else -math.inf))
    assert digest([POSE, changed]) != digest([POSE, POSE])


def test_time_covariance_validity_and_reasons_are_in_the_digest() -> None:
    changes = [
        ("t_ns", POSE.t_ns + 1),
        ("sequence", 2),
        ("covariance", (*POSE.covariance[:5], math.nextafter(1e-4, 1.0))),
        ("x_m", -0.0),
        ("x_m", 0.0),
        ("validity", Validity.VALID),
        ("reasons", ()),
        ("reasons", (Reason("fog", "silent", 6),)),
        ("reasons", (Reason("fog", "silenT", 5),)),
    ]
    digests = {digest([_with(*change)]) for change in changes}
    assert len(digests | {digest([POSE]), digest([POSE, POSE]), digest([])}) == len(changes) + 3
