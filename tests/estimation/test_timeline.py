"""Cutting two streams into pieces: time is tiled, nothing is lost, nothing is used twice."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drd.estimation.timeline import JOINED_NS, Stream, pieces

MS = 1_000_000


def stream(intervals_ms: list[tuple[int, int]], start_ms: int = 1000) -> Stream:
    """A stream of segments, each a hole (maybe of length zero) and a duration."""
    made, t_ms = Stream(), start_ms
    for i, (hole_ms, length_ms) in enumerate(intervals_ms):
        t_ms += hole_ms + length_ms
        made.add(t_ms * MS, length_ms / 1000, float(i + 1), 0.0, 0)
    return made


lists = st.lists(st.tuples(st.sampled_from([0, 0, 0, 400]), st.integers(10, 200)), max_size=12)


@settings(deadline=None)
@given(lists, lists, st.integers(0, 1500))
def test_pieces_tile_the_time_and_carry_every_segment_whole(
    wheels: list[tuple[int, int]], gyro: list[tuple[int, int]], length_ms: int
) -> None:
    w, g = stream(wheels), stream(gyro)
    start, end = 1000 * MS, (1000 + length_ms) * MS
    found = list(pieces(w, g, start, end))
    edges = [start, *(end_ns for _, end_ns, _, _ in found)]
    assert edges == sorted(set(edges))
    assert edges[-1] == end
    assert [start_ns for start_ns, *_ in found] == edges[:-1]
    for source, index in ((w, 2), (g, 3)):
        for segment in source.segments:
            covered = sum(p[1] - p[0] for p in found if p[index] == segment)
            inside = max(0, min(segment.end_ns, end) - max(segment.start_ns, start))
            assert covered == inside


def test_jitter_between_neighbours_is_closed_and_a_real_hole_stays() -> None:
    s = Stream()
    assert s.add(1100 * MS, 0.1, 1.0, 0.0, 0)
    assert s.add(1203 * MS, 0.1, 2.0, 0.0, 0)
    assert s.add(1301 * MS, 0.1, 3.0, 0.0, 0)
    assert s.add(1700 * MS, 0.1, 4.0, 0.0, 0)
    spans = [(a.start_ns // MS, a.end_ns // MS) for a in s.segments]
    assert spans == [(1000, 1100), (1100, 1203), (1203, 1301), (1600, 1700)]


def test_what_comes_too_late_is_refused_or_cut() -> None:
    s = Stream()
    assert s.add(1100 * MS, 0.1, 1.0, 0.0, 1050 * MS)
    assert s.segments[0].start_ns == 1050 * MS
    assert not s.add(1090 * MS, 0.1, 2.0, 0.0, 1050 * MS)
    assert not s.add(1100 * MS, 0.1, 2.0, 0.0, 1050 * MS)
    assert len(s.segments) == 1


@given(lists, st.integers(1000, 2500))
def test_joined_segments_turn_as_far_and_end_with_the_stream(gyro: list[tuple[int, int]], from_ms: int) -> None:
    fast = stream([(hole_ms, length_ms // 10) for hole_ms, length_ms in gyro])
    joined = fast.joined(from_ms * MS)
    assert joined.end_ns == fast.end_ns
    assert len(joined.segments) <= len(fast.segments)
    longest_ns = max((s.end_ns - s.start_ns for s in joined.segments if s.start_ns >= from_ms * MS), default=0)
    assert longest_ns <= JOINED_NS
    turns = [sum(s.a * (s.end_ns - s.start_ns) for s in each.segments) for each in (fast, joined)]
    assert turns[1] == pytest.approx(turns[0])
    edges = [s.end_ns for s in joined.segments]
    kept = [s.end_ns for s in fast.segments if s.end_ns <= from_ms * MS]
    assert edges[: len(kept)] == kept


def test_a_fast_gyro_alone_is_looked_ahead_in_long_steps() -> None:
    fast = stream([(0, 1)] * 500)
    assert len(fast.joined(1200 * MS).segments) == 200 + 300 // 50
    assert len(fast.joined(fast.end_ns).segments) == 500


def test_used_segments_are_dropped() -> None:
    s = stream([(0, 100)] * 5)
    s.drop_until(1250 * MS)
    assert [a.end_ns // MS for a in s.segments] == [1300, 1400, 1500]
