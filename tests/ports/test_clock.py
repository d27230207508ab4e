import itertools
import math
from collections.abc import Iterator

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from drd.ports.clock import ROUNDING_NS, STEP_NS, ReceiveClock
from drd.units import NS_PER_MS, NS_PER_S

WALL_NS = 1_790_000_000 * NS_PER_S


class Machine:
    """Two clocks that advance together; the wall clock can be stepped."""

    def __init__(self) -> None:
        self.now_ns, self.wall_ns = 1000 * NS_PER_S, WALL_NS
        self.clock = ReceiveClock(5.0, lambda: self.now_ns, lambda: self.wall_ns)

    def advance(self, ns: int) -> None:
        self.now_ns += ns
        self.wall_ns += ns

    def stamp_s(self) -> float:
        return self.wall_ns * 1e-9


def test_a_stamp_is_mapped_by_its_age() -> None:
    machine = Machine()
    stamp_s, received_ns = machine.stamp_s(), machine.now_ns
    machine.advance(300 * NS_PER_MS)
    assert abs(machine.clock.to_monotonic_ns(stamp_s) - received_ns) <= ROUNDING_NS
    assert not any(machine.clock.counters.values())


@pytest.mark.parametrize("step_s", [-1e9, -3600, -1, -0.01, 0.01, 0.3, 1, 3600, 1e9])
def test_after_a_wall_clock_step_between_stamp_and_reading_the_frame_counts_as_received_now(
    step_s: float,
) -> None:
    machine = Machine()
    stamp_s = machine.stamp_s()
    machine.advance(2 * NS_PER_MS)
    machine.wall_ns += int(step_s * NS_PER_S)
    assert machine.clock.to_monotonic_ns(stamp_s) == machine.now_ns
    assert machine.clock.counters["stepped_stamps"] == 1


def test_a_backlog_from_before_a_step_is_not_mapped_with_the_new_wall_clock() -> None:
    machine = Machine()
    stamps = []
    for _ in range(5):
        stamps.append(machine.stamp_s())
        machine.advance(50 * NS_PER_MS)
    machine.wall_ns += 400 * NS_PER_MS
    machine.advance(NS_PER_MS)
    assert {machine.clock.to_monotonic_ns(stamp) for stamp in stamps} == {machine.now_ns}
    assert machine.clock.counters["stepped_stamps"] == 5


def test_stamps_taken_after_a_step_are_used_again() -> None:
    machine = Machine()
    machine.wall_ns -= 86400 * NS_PER_S
    machine.clock.to_monotonic_ns(machine.stamp_s())
    machine.advance(50 * NS_PER_MS)
    stamp_s, received_ns = machine.stamp_s(), machine.now_ns
    machine.advance(NS_PER_MS)
    before = machine.clock.counters["stepped_stamps"]
    assert abs(machine.clock.to_monotonic_ns(stamp_s) - received_ns) <= ROUNDING_NS
    assert machine.clock.counters["stepped_stamps"] == before


@pytest.mark.parametrize("stamp_s", [0.0, -1.0, 12.5, math.nan, math.inf, -math.inf, 1e300, 2e9])
def test_a_nonsense_stamp_counts_as_received_now(stamp_s: float) -> None:
    machine = Machine()
    assert machine.clock.to_monotonic_ns(stamp_s) == machine.now_ns
    assert machine.clock.counters["stepped_stamps"] == 1


def test_a_stamp_rounded_into_the_future_is_taken_for_now() -> None:
    machine = Machine()
    stamp_s = machine.stamp_s() + 1.2e-7
    assert machine.clock.to_monotonic_ns(stamp_s) <= machine.now_ns
    assert machine.clock.counters["stepped_stamps"] == 0


def test_stamps_out_of_order_do_not_run_backward() -> None:
    machine = Machine()
    early_s = machine.stamp_s()
    machine.advance(10 * NS_PER_MS)
    late_ns = machine.clock.to_monotonic_ns(machine.stamp_s())
    assert machine.clock.to_monotonic_ns(early_s) == late_ns
    assert machine.clock.counters["backward_stamps"] == 1


def test_being_preempted_while_the_clocks_are_read_does_not_shift_the_stamp() -> None:
    machine = Machine()
    stamp_s, received_ns = machine.stamp_s(), machine.now_ns
    machine.advance(NS_PER_MS)

    def preemptions() -> Iterator[int]:
        yield 20 * NS_PER_MS
        while True:
            yield 0

    pause_ns = preemptions()

    def wall_ns() -> int:
        wall = machine.wall_ns
        machine.advance(next(pause_ns))
        return wall

    machine.clock._time_ns = wall_ns
    assert abs(machine.clock.to_monotonic_ns(stamp_s) - received_ns) <= ROUNDING_NS
    assert machine.clock.counters["stepped_stamps"] == 0


def test_a_busy_machine_that_stretches_every_reading_of_the_clocks_sees_no_step() -> None:
    machine, pauses = Machine(), itertools.cycle((3, 9, 2, 40, 5))

    def wall_ns() -> int:
        machine.advance(next(pauses) * NS_PER_MS)
        wall = machine.wall_ns
        machine.advance(next(pauses) * NS_PER_MS)
        return wall

    machine.clock._time_ns = wall_ns
    for _ in range(50):
        machine.advance(20 * NS_PER_MS)
        stamp_s, received_ns = machine.stamp_s(), machine.now_ns
        assert abs(machine.clock.to_monotonic_ns(stamp_s) - received_ns) <= ROUNDING_NS
    assert not any(machine.clock.counters.values())


def test_a_wall_clock_that_is_slewed_is_followed() -> None:
    machine = Machine()
    for _ in range(2000):  # 500 ppm, the kernel's limit
        machine.advance(20 * NS_PER_MS)
        machine.wall_ns += 10_000
        assert abs(machine.clock.to_monotonic_ns(machine.stamp_s()) - machine.now_ns) <= ROUNDING_NS + 1000
    assert machine.clock.counters["stepped_stamps"] == 0


# Between two frames the wall clock is stepped once at most: steps that cancel out cannot be seen.
events = st.tuples(
    st.integers(1, 100 * NS_PER_MS),  # from the previous frame's reading to this frame's stamp
    st.integers(0, 50 * NS_PER_MS),  # waiting time of the frame
    st.one_of(st.just(0), st.integers(-(10**18), 10**18), st.integers(-(10**7), 10**7)),  # step
    st.booleans(),  # the step comes while the frame waits
)


@settings(suppress_health_check=[HealthCheck.too_slow])  # a busy machine is no fault of the inputs
@given(st.lists(events, max_size=30))
def test_whatever_the_wall_clock_does_a_frame_is_timed_between_its_reception_and_its_reading(
    history: list[tuple[int, int, int, bool]],
) -> None:
    machine = Machine()
    last_ns, stepped = 0, False
    for wait_ns, age_ns, step_ns, late in history:
        machine.advance(wait_ns)
        machine.wall_ns += 0 if late else step_ns
        stamp_s, received_ns = machine.stamp_s(), machine.now_ns
        machine.advance(age_ns)
        machine.wall_ns += step_ns if late else 0
        stepped = stepped or step_ns != 0
        mapped_ns = machine.clock.to_monotonic_ns(stamp_s)
        # A step below the detection threshold may remain in the result.
        assert received_ns - STEP_NS - ROUNDING_NS <= mapped_ns <= machine.now_ns
        assert mapped_ns >= last_ns
        if not stepped:
            assert abs(mapped_ns - received_ns) <= ROUNDING_NS
        last_ns = mapped_ns
