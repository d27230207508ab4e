"""The whole way from frames to wheel samples: scales, signs, restarts, silence, counters, and arbitrary frames."""

import random
from dataclasses import replace
from itertools import pairwise
from math import isfinite, pi
from pathlib import Path

import pytest

from drd.config.keys import Cia406, Dbc, Encoders, Left, Odrive, Right, Robot
from drd.config.schema import ConfigError
from drd.encoders.stream import EncoderStream
from drd.samples import CanFrame, Side, WheelSample
from drd.units import NS_PER_MS, NS_PER_S

BASE = Path()
ROBOT = Robot(wheel_radius_m=0.5 / pi, tread_m=0.6)  # one metre per turn
# One count is a millimetre.
CIA406 = Encoders(counts_per_revolution=1000)
AGILEX = Encoders(layout="agilex")
DBC_TEXT = """VERSION ""
BU_: ROBOT
BO_ 256 WHEELS: 8 ROBOT
 SG_ LEFT : 0|16@1- (0.01,0) [0|0] "m/s" ROBOT
 SG_ RIGHT : 16|16@1- (0.01,0) [0|0] "m/s" ROBOT
"""


def position(side: Side, t_ms: float, counts: int, length: int = 4) -> CanFrame:
    return CanFrame(round(t_ms * NS_PER_MS), 0x181 + side.value, False, counts.to_bytes(length, "little"))


def odometry(t_ms: float, left_mm: int, right_mm: int) -> CanFrame:
    data = b"".join(mm.to_bytes(4, "big", signed=True) for mm in (left_mm, right_mm))
    return CanFrame(round(t_ms * NS_PER_MS), 0x311, False, data)


def run(stream: EncoderStream, frames: list[CanFrame]) -> list[WheelSample]:
    return [sample for frame in frames for sample in stream.feed(frame)]


def drive(encoders: Encoders, counts: list[int], length: int = 4) -> tuple[EncoderStream, list[WheelSample]]:
    """Both nodes report the same counts at the same times, every 50 ms."""
    stream = EncoderStream(encoders, ROBOT, BASE)
    frames = [position(side, 50 * k, c, length) for k, c in enumerate(counts) for side in Side]
    return stream, run(stream, frames)


def dbc_speeds(tmp_path: Path) -> Encoders:
    (tmp_path / "wheels.dbc").write_text(DBC_TEXT)
    return Encoders(
        layout="dbc",
        dbc=Dbc(file=str(tmp_path / "wheels.dbc"), quantity="speed"),
        left=Left(message="WHEELS", signal="LEFT"),
        right=Right(message="WHEELS", signal="RIGHT"),
    )


def test_counts_become_metres_by_radius_scale_and_direction() -> None:
    robot = replace(ROBOT, left_scale=1.01, right_scale=0.99)
    stream = EncoderStream(replace(CIA406, right=Right(node=2, reversed=True)), robot, BASE)
    frames = [position(side, 50 * k, 1000 + 100 * k) for k in range(2) for side in Side]
    (sample,) = run(stream, frames)
    assert sample.left_m == pytest.approx(0.101)
    assert sample.right_m == pytest.approx(-0.099)
    assert sample.interval_s == pytest.approx(0.05)
    assert stream.resolution_m == pytest.approx(0.00101)


@pytest.mark.parametrize("apart_percent", [0, 30, 45, 50, 55, 70, 95])
@pytest.mark.parametrize("rate_hz", [5.0, 8.0, 10.0])
def test_slow_nodes_that_run_free_pair_however_far_apart_they_send(rate_hz: float, apart_percent: float) -> None:
    period_ms = 1000.0 / rate_hz
    stream = EncoderStream(replace(CIA406, rate_hz=rate_hz), ROBOT, BASE)
    samples = run(
        stream,
        [
            position(side, period_ms * (k + apart_percent / 100.0 * side.value), 1000 + 50 * k)
            for k in range(40)
            for side in Side
        ],
    )
    assert sum(s.interval_s for s in samples) > 37.0 * period_ms / 1000.0
    assert all(s.lost_s == 0.0 for s in samples)


@pytest.mark.parametrize(
    ("encoders", "length", "counts"),
    [
        (replace(CIA406, cia406=Cia406(byte_length=2)), 2, [65_500, 20, 65_500]),
        (replace(CIA406, modulus_counts=4096, cia406=Cia406(byte_length=2)), 2, [4060, 20, 4060]),
        (replace(CIA406, modulus_counts=36_001), 4, [35_965, 20, 35_965]),
    ],
)
def test_counters_wrap_at_16_bit_12_bit_and_an_odd_range(encoders: Encoders, length: int, counts: list[int]) -> None:
    stream, samples = drive(encoders, counts, length)
    assert [s.left_m for s in samples] == pytest.approx([0.056, -0.056])
    assert [s.right_m for s in samples] == pytest.approx([0.056, -0.056])
    assert stream.counters["left_wraps"] == stream.counters["right_wraps"] == 2


def test_a_preset_is_no_motion_and_its_interval_is_told_as_lost() -> None:
    stream, samples = drive(CIA406, [5000, 5010, 0, 10, 20])
    assert [s.left_m for s in samples] == pytest.approx([0.01, 0.01, 0.01])
    assert [s.lost_s for s in samples] == pytest.approx([0.0, 0.05, 0.0])
    assert stream.counters["left_jumps"] == 1


def test_after_a_boot_up_a_small_step_is_no_motion_either_and_the_node_is_started() -> None:
    stream = EncoderStream(replace(CIA406, cia406=Cia406(start_nodes=True)), ROBOT, BASE)
    assert [f.data.hex() for f in stream.start_frames()] == ["0101", "0102"]
    before = run(stream, [position(side, t, 50) for t in (0, 50) for side in Side])
    boot_up = CanFrame(60 * NS_PER_MS, 0x702, False, b"\x00")
    assert stream.feed(boot_up) == []
    assert [(f.can_id, f.data.hex()) for f in stream.take_replies()] == [(0, "0102")]
    assert stream.take_replies() == []
    frames = [position(Side.LEFT, t, 60) for t in (100, 150)] + [position(Side.RIGHT, t, 0) for t in (100, 150)]
    after = run(stream, sorted(frames, key=lambda f: f.t_ns))
    assert [s.right_m for s in before + after] == [0.0, 0.0]
    assert after[0].lost_s == pytest.approx(0.05)
    assert stream.counters["boot_ups"] == stream.counters["right_restarts"] == 1
    assert stream.counters["right_jumps"] == 0


def test_a_node_that_boots_in_a_loop_fills_no_memory_and_reopening_forgets_what_was_to_be_sent() -> None:
    stream = EncoderStream(replace(CIA406, cia406=Cia406(start_nodes=True)), ROBOT, BASE)
    for t_ns in range(1000):
        stream.feed(CanFrame(t_ns, 0x701, False, b"\x00"))
    assert len(stream.take_replies()) == 16
    stream.feed(CanFrame(2000, 0x701, False, b"\x00"))
    stream.restart()
    assert stream.take_replies() == []


def test_reopening_the_bus_within_the_gap_keeps_the_travel_and_beyond_it_does_not() -> None:
    stream = EncoderStream(AGILEX, ROBOT, BASE)
    run(stream, [odometry(0, 0, 0), odometry(50, 10, 10)])
    stream.restart()
    (sample,) = stream.feed(odometry(400, 80, 90))
    assert [sample.left_m, sample.right_m, sample.lost_s] == pytest.approx([0.07, 0.08, 0.0])
    stream.restart()
    assert stream.feed(odometry(2400, 500, 500)) == []
    (sample,) = stream.feed(odometry(2450, 510, 520))
    assert [sample.left_m, sample.right_m, sample.lost_s] == pytest.approx([0.01, 0.02, 2.0])
    assert stream.counters["left_gaps"] == stream.counters["right_gaps"] == 1


def test_duplicates_and_frames_out_of_order_are_dropped_and_change_nothing() -> None:
    clean = [odometry(50 * k, 10 * k, 12 * k) for k in range(10)]
    dirty = [*clean[:4], clean[3], clean[2], *clean[4:], clean[5]]
    streams = [EncoderStream(AGILEX, ROBOT, BASE) for _ in range(2)]
    assert run(streams[0], clean) == run(streams[1], dirty)
    assert streams[1].counters["left_not_newer"] == streams[1].counters["right_not_newer"] == 3


def test_the_latency_moves_the_samples_not_the_arrivals() -> None:
    stream = EncoderStream(replace(AGILEX, latency_s=0.012), ROBOT, BASE)
    (sample,) = run(stream, [odometry(1000, 0, 0), odometry(1020, 1, 1)])
    assert sample.t_ns == 1008 * NS_PER_MS
    assert stream.last_ns[Side.LEFT] == 1020 * NS_PER_MS


def test_last_ns_tells_which_side_is_silent() -> None:
    stream = EncoderStream(replace(CIA406, modulus_counts=36_000), ROBOT, BASE)
    assert stream.last_ns == {Side.LEFT: None, Side.RIGHT: None}
    stream.feed(position(Side.RIGHT, 10, 5))
    stream.feed(position(Side.RIGHT, 20, 40_000))
    stream.feed(CanFrame(30 * NS_PER_MS, 0x182, False, b"\x00"))
    assert stream.last_ns == {Side.LEFT: None, Side.RIGHT: 10 * NS_PER_MS}


def test_every_counter_is_there_from_the_start_and_sides_are_told_apart() -> None:
    stream = EncoderStream(CIA406, ROBOT, BASE)
    names = set(stream.counters)
    assert not any(stream.counters.values())
    assert {"frames", "foreign", "samples", "wrong_length", "unpaired", "left_wraps", "right_jumps"} <= names
    run(stream, [position(Side.LEFT, 0, 1), CanFrame(0, 0x7FF, False, b""), CanFrame(1, 0x182, False, b"\x00")])
    assert set(stream.counters) == names
    assert {name: n for name, n in stream.counters.items() if n} == {"frames": 3, "foreign": 1, "wrong_length": 1}


def test_a_speed_that_is_integrated_gives_the_travel(tmp_path: Path) -> None:
    stream = EncoderStream(dbc_speeds(tmp_path), ROBOT, BASE)
    frames = [CanFrame(k * 50 * NS_PER_MS, 256, False, bytes([10 * k, 0, 100, 0, 0, 0, 0, 0])) for k in range(11)]
    samples = run(stream, frames)
    assert sum(s.left_m for s in samples) == pytest.approx(0.5 * 1.0 * 0.5)
    assert sum(s.right_m for s in samples) == pytest.approx(0.5)
    assert len(samples) == 10
    assert 0.0 < stream.resolution_m < 0.001


@pytest.mark.parametrize(
    ("encoders", "path"),
    [
        (replace(CIA406, rate_hz=2, gap_s=0.5), r"encoders\.gap_s: expected more than one period .*0\.5 s"),
        (replace(CIA406, modulus_counts=300), r"encoders\.modulus_counts: expected more than 306: .* got 300"),
    ],
)
def test_a_configuration_with_which_no_travel_could_ever_be_told_is_refused(encoders: Encoders, path: str) -> None:
    with pytest.raises(ConfigError, match=path):
        EncoderStream(encoders, ROBOT, BASE)


@pytest.mark.parametrize(
    "name", ["cia406", "cia406 odd", "agilex", "odrive estimates", "odrive counts", "vesc", "dbc counts", "dbc speed"]
)
def test_random_frames_never_raise_and_never_become_impossible_motion(name: str, tmp_path: Path) -> None:
    speeds = dbc_speeds(tmp_path)
    encoders = {
        "cia406": CIA406,
        "cia406 odd": replace(CIA406, modulus_counts=4095, cia406=Cia406(byte_length=2)),
        "agilex": AGILEX,
        "odrive estimates": Encoders(layout="odrive"),
        "odrive counts": replace(CIA406, layout="odrive", odrive=Odrive(message="counts")),
        "vesc": Encoders(layout="vesc"),
        "dbc counts": replace(speeds, dbc=replace(speeds.dbc, quantity="counts"), counts_per_revolution=1000),
        "dbc speed": speeds,
    }[name]
    stream = EncoderStream(encoders, ROBOT, BASE)
    rng = random.Random(406)
    t_ns, samples, frames = 0, [], 100_000
    for _ in range(frames):
        t_ns += rng.choice([-1_000, 0, 200_000, 20_000_000, 50_000_000])
        can_id, extended = rng.choice(stream.can_ids)
        if rng.random() < 0.1:
            can_id, extended = rng.getrandbits(29), rng.random() < 0.5
        # Mostly small counts: some are plausible motion, so that samples come out too.
        length = rng.choice([0, 1, 4, 6, 8, 8, 8, 8, 64])
        data = rng.randbytes(length) if rng.random() < 0.3 else bytes(rng.choice([0, 0, 1]) for _ in range(length))
        samples += stream.feed(CanFrame(t_ns, can_id, extended, data))
    assert stream.counters["frames"] == frames
    assert stream.counters["samples"] == len(samples) > 0
    for sample in samples:
        assert isfinite(sample.left_m)
        assert isfinite(sample.right_m)
        assert 0.0 < sample.interval_s <= encoders.gap_s
    for before, sample in pairwise(samples):
        start_ns = sample.t_ns - round((sample.interval_s + sample.lost_s) * NS_PER_S)
        assert abs(start_ns - before.t_ns) <= 1


def test_turns_are_those_of_the_wheels_whatever_their_scales() -> None:
    robot = replace(ROBOT, left_scale=1.1, right_scale=0.9)
    encoders = replace(CIA406, right=Right(reversed=True))
    stream = EncoderStream(encoders, robot, BASE)
    assert stream.turns() is None
    for k in range(4):  # 20 and -50 counts of 1000 in 50 ms, and the right one is mounted the other way round
        run(stream, [position(Side.LEFT, 50 * k, 20 * k), position(Side.RIGHT, 50 * k, 10_000 - 50 * k)])
    turns = stream.turns()
    assert turns is not None
    assert turns.t_ns == 150 * NS_PER_MS
    assert (turns.left_rad, turns.right_rad) == pytest.approx((0.12 * pi, 0.3 * pi))
    assert (turns.left_rad_s, turns.right_rad_s) == pytest.approx((0.8 * pi, 2 * pi))


def test_turns_are_not_known_in_a_gap_and_never_from_speeds(tmp_path: Path) -> None:
    stream, _ = drive(CIA406, [0, 10, 20])
    assert stream.turns() is not None
    run(stream, [position(side, 5000, 30) for side in Side])
    assert stream.turns() is None
    stream = EncoderStream(dbc_speeds(tmp_path), ROBOT, BASE)
    for k in range(4):
        assert len(stream.feed(CanFrame(50 * k * NS_PER_MS, 256, False, bytes(8)))) == (k > 0)
    assert stream.turns() is None
