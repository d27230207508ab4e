"""The clock against simulated sensors: a true beat, one-sided delays, bundles, losses, and the host's arrivals."""

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from drd.fog.clock import SampleClock, Stamp
from drd.units import NS_PER_S

Floats = NDArray[np.float64]
Delay = Callable[[np.random.Generator, int], Floats]
HOST_START_S = 12_345.6
MODULUS = 128


def prompt(rng: np.random.Generator, n: int) -> Floats:
    """A quiet host behind a fast adapter."""
    return rng.exponential(0.0005, n)


def usb(rng: np.random.Generator, n: int) -> Floats:
    """An adapter that polls every 16 ms, for packets that are further apart."""
    return rng.uniform(0, 0.016, n)


@dataclass
class Line:
    """A sensor at `rate_hz` and what the clock made of its packets; the times start with the sensor's first beat."""

    clock: SampleClock
    rate_hz: float
    numbered: bool = False
    stamps: list[Stamp] = field(default_factory=list)
    true_s: list[float] = field(default_factory=list)

    def deliver(self, numbers: list[int], arrival_s: float, beat_from_s: float = 0.0) -> None:
        """Packets `numbers` of a beat that began at `beat_from_s` arrive together."""
        sequences = [n % MODULUS if self.numbered else None for n in numbers]
        self.stamps += self.clock.stamp(sequences, round((HOST_START_S + arrival_s) * NS_PER_S))
        self.true_s += [beat_from_s + n / self.rate_hz for n in numbers]

    def errors_s(self, after_s: float = 0.0) -> Floats:
        """Stamps against the true ends of the measuring intervals."""
        errors = np.array([s.t_ns / NS_PER_S - HOST_START_S for s in self.stamps]) - self.true_s
        return errors[np.array(self.true_s) > after_s]

    def interval_error(self, after_s: float = 0.0) -> float:
        """Relative error of the summed intervals against the sensor's true ones."""
        intervals = [s.interval_s for s, t in zip(self.stamps, self.true_s, strict=True) if t > after_s]
        return sum(intervals) * self.rate_hz / len(intervals) - 1

    @property
    def lost(self) -> int:
        return self.clock.counters["lost_packets"]


def make_line(nominal_hz: float, rate_hz: float, numbered: bool = False) -> Line:
    return Line(SampleClock(nominal_hz, MODULUS if numbered else None), rate_hz, numbered)


def steady_line(numbered: bool = False) -> Line:
    """A 10 Hz sensor after 100 packets, each at its beat."""
    line = make_line(10, 10, numbered)
    for n in range(1, 101):
        line.deliver([n], n / 10)
    return line


def run(
    line: Line,
    duration_s: float,
    delay: Delay = prompt,
    bundle_s: float = 0.0,
    loss: float = 0.0,
    stalls: tuple[tuple[float, float], ...] = (),
    seed: int = 1,
) -> int:
    """Send packets for `duration_s`; returns how many were lost on the way.

    `bundle_s`: the adapter delivers every so often. `stalls`: the host reads nothing from the one time to the other.
    Nothing is lost in the first seconds, in which the beat is learned, nor just before the end.
    """
    rng = np.random.default_rng(seed)
    numbers = np.arange(1, int(duration_s * line.rate_hz))
    arrivals_s = numbers / line.rate_hz + delay(rng, len(numbers))
    if bundle_s:
        arrivals_s = np.ceil(arrivals_s / bundle_s) * bundle_s
    for start_s, end_s in stalls:
        arrivals_s[(arrivals_s > start_s) & (arrivals_s < end_s)] = end_s
    arrivals_s = np.maximum.accumulate(arrivals_s)
    lost = (rng.uniform(size=len(numbers)) < loss) & (numbers > 5 * line.rate_hz)
    lost[-30:] = False
    for arrival_s in np.unique(arrivals_s[~lost]).tolist():
        line.deliver(numbers[~lost & (arrivals_s == arrival_s)].tolist(), arrival_s)
    assert (np.diff([s.t_ns for s in line.stamps]) > 0).all()
    return int(lost.sum())


@pytest.mark.parametrize("numbered", [False, True])
@pytest.mark.parametrize(("nominal_hz", "rate_hz"), [(10, 10.3), (10, 9.7), (10, 10.02)])
@pytest.mark.parametrize("delay", [prompt, usb])
def test_a_slow_sensor_with_a_wrong_clock_keeps_true_time(
    nominal_hz: float, rate_hz: float, numbered: bool, delay: Delay
) -> None:
    line = make_line(nominal_hz, rate_hz, numbered)
    lost = run(line, 180, delay, loss=0.01)
    assert line.lost == lost > 5
    assert abs(line.interval_error()) < 2e-4
    assert abs(line.interval_error(after_s=60)) < 2e-5
    # Stamps lie near the smallest delay, not near the mean one.
    assert line.errors_s(after_s=20).min() > -0.001
    assert line.errors_s(after_s=20).max() < 0.004
    assert abs(line.clock.period_s * rate_hz - 1) < 1e-4


@pytest.mark.parametrize("numbered", [False, True])
@pytest.mark.parametrize("rate_hz", [97.1, 102.9])
@pytest.mark.parametrize("bundle_s", [0.0, 0.016, 0.03])
def test_a_fast_sensor_behind_a_bundling_adapter_keeps_true_time(
    rate_hz: float, bundle_s: float, numbered: bool
) -> None:
    line = make_line(100, rate_hz, numbered)
    lost = run(line, 120, bundle_s=bundle_s, loss=0.001)
    assert line.lost == lost > 5
    assert abs(line.interval_error()) < 1e-3
    assert abs(line.interval_error(after_s=30)) < 2e-5
    assert np.median(np.abs(line.errors_s(after_s=20))) < 0.002


def test_a_dsp_1750_gives_989_hz_for_nominal_1000() -> None:
    line = make_line(1000, 989, numbered=True)
    lost = run(line, 20, bundle_s=0.016, loss=0.002)
    assert line.lost == lost > 10
    assert 1 / line.clock.period_s == pytest.approx(989, rel=2e-5)
    assert abs(line.interval_error()) < 5e-4
    assert np.abs(line.errors_s(after_s=5)).max() < 0.0015


@pytest.mark.parametrize("numbered", [False, True])
@pytest.mark.parametrize(("nominal_hz", "rate_hz"), [(10, 100), (100, 10), (100, 80), (10, 13), (100, 1)])
def test_a_wrong_nominal_rate_is_replaced(nominal_hz: float, rate_hz: float, numbered: bool) -> None:
    line = make_line(nominal_hz, rate_hz, numbered)
    run(line, 3000 / rate_hz)
    assert abs(line.clock.period_s * rate_hz - 1) < 2e-4
    assert np.abs(line.errors_s(after_s=1000 / rate_hz)).max() < 0.003
    assert line.lost == 0


@pytest.mark.parametrize("rate_hz", [99.3, 99.7, 100.1, 100.6])
@pytest.mark.parametrize("bundle_s", [0.02, 0.03])
def test_bundles_that_slip_slowly_are_no_losses(rate_hz: float, bundle_s: float) -> None:
    """The trap: for a second or more the bundles look exactly like those of a 100 Hz sensor."""
    line = make_line(100, rate_hz)
    run(line, 120, bundle_s=bundle_s)
    assert line.lost <= 1
    assert abs(line.interval_error(after_s=10)) < 2e-4


@pytest.mark.parametrize("numbered", [False, True])
@pytest.mark.parametrize("stall_s", [0.04, 0.06, 0.09, 0.25, 0.8])
@pytest.mark.parametrize(("rate_hz", "bundle_s"), [(10.0, 0.0), (99.0, 0.0), (99.0, 0.016)])
def test_a_host_that_reads_late_loses_nothing(rate_hz: float, bundle_s: float, stall_s: float, numbered: bool) -> None:
    line = make_line(rate_hz, rate_hz, numbered)
    stalls = tuple((s + 0.0137 * s, s + 0.0137 * s + stall_s) for s in range(20, 80, 3))
    run(line, 90, bundle_s=bundle_s, stalls=stalls)
    assert line.lost == 0
    assert abs(line.interval_error()) < 5e-4
    # No stamp lies after its packet's arrival, and all is well again a second later.
    calm = [abs(e) for e, t in zip(line.errors_s(), line.true_s, strict=True) if t > 82 or 10 < t < 20]
    assert max(calm) < 0.003


def test_packets_of_one_chunk_are_one_beat_apart() -> None:
    line = steady_line()
    line.deliver([101, 102, 103, 104], 10.4)
    assert [round(e, 6) for e in line.errors_s()[-4:]] == [0, 0, 0, 0]
    assert [s.steps for s in line.stamps[-4:]] == [1, 1, 1, 1]


@pytest.mark.parametrize("numbered", [False, True])
@pytest.mark.parametrize("lost", [1, 2, 5])
def test_a_loss_is_a_hole_and_not_a_longer_interval(lost: int, numbered: bool) -> None:
    line = make_line(10, 10, numbered)
    for n in [*range(1, 101), *range(101 + lost, 111 + lost)]:
        line.deliver([n], n / 10)
    after = line.stamps[100]
    assert after.steps == lost + 1
    assert after.interval_s == pytest.approx(0.1, rel=1e-6)
    assert (after.t_ns - line.stamps[99].t_ns) / NS_PER_S == pytest.approx(0.1 * (lost + 1), rel=1e-5)
    assert line.lost == lost


@pytest.mark.parametrize("lost", [127, 128, 129, 500])
def test_whole_turns_of_the_sequence_are_counted_by_time(lost: int) -> None:
    line = make_line(1000, 990, numbered=True)
    for n in [*range(1, 1001), *range(1001 + lost, 1101 + lost)]:
        line.deliver([n], n / 990)
    assert line.lost == lost
    assert np.abs(line.errors_s(after_s=0.5)).max() < 1e-4


def test_a_lone_late_packet_is_not_counted_as_a_loss() -> None:
    line = make_line(10, 10)
    for n in range(1, 201):
        line.deliver([n], n / 10 + (0.085 if n == 150 else 0))
    assert line.lost == 0
    assert line.clock.period_s == pytest.approx(0.1, rel=1e-6)
    assert np.abs(line.errors_s()[152:]).max() < 1e-3


@pytest.mark.parametrize("numbered", [False, True])
@pytest.mark.parametrize("parts", [(1, 7), (3, 5), (4, 16), (1, 1, 13), (1,) * 20])
def test_what_waited_for_a_stalled_host_keeps_its_times(parts: tuple[int, ...], numbered: bool) -> None:
    """A serial line may hand over in parts what came in 0.8 to 2 s; then packets come at the beat again."""
    line, number = steady_line(numbered), 101
    line.clock.stalled()
    end_s = (number + sum(parts) - 1) / 10 + 0.02
    for count in parts:
        line.deliver(list(range(number, number + count)), end_s)
        number, end_s = number + count, end_s + 0.003
    for n in range(number, number + 20):
        line.deliver([n], n / 10)
    assert line.lost == 0
    assert np.abs(line.errors_s()).max() < 0.02


@pytest.mark.parametrize("in_parts", [False, True])
def test_bundles_of_a_slow_numbered_sensor_keep_its_period(in_parts: bool) -> None:
    """Two or three packets every 0.242 s, read at once or one by one: eight of them end within a bundle."""
    line = steady_line(numbered=True)
    for begin in range(40):
        numbers = [n for n in range(101, 200) if 10.0 + 0.242 * begin < n / 10 <= 10.0 + 0.242 * (begin + 1)]
        for part in [[n] for n in numbers] if in_parts else [numbers]:
            line.deliver(part, 10.0 + 0.242 * (begin + 1))
    assert abs(line.interval_error(after_s=10.0)) < 0.01
    assert np.abs(line.errors_s(after_s=10.0)).max() < 0.12


def test_bunches_that_are_read_in_parts_are_no_losses() -> None:
    """Some four packets every 0.387 s, the older half of each 1 ms before the others: only the newest is fresh."""
    line, every_s = steady_line(), 0.387
    for begin in range(60):
        numbers = [n for n in range(101, 400) if 10.0 + every_s * begin < n / 10 <= 10.0 + every_s * (begin + 1)]
        half = len(numbers) // 2
        line.deliver(numbers[:half], 10.0 + every_s * (begin + 1))
        line.deliver(numbers[half:], 10.0 + every_s * (begin + 1) + 0.001)
    assert line.lost <= 1  # the first bunch, before which nothing tells of any
    assert np.abs(line.errors_s(after_s=11.0)).max() < 0.12


def test_a_loss_that_a_stall_hides_is_found_once_packets_come_at_their_beat() -> None:
    line = steady_line()
    line.clock.stalled()
    for n in range(101, 130):
        if n not in {110, 111}:  # of 29 that waited
            line.deliver([n], 13.0)
    for n in range(130, 180):
        line.deliver([n], n / 10)
    assert np.abs(line.errors_s(after_s=14.5)).max() < 0.01


def test_a_loss_after_a_stall_is_a_hole_as_any_other() -> None:
    line = steady_line()
    line.clock.stalled()
    line.deliver(list(range(101, 109)), 10.82)
    for n in (109, 110, 113, 114, 115, 116):
        line.deliver([n], n / 10)
    assert line.lost == 2
    assert np.abs(line.errors_s()).max() < 0.01


@pytest.mark.parametrize("numbered", [False, True])
@pytest.mark.parametrize("silence_s", [1.03, 7.77, 100.01])
def test_after_a_silence_the_phase_is_found_again(silence_s: float, numbered: bool) -> None:
    """As after the sensor was switched off and on: its beat begins anew, its numbers too."""
    line = make_line(10, 10.2, numbered)
    for n in range(1, 301):
        line.deliver([n], n / 10.2)
    period_s = line.clock.period_s
    begin_s = 300 / 10.2 + silence_s
    for n in range(1, 101):
        line.deliver([n], begin_s + n / 10.2, beat_from_s=begin_s)
    assert np.abs(line.errors_s(after_s=begin_s)).max() < 0.001
    assert line.clock.period_s == pytest.approx(period_s, rel=1e-4)
    assert line.clock.counters["clock_relocks"] == 0


@pytest.mark.parametrize("numbered", [False, True])
def test_a_beat_that_changes_its_phase_is_locked_to_again(numbered: bool) -> None:
    line, rng = make_line(10, 10, numbered), np.random.default_rng(11)
    for n in range(1, 301):
        line.deliver([n], n / 10 + rng.uniform(0, 0.016))
    # The sensor restarted at once: its numbers begin anew and its packets come at another time of the beat.
    for n in range(1, 101):
        line.deliver([n], 30.06 + n / 10 + rng.uniform(0, 0.016), beat_from_s=30.06)
    assert np.abs(line.errors_s(after_s=33)).max() < 0.005
    assert line.lost == 0
    assert line.clock.counters["clock_relocks"] == 1
    # The beat's length was known all the time.
    assert max(abs(s.interval_s - 0.1) for s in line.stamps[300:]) < 5e-4


@pytest.mark.parametrize("bundle_s", [0.0995, 0.108])
def test_numbers_that_go_on_are_those_of_a_beat_that_does(bundle_s: float) -> None:
    """Bundles about as long as a period hold packets up by almost one, more or less from one to the next."""
    line = make_line(10, 10, numbered=True)
    for n in range(1, 301):
        line.deliver([n], n / 10)
    for n in range(301, 451):
        line.deliver([n], np.ceil(n / 10 / bundle_s) * bundle_s)
    assert np.abs(line.errors_s()).max() < 0.012
    assert line.clock.period_s == pytest.approx(0.1, rel=2e-3)
    assert line.lost == 0


@pytest.mark.parametrize("bundle_s", [0.305, 0.33])
def test_bundles_in_a_row_are_a_habit_and_no_loss(bundle_s: float) -> None:
    """Their newest packet is up to a period old, and none is missing where one holds a packet less."""
    line = make_line(10, 10)
    for n in range(1, 301):
        line.deliver([n], n / 10)
    numbers = np.arange(301, 451)
    bundles = np.ceil((numbers / 10 - 30.0) / bundle_s)
    for bundle in np.unique(bundles)[:-1]:  # the last one is not whole
        line.deliver(numbers[bundles == bundle].tolist(), 30.0 + bundle * bundle_s)
    assert np.abs(line.errors_s()).max() < 0.012
    assert line.lost == 0


def test_losses_in_bundles_are_not_taken_back() -> None:
    """Late packets draw the phase before several of them show the loss: an early one tells little then."""
    lost = counted = 0
    for seed in range(12):
        rng = np.random.default_rng(seed)
        true_hz, begin_s = 20.0 * (1.0 + rng.uniform(-0.03, 0.03)), rng.uniform(0, 0.12)
        line, numbers = make_line(20, true_hz), np.arange(1, 2400)
        is_lost = (rng.random(len(numbers)) < 0.005) & (numbers > 100) & (numbers < 2340)
        bundles = np.ceil((numbers / true_hz + 0.001 - begin_s) / 0.12)
        for bundle in np.unique(bundles):
            if (here := numbers[(bundles == bundle) & ~is_lost]).size:
                line.deliver(here.tolist(), begin_s + 0.12 * bundle)
        lost, counted = lost + int(is_lost.sum()), counted + line.lost
    assert 0.95 * lost < counted <= lost


def test_packets_that_come_twice_are_no_beats() -> None:
    line, rng = make_line(10, 10), np.random.default_rng(5)
    for n in range(1, 601):
        line.deliver([n, n] if n > 200 and rng.random() < 0.17 else [n], n / 10 + rng.exponential(0.001))
    assert line.clock.period_s == pytest.approx(0.1, rel=1e-3)
    assert line.clock.counters == {"lost_packets": 0, "clock_relocks": 0}


def test_a_bunch_that_begins_is_no_loss_for_long() -> None:
    """Its first packet is late by most of a period; the next one is too early for a beat with a loss."""
    line = make_line(10, 10)
    for n in range(1, 301):
        line.deliver([n], n / 10)
    line.deliver([301], 30.189)
    for k in range(1, 20):
        end_s = 30.0 + 0.189 * (k + 1)
        line.deliver([n for n in range(302, 400) if end_s - 0.189 < n / 10 <= end_s], end_s)
    assert line.lost == 0
    assert np.abs(line.errors_s(after_s=30.15)).max() < 0.012


def test_a_slower_sensor_after_a_restart_is_not_taken_for_one_that_loses_packets() -> None:
    line = steady_line()
    line.clock.restart()
    line.rate_hz = 2
    for n in range(1, 101):
        line.deliver([n], 20 + n / 2, beat_from_s=20)
    assert line.lost == 0
    assert line.clock.period_s == pytest.approx(0.5, rel=1e-3)


def test_one_late_read_does_not_hide_a_loss_soon_after() -> None:
    line = steady_line()
    line.deliver([101, 102], 10.2)
    for n in (103, 105, 106, 107, 108):
        line.deliver([n], n / 10)
    assert np.abs(line.errors_s()).max() < 1e-3
    assert line.lost == 1


def test_a_rate_that_changes_while_running_is_followed() -> None:
    line = make_line(10, 10)
    for n in range(1, 201):
        line.deliver([n], n / 10)
    line.rate_hz = 50
    for n in range(1, 501):
        line.deliver([n], 20 + n / 50, beat_from_s=20)
    assert line.clock.period_s == pytest.approx(0.02, rel=1e-3)
    assert line.clock.counters["clock_relocks"] >= 1
    assert np.abs(line.errors_s(after_s=25)).max() < 0.003


def test_a_restart_keeps_the_beat_and_counts_no_loss() -> None:
    line = make_line(10, 10.3, numbered=True)
    for n in range(1, 301):
        line.deliver([n], n / 10.3)
    line.clock.restart()
    for n in range(340, 440):
        line.deliver([n], n / 10.3)
    assert line.lost == 0
    assert abs(line.clock.period_s * 10.3 - 1) < 1e-4
    assert np.abs(line.errors_s(after_s=330 / 10.3)).max() < 0.001


def test_a_clock_drift_with_temperature_is_followed() -> None:
    """0.2 % in ten minutes, the DSP-3000's whole temperature range."""
    line, rng = make_line(10, 10), np.random.default_rng(7)
    t_s, errors_s = 0.0, []
    for n in range(6000):
        t_s += 0.1 * (1 + 0.002 * n / 6000)
        (stamp,) = line.clock.stamp([None], round((HOST_START_S + t_s + rng.uniform(0, 0.002)) * NS_PER_S))
        errors_s.append(stamp.t_ns / NS_PER_S - HOST_START_S - t_s)
    assert np.abs(errors_s[600:]).max() < 0.004
    assert line.clock.period_s == pytest.approx(0.1002, rel=1e-4)


def test_a_sensor_that_always_sends_the_same_number_still_has_a_beat() -> None:
    clock = SampleClock(10, MODULUS)
    stamps = [clock.stamp([17], n * NS_PER_S // 10)[0] for n in range(1, 200)]
    assert clock.counters == {"lost_packets": 0, "clock_relocks": 0}
    assert stamps[-1].t_ns == pytest.approx(19.9 * NS_PER_S, abs=1e6)


def test_nothing_received_is_nothing_stamped() -> None:
    clock = SampleClock(10, None)
    assert clock.stamp([], 5) == []
    assert clock.period_s == 0.1


ARRIVALS = st.lists(
    st.tuples(
        st.one_of(st.integers(0, 10**8), st.sampled_from([0, 10**8, 10**12, -(10**9), -(10**11)])),
        st.lists(st.one_of(st.none(), st.integers(0, 127)), max_size=5),
    ),
    max_size=120,
)


@settings(deadline=None)
@given(ARRIVALS, st.sampled_from([0.5, 10.0, 2000.0]), st.sampled_from([None, MODULUS]))
def test_whatever_arrives_stamps_increase_and_intervals_are_positive(
    arrivals: list[tuple[int, list[int | None]]], rate_hz: float, modulus: int | None
) -> None:
    clock, now_ns, stamps = SampleClock(rate_hz, modulus), 10**15, []
    for wait_ns, sequences in arrivals:
        now_ns += wait_ns
        new = clock.stamp(sequences, now_ns)
        assert len(new) == len(sequences)
        stamps += new
    assert all(later.t_ns > earlier.t_ns for earlier, later in pairwise(stamps))
    assert all(0 < s.interval_s < 1e6 and s.steps >= 1 for s in stamps)
    assert all(count >= 0 for count in clock.counters.values())
