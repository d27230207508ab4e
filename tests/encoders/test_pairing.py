"""Pairing two sides' readings: common times, no turn from skew, no time and no travel lost or told twice."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drd.encoders.pairing import Pairing
from drd.samples import Side, WheelSample
from drd.units import NS_PER_MS, NS_PER_S

LEFT, RIGHT = Side.LEFT, Side.RIGHT
PERIOD_MS = 50


class Bench:
    """A pairing that is fed in milliseconds, and what came out of it."""

    def __init__(self, window_s: float = 0.04, gap_s: float = 0.5, period_s: float = 0.05):
        self.pairing = Pairing(window_s, gap_s, period_s)
        self.samples: list[WheelSample] = []
        self.seen: set[Side] = set()

    def add(
        self, side: Side, t_ms: float, travel_m: float, moved: bool | None = None, told: bool = False
    ) -> WheelSample | None:
        moved = side in self.seen if moved is None else moved
        self.seen.add(side)
        sample = self.pairing.add(side, round(t_ms * NS_PER_MS), travel_m, moved=moved, told=told)
        if sample is not None:
            self.samples.append(sample)
        return sample

    def both(self, t_ms: float, left_m: float, right_m: float) -> WheelSample | None:
        self.add(LEFT, t_ms, left_m)
        return self.add(RIGHT, t_ms, right_m)


def assert_tiles_time(samples: list[WheelSample]) -> None:
    for before, sample in pairwise(samples):
        start_ns = sample.t_ns - round((sample.interval_s + sample.lost_s) * NS_PER_S)
        assert abs(start_ns - before.t_ns) <= 1
        assert sample.interval_s > 0.0
        assert sample.lost_s >= 0.0


def test_the_first_pair_is_only_a_baseline_and_nothing_was_lost_before_it() -> None:
    bench = Bench()
    assert bench.both(1000, 7.0, 9.0) is None
    assert bench.both(1050, 7.5, 9.25) == WheelSample(1050 * NS_PER_MS, 0.05, 0.5, 0.25, 0.0)


def test_readings_of_one_frame_pair_at_once_however_close_frames_follow() -> None:
    bench = Bench()
    for k, t_ms in enumerate([0, 50, 50.2, 100]):
        bench.both(t_ms, 0.1 * k, 0.2 * k)
    assert [s.interval_s for s in bench.samples] == pytest.approx([0.05, 0.0002, 0.0498])
    assert [s.right_m for s in bench.samples] == pytest.approx([0.2] * 3)


def test_two_nodes_give_one_sample_per_period_at_the_older_reading() -> None:
    bench = Bench()
    for k in range(6):
        bench.add(LEFT, 50 * k, 0.05 * k)
        bench.add(RIGHT, 50 * k + 5, 0.05 * k + 0.005)
    assert [s.t_ns // NS_PER_MS for s in bench.samples] == [50, 100, 150, 200, 250]
    assert [s.interval_s for s in bench.samples[1:]] == pytest.approx([0.05] * 4)
    assert bench.pairing.counters == {"unpaired": 0, "new_starts": 0}


@given(
    skew_ms=st.integers(0, 49),
    jitter_ms=st.lists(st.integers(-5, 5), min_size=20, max_size=60),
    speed_m_s=st.floats(-3, 3),
)
def test_skew_between_two_nodes_does_not_become_a_turn(skew_ms: int, jitter_ms: list[int], speed_m_s: float) -> None:
    bench = Bench()
    readings = [
        (PERIOD_MS * k + side.value * skew_ms + jitter, side) for k, jitter in enumerate(jitter_ms) for side in Side
    ]
    for t_ms, side in sorted(readings, key=lambda r: r[0]):
        bench.add(side, t_ms, speed_m_s * t_ms * 1e-3)
    assert len(bench.samples) >= len(jitter_ms) - 3
    for sample in bench.samples:
        assert sample.left_m == pytest.approx(sample.right_m, abs=1e-12)
        assert sample.left_m == pytest.approx(speed_m_s * sample.interval_s, abs=1e-12)
    assert_tiles_time(bench.samples)


@given(
    left=st.lists(st.tuples(st.integers(1, 90), st.floats(-0.2, 0.2)), min_size=1, max_size=60),
    right=st.lists(st.tuples(st.integers(1, 90), st.floats(-0.2, 0.2)), min_size=1, max_size=60),
    window_ms=st.sampled_from([1, 10, 40, 200]),
    seed=st.integers(0, 2**32 - 1),
)
def test_without_gaps_the_sum_of_samples_is_the_travel_between_first_and_last(
    left: list[tuple[int, float]], right: list[tuple[int, float]], window_ms: int, seed: int
) -> None:
    bench = Bench(window_s=window_ms * 1e-3, gap_s=10)
    steps = {LEFT: np.array(left), RIGHT: np.array(right)}
    readings = {side: np.cumsum(array, axis=0) for side, array in steps.items()}
    order = [(t, s, m) for s, array in readings.items() for t, m in array]
    rng = np.random.default_rng(seed)
    # A bus does not quite keep the order of two nodes' frames, only that of each node.
    for t_ms, side, travel_m in sorted(order, key=lambda r: r[0] + rng.uniform(0, 0.5)):
        bench.add(side, t_ms, travel_m)
    assert_tiles_time(bench.samples)
    if not bench.samples:
        return
    start_ms = bench.samples[0].t_ns / NS_PER_MS - bench.samples[0].interval_s * 1e3
    end_ms = bench.samples[-1].t_ns / NS_PER_MS
    for side, told_m in (
        (LEFT, math.fsum(s.left_m for s in bench.samples)),
        (RIGHT, math.fsum(s.right_m for s in bench.samples)),
    ):
        times, travel = readings[side].T
        start_m, end_m = np.interp([start_ms, end_ms], times, travel)
        assert told_m == pytest.approx(end_m - start_m, abs=1e-9)


def test_readings_further_apart_than_the_window_do_not_pair_and_are_counted() -> None:
    bench = Bench(window_s=0.04, gap_s=2, period_s=0.2)
    for k in range(10):
        bench.add(LEFT, 200 * k, 0.0)
        bench.add(RIGHT, 200 * k + 100, 0.0)
    assert bench.samples == []
    assert bench.pairing.counters["unpaired"] == 16  # the last two of each side are still waiting
    paired = Bench(window_s=0.1, gap_s=2, period_s=0.2)
    for k in range(10):
        paired.add(LEFT, 200 * k, 0.0)
        paired.add(RIGHT, 200 * k + 100, 0.0)
    assert len(paired.samples) >= 8


def test_a_lost_reading_of_one_side_makes_one_longer_sample_and_loses_nothing() -> None:
    bench = Bench()
    for k in range(8):
        bench.add(LEFT, 50 * k, 0.1 * k)
        if k != 4:
            bench.add(RIGHT, 50 * k + 2, 0.1 * k + 0.004)
    assert_tiles_time(bench.samples)
    assert max(s.interval_s for s in bench.samples) == pytest.approx(0.102, abs=0.003)
    assert sum(s.right_m for s in bench.samples) == pytest.approx(2.0 * sum(s.interval_s for s in bench.samples))
    assert all(s.lost_s == 0.0 for s in bench.samples)


def test_after_a_lost_reading_samples_come_as_early_as_before() -> None:
    bench = Bench()
    last: list[WheelSample | None] = []
    for k in range(20):
        left = bench.add(LEFT, 50 * k, 0.0) if k != 8 else None
        right = bench.add(RIGHT, 50 * k + 15, 0.0)
        last = [left, right]
    assert last[0] is None
    assert last[1] is not None
    assert last[1].t_ns == 950 * NS_PER_MS


def test_one_missing_side_gives_no_sample_and_its_return_after_a_gap_is_no_motion() -> None:
    bench = Bench()
    for k in range(60):
        left = bench.add(LEFT, 50 * k, 0.05 * k)
        if not 20 <= k < 40:
            # The right counter itself is a new start after its gap.
            bench.add(RIGHT, 50 * k + 5, 0.05 * k, moved=k not in {0, 40})
        else:
            assert left is None
    assert_tiles_time(bench.samples)
    (after,) = [s for s in bench.samples if s.lost_s > 0.0]
    before = bench.samples[bench.samples.index(after) - 1]
    assert before.t_ns == 950 * NS_PER_MS
    # The right side was last seen at 955 ms and again at 2005 ms; left readings are at whole periods.
    assert after.lost_s == pytest.approx(2.005 - 0.950)
    assert after.left_m == pytest.approx(after.interval_s)
    assert bench.pairing.counters["new_starts"] == 1


def test_a_gap_of_both_sides_is_lost_even_where_each_says_it_moved() -> None:
    bench = Bench()
    for t_ms in (0, 50, 1050, 1100):
        bench.both(t_ms, t_ms * 1e-3, t_ms * 1e-3)
    assert [s.interval_s for s in bench.samples] == pytest.approx([0.05, 0.05])
    assert [s.lost_s for s in bench.samples] == pytest.approx([0.0, 1.0])
    assert [s.lost_m for s in bench.samples] == pytest.approx([0.0, 1.0])


@pytest.mark.parametrize("told", [True, False])
def test_what_is_lost_has_a_length_where_both_sides_tell_it(told: bool) -> None:
    bench = Bench()
    for t_ms in (0, 50, 1050, 1100, 1150):
        bench.add(LEFT, t_ms, t_ms * 1e-3, moved=t_ms not in (0, 1050), told=t_ms == 1050)
        bench.add(RIGHT, t_ms, t_ms * 2e-3, moved=t_ms not in (0, 1050), told=told)
    assert [s.lost_m for s in bench.samples] == pytest.approx([0.0, 1.5 if told else 0.0, 0.0])


def test_a_jump_loses_only_the_interval_in_which_it_was() -> None:
    bench = Bench()
    for k in range(6):
        bench.add(LEFT, 50 * k, 0.05 * k, moved=k not in {0, 3})
        bench.add(RIGHT, 50 * k, 0.05 * k)
    assert [s.lost_s for s in bench.samples] == pytest.approx([0.0, 0.0, 0.05, 0.0])
    assert [s.t_ns // NS_PER_MS for s in bench.samples] == [50, 100, 200, 250]


def test_new_starts_in_a_row_add_up_what_is_lost() -> None:
    bench = Bench()
    for k in range(8):
        bench.add(LEFT, 50 * k, 0.0, moved=k not in {0, 3, 4, 5})
        bench.add(RIGHT, 50 * k, 0.0)
    assert [s.lost_s for s in bench.samples] == pytest.approx([0.0, 0.0, 0.15, 0.0])
    assert_tiles_time(bench.samples)


@given(
    events=st.lists(
        st.tuples(st.sampled_from(list(Side)), st.integers(1, 400), st.floats(-1, 1), st.booleans()), max_size=80
    )
)
def test_whatever_comes_the_samples_tile_time(events: list[tuple[Side, int, float, bool]]) -> None:
    bench = Bench()
    times = dict.fromkeys(Side, 0)
    for side, step_ms, travel_m, moved in events:
        times[side] += step_ms
        bench.add(side, times[side], travel_m, moved=moved and side in bench.seen)
    assert_tiles_time(bench.samples)
    assert all(s.interval_s <= 0.5 for s in bench.samples)
