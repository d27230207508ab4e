"""Faults on the running daemon, over a real pty and a real SLCAN line: it goes on, says why, recovers, never jumps."""

import math
import time
from itertools import pairwise
from typing import Any

import pytest
from harness import Robot, farthest_m

Pose = dict[str, Any]


def is_valid(pose: Pose) -> bool:
    return bool(pose["validity"] == "valid")


def because(source: str) -> Any:
    return lambda pose: pose["validity"] == "degraded" and source in {r["source"] for r in pose["reasons"]}


def moving(robot: Robot) -> None:
    robot.wait("a valid pose of the moving robot", lambda p: is_valid(p) and p["speed_m_s"] > 0.3, 20.0)


def assert_no_jump(poses: list[Pose]) -> None:
    for a, b in pairwise(poses):
        dt_s = (b["monotonic_ns"] - a["monotonic_ns"]) * 1e-9
        assert dt_s >= 0.0
        step_m = math.hypot(b["x_m"] - a["x_m"], b["y_m"] - a["y_m"])
        assert step_m <= farthest_m(a, b), f"jump of {step_m:.3f} m in {dt_s:.3f} s at {b}"
        assert abs(b["heading_rad"] - a["heading_rad"]) <= 1.5 * dt_s + 0.05


def heading_error_rad(robot: Robot) -> float:
    """The estimate's heading against the truth at the last pose."""
    pose = robot.poses[-1]
    truth = min(robot.emulator.truth.copy(), key=lambda row: abs(row.t_ns - pose["monotonic_ns"]))
    return abs(float(pose["heading_rad"]) - truth.heading_rad)


def test_each_fault_of_the_gyro_is_told_and_survived(running: Robot) -> None:
    moving(running)
    running.emulator.fog_silent = True
    running.wait("silence of the gyro", because("fog"))
    running.emulator.fog_silent = False
    running.wait("recovery", is_valid)
    running.emulator.unplug_fog()
    running.wait("unplugged gyro", because("fog.port"))
    time.sleep(0.5)
    running.emulator.replug_fog()
    running.wait("recovery", is_valid)
    before = running.get("health")["counters"]["fog"]
    running.emulator.fog_garbage = b"\x00\x7f\x81\x12garbage"
    running.emulator.fog_corrupt_every = 5
    time.sleep(2.0)
    running.emulator.fog_garbage, running.emulator.fog_corrupt_every = b"", 0
    after = running.get("health")["counters"]["fog"]
    assert after["framing_errors"] > before["framing_errors"]
    assert after["samples"] >= before["samples"] + 14  # 20 packets, four of them corrupted
    running.wait("still valid", is_valid)
    assert_no_jump(running.poses)
    assert heading_error_rad(running) < 0.1


def test_each_fault_of_the_encoders_is_told_and_survived(running: Robot) -> None:
    moving(running)
    running.emulator.wheels_silent = True
    running.wait("silence of the encoders", because("encoders"))
    time.sleep(0.5)
    running.emulator.wheels_silent = False
    running.wait("recovery", is_valid)
    running.emulator.left_silent = True
    running.wait("silence of the left counter", because("encoders.left"))
    running.emulator.left_silent = False
    running.wait("recovery", is_valid)
    running.emulator.unplug_can()
    running.wait("unplugged bus", because("encoders.port"))
    time.sleep(0.5)
    running.emulator.replug_can()
    running.wait("recovery", is_valid)
    running.emulator.count_offset_m = 1.0  # a preset: both counters leap by a metre
    time.sleep(1.0)
    running.emulator.swap_frames = True
    time.sleep(1.0)
    running.wait("still valid", is_valid)
    assert_no_jump(running.poses)
    encoders = running.get("health")["counters"]["encoders"]
    assert encoders["left_jumps"] >= 1
    assert encoders["left_wraps"] >= 1  # 16 bits wrap each 2.3 m
    assert heading_error_rad(running) < 0.1


def test_a_step_of_the_wall_clock_moves_nothing(running: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    moving(running)
    time_s, time_ns = time.time, time.time_ns
    for hours in (5, -7, 0):
        monkeypatch.setattr(time, "time", lambda h=hours: time_s() + h * 3600)
        monkeypatch.setattr(time, "time_ns", lambda h=hours: time_ns() + h * 3600 * 1_000_000_000)
        # Poses from before the step may still be on their way.
        first = running.wait("a pose of the new time", lambda p: abs(p["wall_ns"] - time.time_ns()) < 2e9)
        time.sleep(1.0)
        pose = running.wait("a pose", lambda _: True)
        assert pose["wall_ns"] - first["wall_ns"] == pytest.approx(
            pose["monotonic_ns"] - first["monotonic_ns"], abs=1e7
        )
    assert is_valid(pose)
    assert_no_jump(running.poses)
    gaps_ns = [b["monotonic_ns"] - a["monotonic_ns"] for a, b in pairwise(running.poses)]
    assert max(gaps_ns) < 2e9  # hours, if anything waited by that clock; a busy machine alone makes 0.4 s
