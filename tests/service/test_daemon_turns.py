"""The daemon hands the wheels' turns to its link, at the time of their sample."""

import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from links import POSE

from drd.config.keys import Config
from drd.config.schema import loads
from drd.samples import CanFrame, WheelTurns
from drd.service.daemon import Daemon
from drd.units import NS_PER_MS

CONFIG = """\
robot: {wheel_radius_m: 0.11, tread_m: 0.6}
encoders: {layout: agilex}
"""
START_NS = 1_000_000_000


def published(tmp_path: Path, *, wants_turns: bool) -> list[tuple[WheelTurns, int]]:
    """What the link was given with one pose, after 11 and 22 mm of the wheels in 50 ms."""
    daemon: Any = Daemon(loads(CONFIG, Config), tmp_path)
    given: list[tuple[WheelTurns, int]] = []
    daemon._link = SimpleNamespace(
        wants_turns=wants_turns,
        publish_pose=lambda *_: None,
        publish_turns=lambda turns, wall_ns: given.append((turns, wall_ns)),
    )
    for k in range(2):
        data = (11 * k).to_bytes(4, "big") + (22 * k).to_bytes(4, "big")
        daemon.pipeline.encoders.feed(CanFrame(START_NS + 50 * k * NS_PER_MS, 0x311, False, data))
    pose = type(POSE)(**{name: getattr(POSE, name) for name in POSE.__slots__} | {"t_ns": START_NS})
    daemon._on_pose(pose, time.monotonic_ns())
    if given:
        assert given[0][1] == daemon._pose_wall_ns + 50 * NS_PER_MS
    return given


def test_turns_go_with_the_pose_at_their_own_time(tmp_path: Path) -> None:
    [(turns, _)] = published(tmp_path, wants_turns=True)
    assert turns.t_ns == START_NS + 50 * NS_PER_MS
    assert (turns.left_rad, turns.right_rad) == pytest.approx((0.1, 0.2))
    assert (turns.left_rad_s, turns.right_rad_s) == pytest.approx((2.0, 4.0))


def test_nobody_who_does_not_want_turns_gets_them(tmp_path: Path) -> None:
    assert published(tmp_path, wants_turns=False) == []
