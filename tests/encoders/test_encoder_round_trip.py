"""The emulator's frames through the daemon's reader: the travel that went in comes out, for each layout."""

from dataclasses import replace
from itertools import pairwise
from math import cos, pi, sin
from pathlib import Path

import pytest

from drd.config.keys import Cia406, Dbc, Encoders, Left, Odrive, Right, Robot, Vesc
from drd.encoders.stream import EncoderStream
from drd.samples import CanFrame, WheelSample
from drd.units import NS_PER_S
from drd_tools.emulate.encoder_frames import WheelFrameEncoder

ROBOT = Robot(wheel_radius_m=0.11, tread_m=0.59, left_scale=1.004, right_scale=0.997)
NODES = Encoders(left=Left(node=7), right=Right(node=9, reversed=True))
TURN_M = 2.0 * pi * ROBOT.wheel_radius_m
DBC_TEXT = """VERSION ""
BU_: ROBOT
BO_ 300 COUNTS: 8 ROBOT
 SG_ STATE : 0|8@1+ (1,0) [0|0] "" ROBOT
 SG_ LEFT : 8|20@1- (1,0) [0|0] "" ROBOT
 SG_ RIGHT : 39|20@0- (1,0) [0|0] "" ROBOT
BO_ 2147484000 LEFT_SPEED: 2 ROBOT
 SG_ SPEED : 7|16@0- (0.01,0) [0|0] "km/h" ROBOT
BO_ 2147484001 RIGHT_SPEED: 4 ROBOT
 SG_ SPEED : 0|32@1- (1,0) [0|0] "km/h" ROBOT
SIG_VALTYPE_ 2147484001 SPEED : 1;
"""
DBC = Dbc(file="robot.dbc")
COUNTS = replace(
    NODES,
    layout="dbc",
    dbc=DBC,
    counts_per_revolution=2048,
    left=Left(message="COUNTS", signal="LEFT"),
    right=Right(message="COUNTS", signal="RIGHT", reversed=True),
)
SPEEDS = replace(
    COUNTS,
    dbc=replace(DBC, quantity="speed", speed_unit_m_s=1 / 3.6),
    left=Left(message="LEFT_SPEED", signal="SPEED"),
    right=Right(message="RIGHT_SPEED", signal="SPEED", reversed=True),
)
# Name, configuration and the largest error of the whole travel.
CASES = {
    "cia406": (replace(NODES, counts_per_revolution=4096), TURN_M / 4096),
    "cia406 12 bit": (
        replace(
            NODES,
            counts_per_revolution=4096,
            modulus_counts=4096,
            cia406=Cia406(tpdo=2, byte_offset=1, byte_length=2),
        ),
        TURN_M / 4096,
    ),
    "cia406 odd range": (replace(NODES, counts_per_revolution=4096, modulus_counts=9_999), TURN_M / 4096),
    "agilex": (replace(NODES, layout="agilex"), 0.001),
    "odrive estimates": (replace(NODES, layout="odrive"), TURN_M * 2**-17),
    "odrive estimates, geared": (replace(NODES, layout="odrive", odrive=Odrive(gear_ratio=7.5)), TURN_M * 2**-17),
    "odrive counts": (
        replace(NODES, layout="odrive", counts_per_revolution=8192, odrive=Odrive(message="counts")),
        TURN_M / 8192,
    ),
    "vesc": (replace(NODES, layout="vesc", vesc=Vesc(pole_pairs=7, gear_ratio=12.5)), TURN_M / (42 * 12.5)),
    "dbc counts": (COUNTS, TURN_M / 2048),
    # 0.01 km/h of one sign over the whole time, and the trapezoid's error.
    "dbc speed": (SPEEDS, 10.0 * 0.005 / 3.6 + 1e-3),
}  # fmt: skip


def wheel_travel_m(t_s: float) -> tuple[float, float]:
    """A drive with both directions, standstill at the start, up to 1.5 m/s."""
    forward, turn = 1.2 * (t_s - sin(t_s)) / 2, 0.3 * sin(0.7 * t_s)
    return forward - turn, 1.1 * sin(t_s) + turn - 0.2 * (1 - cos(t_s))


def wheel_speed_m_s(t_s: float) -> tuple[float, float]:
    step_s = 1e-5
    before, after = wheel_travel_m(t_s - step_s), wheel_travel_m(t_s + step_s)
    return (after[0] - before[0]) / (2 * step_s), (after[1] - before[1]) / (2 * step_s)


@pytest.fixture
def base(tmp_path: Path) -> Path:
    (tmp_path / "robot.dbc").write_text(DBC_TEXT)
    return tmp_path


def travel_through(encoders: Encoders, base: Path, skew_s: float) -> tuple[EncoderStream, list[WheelSample]]:
    """Ten seconds at 20 Hz; where a side has its own frame, the right one is sampled `skew_s` later."""
    stream = EncoderStream(encoders, ROBOT, base)
    emulated = WheelFrameEncoder(encoders, ROBOT, base)
    samples = []
    for k in range(201):
        messages = emulated.encode(*wheel_travel_m(0.05 * k), *wheel_speed_m_s(0.05 * k))
        if len(messages) == 2:
            t_s = 0.05 * k + skew_s
            messages[1] = emulated.encode(*wheel_travel_m(t_s), *wheel_speed_m_s(t_s))[1]
        for i, message in enumerate(messages):
            t_ns = round((0.05 * k + skew_s * i) * NS_PER_S)
            frame = CanFrame(t_ns, message.arbitration_id, message.is_extended_id, bytes(message.data))
            samples += stream.feed(frame)
    return stream, samples


@pytest.mark.parametrize("skew_s", [0.0, 0.004, 0.02])
@pytest.mark.parametrize("name", CASES)
def test_the_travel_that_went_in_comes_out_within_the_quantisation(name: str, skew_s: float, base: Path) -> None:
    encoders, tolerance_m = CASES[name]
    stream, samples = travel_through(encoders, base, skew_s)
    assert len(samples) in {199, 200}
    begin_s = samples[0].t_ns / NS_PER_S - samples[0].interval_s
    left_m = right_m = 0.0
    start_left_m, start_right_m = wheel_travel_m(begin_s)
    for sample in samples:
        left_m, right_m = left_m + sample.left_m, right_m + sample.right_m
        true_left_m, true_right_m = wheel_travel_m(sample.t_ns / NS_PER_S)
        # Interpolating a travel under at most 1.6 m/s^2 between readings 50 ms apart.
        curvature_m = 1.6 * 0.05**2 / 8 if skew_s else 0.0
        assert left_m == pytest.approx(true_left_m - start_left_m, abs=1.01 * tolerance_m + 2 * curvature_m)
        assert right_m == pytest.approx(true_right_m - start_right_m, abs=1.01 * tolerance_m + 2 * curvature_m)
    assert all(s.lost_s == 0.0 for s in samples)
    for before, sample in pairwise(samples):
        assert sample.t_ns - before.t_ns == round(sample.interval_s * NS_PER_S)
    expected = {"frames", "samples", "left_wraps", "right_wraps"}
    assert {key for key, count in stream.counters.items() if count} <= expected


def test_the_small_ranges_do_wrap_in_this_drive(base: Path) -> None:
    stream, _ = travel_through(CASES["cia406 12 bit"][0], base, 0.0)
    assert stream.counters["left_wraps"] > 5
    assert stream.counters["right_wraps"] > 2


def test_a_robot_whose_wheels_are_not_as_believed_shows_their_true_ratio(base: Path) -> None:
    encoders = CASES["agilex"][0]
    true_robot = replace(ROBOT, left_scale=ROBOT.left_scale * 1.02)
    stream, emulated = EncoderStream(encoders, ROBOT, base), WheelFrameEncoder(encoders, true_robot, base)
    told_m = 0.0
    for k in range(101):
        (message,) = emulated.encode(0.05 * k, 0.05 * k)
        frame = CanFrame(k * 50_000_000, message.arbitration_id, False, bytes(message.data))
        told_m += sum(sample.left_m for sample in stream.feed(frame))
    assert told_m == pytest.approx(5.0 / 1.02, abs=0.0011)


@pytest.mark.parametrize(
    ("name", "frames"),
    [
        ("cia406", [(0x187, "00100000"), (0x189, "00f0ffff")]),
        ("agilex", [(0x311, "000002b3fffffd4c")]),
        ("odrive estimates", [(0x0E9, "0000803f0000803f"), (0x129, "000080bf000080bf")]),
        ("odrive counts", [(0x0EA, "0020000000000000"), (0x12A, "00e0ffff00000000")]),
        ("vesc", [(0x1B07, "0000020d00f00000"), (0x1B09, "fffffdf300f00000")]),
        ("dbc counts", [(300, "00000800ff800000")]),
    ],
)
def test_one_turn_forward_at_one_turn_per_second_in_bytes(name: str, frames: list[tuple[int, str]], base: Path) -> None:
    encoders = CASES[name][0]
    # A hair more than a turn left and less right (reversed), so that flooring does not depend on rounding.
    hair = 1 + 1e-9
    left_m, right_m = TURN_M * ROBOT.left_scale * hair, TURN_M * ROBOT.right_scale / hair
    messages = WheelFrameEncoder(encoders, ROBOT, base).encode(left_m, right_m, left_m, right_m)
    assert [(m.arbitration_id, bytes(m.data).hex()) for m in messages] == frames
