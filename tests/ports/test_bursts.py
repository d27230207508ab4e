"""Frames that waited are spread over the time in which they were sent."""

from hypothesis import given
from hypothesis import strategies as st

from drd.ports.bursts import Bursts
from drd.samples import CanFrame

MS = 1_000_000


def frame(t_ms: float, can_id: int = 0x181) -> CanFrame:
    return CanFrame(round(t_ms * MS), can_id, False, b"\0\0\0\0")


def times(frames: list[CanFrame], can_id: int) -> list[float]:
    return [f.t_ns / MS for f in frames if f.can_id == can_id]


def test_single_frames_keep_their_times() -> None:
    bursts = Bursts(20.0)
    assert times(bursts.spread([frame(1000), frame(1001, 0x182)]), 0x181) == [1000]
    assert times(bursts.spread([frame(1050), frame(1051, 0x182)]), 0x182) == [1051]


def test_a_burst_after_a_stall_is_spread_back_by_the_period() -> None:
    bursts = Bursts(20.0)
    bursts.spread([frame(1000), frame(1000, 0x182)])
    late = [frame(1600, i) for _ in range(12) for i in (0x181, 0x182)]
    for can_id in (0x181, 0x182):
        assert times(bursts.spread(late), can_id)[-1] == 1600
        bursts = Bursts(20.0)
        bursts.spread([frame(1000), frame(1000, 0x182)])
        assert times(bursts.spread(late), can_id) == [1050 + 50 * i for i in range(12)]


def test_a_burst_keeps_the_beat_of_the_frames_before_it() -> None:
    bursts = Bursts(20.0)
    bursts.spread([frame(1000)])
    assert times(bursts.spread([frame(1640)] * 12), 0x181) == [1050 + 50 * i for i in range(12)]


def test_after_a_loss_the_frames_are_the_newest() -> None:
    bursts = Bursts(20.0)
    bursts.spread([frame(1000)])
    assert times(bursts.spread([frame(5000)] * 3), 0x181) == [4850, 4900, 4950]


def test_without_room_the_frames_share_what_there_is() -> None:
    bursts = Bursts(20.0)
    bursts.spread([frame(1000)])
    assert times(bursts.spread([frame(1040), frame(1040)]), 0x181) == [1020, 1040]


@given(st.lists(st.lists(st.sampled_from([1, 2, 3]), min_size=1, max_size=30), max_size=8), st.integers(0, 400))
def test_times_of_one_identifier_never_run_backward_and_never_lie_in_the_future(
    batches: list[list[int]], gap_ms: int
) -> None:
    bursts, last = Bursts(20.0), dict.fromkeys((1, 2, 3), 0)
    for number, ids in enumerate(batches):
        now_ms = 10_000 + number * gap_ms
        for f in bursts.spread([frame(now_ms, i) for i in ids]):
            assert last[f.can_id] <= f.t_ns <= now_ms * MS
            last[f.can_id] = f.t_ns
