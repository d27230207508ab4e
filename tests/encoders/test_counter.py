"""Unwrapping counters: wraps, jumps, gaps, and nothing lost in between."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drd.encoders.counter import MARGIN_COUNTS, Counter, Outcome, SpeedIntegral
from drd.units import NS_PER_MS

MOVED, NEW_START, IGNORED = Outcome.MOVED, Outcome.NEW_START, Outcome.IGNORED
PERIOD_S = 0.05
PERIOD_NS = 50 * NS_PER_MS


def counter(modulus: int | None, max_counts_s: float = 10_000.0, gap_s: float = 0.5) -> Counter:
    return Counter(modulus, max_counts_s, PERIOD_S, gap_s)


def feed(travel: Counter | SpeedIntegral, *values: float) -> list[Outcome]:
    return [travel.add(k * PERIOD_NS, value) for k, value in enumerate(values)]


@pytest.mark.parametrize("first", [0, 1, 4095])
def test_the_first_count_is_never_motion(first: int) -> None:
    travel = counter(4096)
    assert feed(travel, first, first) == [NEW_START, MOVED]
    assert travel.total == 0


@pytest.mark.parametrize(("modulus", "last"), [(1 << 16, 0xFFF0), (4096, 4080), (36_000, 35_984), (35_999, 35_983)])
def test_a_wrap_is_motion_in_both_directions(modulus: int, last: int) -> None:
    travel = counter(modulus)
    assert feed(travel, last, 5, last) == [NEW_START, MOVED, MOVED]
    assert travel.total == 0
    travel.add(3 * PERIOD_NS, 5)
    assert travel.total == 21
    assert travel.counters["wraps"] == 3


def test_a_signed_counter_wraps_at_half_its_modulus() -> None:
    travel = counter(1 << 32)
    feed(travel, 2**31 - 10, -(2**31) + 5)
    assert travel.total == 15
    assert travel.counters["wraps"] == 1


def test_a_count_out_of_the_modulus_is_counted_and_not_used() -> None:
    travel = counter(36_000)
    assert feed(travel, 100, 36_000, 200, 65_535, 300) == [NEW_START, IGNORED, MOVED, IGNORED, MOVED]
    assert travel.total == 200
    assert travel.counters["out_of_range"] == 2


@pytest.mark.parametrize("step", [504, -504, 20_000, -20_000])
def test_a_step_faster_than_the_robot_is_a_jump_and_a_new_start(step: int) -> None:
    travel = counter(1 << 16)
    outcomes = feed(travel, 30_000, 30_100, 30_100 + step, 30_200 + step)
    assert outcomes == [NEW_START, MOVED, NEW_START, MOVED]
    assert travel.total == 200
    assert travel.counters["jumps"] == 1


def test_top_speed_and_the_margin_are_motion() -> None:
    travel = counter(1 << 16)
    assert feed(travel, 0, 500 + MARGIN_COUNTS) == [NEW_START, MOVED]


def test_frames_that_an_adapter_delivers_in_a_bunch_carry_a_periods_travel_each() -> None:
    travel = counter(1 << 16)
    times_ms = [0, 50, 200, 200.1, 200.2, 250]
    outcomes = [travel.add(round(t * NS_PER_MS), 300 * k) for k, t in enumerate(times_ms)]
    assert outcomes == [NEW_START] + [MOVED] * 5
    assert travel.total == 1500


@pytest.mark.parametrize(
    ("gap_ms", "count", "total"), [(501, 40, 50), (3000, 29_990, 30_000), (501, 5100, 10), (10_001, 40, 10)]
)
def test_a_count_after_a_gap_tells_the_travel_if_it_can_be_one(gap_ms: int, count: int, total: int) -> None:
    travel = counter(1 << 16)
    travel.add(0, 0)
    assert travel.add(gap_ms * NS_PER_MS, count) is (Outcome.GAP if total > 10 else NEW_START)
    assert travel.add((gap_ms + 500) * NS_PER_MS, count + 10) is MOVED
    assert travel.total == total
    assert travel.counters["gaps"] == 1


def test_a_gap_that_hides_half_a_turn_of_the_counter_is_too_long() -> None:
    travel = counter(4096)  # half a turn takes 0.2048 s at top speed
    travel.add(0, 0)
    assert travel.add(200 * NS_PER_MS, 1500) is MOVED
    assert travel.add(406 * NS_PER_MS, 3000) is NEW_START
    assert travel.longest_gap_s == pytest.approx((2048 - MARGIN_COUNTS) / 10_000)


def test_a_restart_makes_the_next_count_a_new_start_even_when_it_looks_like_motion() -> None:
    travel = counter(1 << 16)
    feed(travel, 0, 100)
    travel.restart()
    assert travel.add(2 * PERIOD_NS, 0) is NEW_START
    assert travel.add(3 * PERIOD_NS, 7) is MOVED
    assert travel.total == 107
    assert travel.counters["restarts"] == 1


def test_duplicates_and_older_readings_are_dropped_also_after_a_restart() -> None:
    travel = counter(1 << 16)
    feed(travel, 0, 100)
    assert travel.add(PERIOD_NS, 100) is IGNORED
    assert travel.add(PERIOD_NS - 1, 90) is IGNORED
    travel.restart()
    assert travel.add(PERIOD_NS, 100) is IGNORED
    assert travel.counters["not_newer"] == 3
    assert travel.total == 100


def test_a_counter_without_modulus_may_be_fractional_and_jump_too() -> None:
    travel = counter(None, max_counts_s=10.0)
    assert feed(travel, 1e4, 1e4 + 0.25, 1e4 - 0.25, 0.0, 0.5) == [NEW_START, MOVED, MOVED, NEW_START, MOVED]
    assert travel.total == 0.25
    assert travel.counters["wraps"] == 0
    assert feed(counter(None), 1e308, -1e308) == [NEW_START, NEW_START]


def test_speed_is_integrated_by_trapezoids() -> None:
    travel = SpeedIntegral(3.0, 0.5)
    assert feed(travel, 1.0, 2.0, -1.0) == [NEW_START, MOVED, MOVED]
    assert travel.total == pytest.approx(0.05 * (1.5 + 0.5))


def test_a_speed_beyond_the_robots_is_bridged_and_a_gap_is_not() -> None:
    travel = SpeedIntegral(3.0, 0.12)
    assert feed(travel, 1.0, 3.1, 1.0, math.nan) == [NEW_START, IGNORED, MOVED, IGNORED]
    assert travel.total == pytest.approx(0.1)
    assert travel.add(5 * PERIOD_NS, 1.0) is NEW_START
    assert travel.counters["gaps"] == 1
    assert travel.counters["out_of_range"] == 2


@given(
    modulus=st.integers(2200, 1 << 64),
    start=st.integers(0, 1 << 64),
    steps=st.lists(st.integers(-1000, 1000), min_size=1, max_size=200),
    signed=st.booleans(),
)
def test_without_gaps_the_total_is_the_counters_whole_way(
    modulus: int, start: int, steps: list[int], signed: bool
) -> None:
    travel = Counter(modulus, 20_000.0, PERIOD_S, 0.5)
    position = start
    for k, step in enumerate([0, *steps]):
        position += step
        count = position % modulus
        if signed and count >= (modulus + 1) // 2:
            count -= modulus
        assert travel.add(k * PERIOD_NS, count) is (MOVED if k else NEW_START)
    assert travel.total == position - start
