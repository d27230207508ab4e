"""What is remembered of a robot: levels, leaks and changed tyres over simulated weeks, and what a drive begins with."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest
from emulated_demo import demo_config, emulated

from drd.monitor.findings import Finding, Size
from drd.monitor.lasting import LastingMonitor
from drd.monitor.library import TRAVEL, TURN
from drd.monitor.memory import DAY_NS, DAYS, EARLIEST_NS, Day, Memory, known, latest, remember
from drd.monitor.wear import CHANGED, LEAK, wear
from drd.samples import GyroSample, WheelSample

FIRST_NS = EARLIEST_NS + 1000 * DAY_NS  # 2026-09-27
SIGMA, SCATTER = 1e-4, 2e-4


def of_days(levels: np.ndarray, seed: int = 0) -> Memory:
    """A drive a day whose radii differ so, with the noise of a drive and of the days."""
    random, memory = np.random.default_rng(seed), Memory("a robot")
    for k, level in enumerate(levels.tolist()):
        value = level + SIGMA * random.standard_normal() + SCATTER * random.standard_normal()
        memory = remember(memory, Day(FIRST_NS + k * DAY_NS, 500.0, (0.0, value, 0.0), (1e-3, SIGMA, 0.1)))
    return memory


def feed(monitor: LastingMonitor, sample: GyroSample | WheelSample) -> None:
    if isinstance(sample, GyroSample):
        monitor.gyro(sample)
    else:
        monitor.wheels(sample)


def told(memory: Memory) -> list[Finding]:
    return wear(memory, memory.days[-1].wall_ns, 0)


def day_of(finding: Finding, memory: Memory) -> float:
    return (memory.days[-1].wall_ns + finding.since_ns - FIRST_NS) / DAY_NS


@pytest.mark.parametrize("seed", range(20))
def test_a_robot_that_stays_as_it_is_has_no_wear(seed: int) -> None:
    assert told(of_days(np.full(90, 0.002), seed)) == []


@pytest.mark.parametrize(("sign", "side"), [(-1.0, "left"), (1.0, "right")])
def test_a_slow_leak_is_told_with_its_date_side_and_rate(sign: float, side: str) -> None:
    memory = of_days(0.002 + sign * 0.0005 / 7.0 * np.maximum(np.arange(60) - 30, 0), 3)
    (finding,) = told(memory)
    assert finding.effect == LEAK
    assert finding.parameters["side"] == side
    weekly = finding.parameters["weekly"]
    assert isinstance(weekly, Size)
    assert abs(weekly.value - 0.0005) < 4.0 * weekly.std
    assert abs(day_of(finding, memory) - 30) < max(7.0, 3.0 * finding.since_std_s / 86_400.0)
    assert f"The {side} tyre has been losing" in finding.text
    assert finding.probability > 0.9


def test_a_changed_tyre_is_told_with_its_date_and_all_begins_anew() -> None:
    memory = of_days(np.r_[np.full(30, 0.002), np.full(5, -0.001)])
    (finding,) = told(memory)
    assert finding.effect == CHANGED
    assert day_of(finding, memory) == 30.0
    assert "between 2026-10-26 and 2026-10-27" in finding.text
    jump = finding.parameters["left_less_right"]
    assert isinstance(jump, Size)
    assert abs(jump.value + 0.003) < 4.0 * jump.std
    level = latest(memory.days, TRAVEL)
    assert (level.begin, level.slope) == (30, 0.0)
    assert abs(level.level + 0.001) < 4e-4


def test_a_leak_ends_where_the_tyre_is_changed() -> None:
    leak = 0.002 - 0.0007 / 7.0 * np.arange(40)
    memory = of_days(np.r_[leak, np.full(20, 0.002)])
    (finding,) = told(memory)
    assert (finding.effect, day_of(finding, memory)) == (CHANGED, 40.0)


def test_one_odd_day_is_nothing() -> None:
    assert told(of_days(np.r_[np.full(30, 0.002), 0.006])) == []


def test_drives_of_a_day_are_put_together_and_half_a_year_is_kept() -> None:
    memory, of_day = Memory("a robot"), Day(FIRST_NS, 1.0, (0.0, 0.001, 0.0), (1e-3, 1e-4, 0.1))
    for k in range(2 * DAYS):
        for hour in range(3):
            at_ns = FIRST_NS + (24 * k + hour) * DAY_NS // 24
            memory = remember(memory, msgspec.structs.replace(of_day, wall_ns=at_ns))
    assert len(memory.days) == DAYS
    assert memory.days[0].distance_m == 3.0
    assert memory.days[0].sigmas[1] == pytest.approx(1e-4 / np.sqrt(3.0))
    # With configuration and calibration it must fit into a packet of 64 KiB.
    assert len(msgspec.json.encode(memory)) < 45_000


def test_a_clock_that_was_not_set_or_ran_ahead_spoils_nothing() -> None:
    memory = of_days(np.full(10, 0.002))
    assert remember(memory, msgspec.structs.replace(memory.days[0], wall_ns=0)) == memory
    ahead = remember(memory, msgspec.structs.replace(memory.days[-1], wall_ns=FIRST_NS + 4000 * DAY_NS))
    again = remember(ahead, msgspec.structs.replace(memory.days[-1], wall_ns=FIRST_NS + 10 * DAY_NS))
    assert len(ahead.days) == len(again.days) == 11


def test_a_drive_that_tells_too_little_of_the_lag_is_no_day() -> None:
    """A straight line where `timing_s` is large: the daemon takes no day whose deviation is so large."""
    config, random = demo_config(), np.random.default_rng(0)
    noise = replace(config.estimation.noise, timing_s=0.2)
    config = replace(config, estimation=replace(config.estimation, noise=noise))
    monitor = LastingMonitor(config, Memory("a robot"), FIRST_NS, 0)
    for t_ns in range(50_000_000, 80_000_000_000, 50_000_000):
        monitor.gyro(GyroSample(t_ns, 0.05, float(random.normal(0.0, 1e-4)), 25.0))
        monitor.wheels(WheelSample(t_ns, 0.05, 0.025, 0.025, 0.0))
    monitor.findings()
    assert monitor.day is None


def test_a_drive_is_of_the_day_that_the_clock_tells_once_it_is_set() -> None:
    """A robot without a clock of its own hears the time on the way: what is remembered of later days must stay."""
    memory, ahead_ns = of_days(np.linspace(0.01, 0.002, 20)), 400 * DAY_NS
    monitor = LastingMonitor(demo_config(), memory, FIRST_NS + 20 * DAY_NS - ahead_ns, 0)
    days: list[Day] = []
    for sample in emulated(5, 160.0):
        feed(monitor, sample)
        monitor.findings()
        if monitor.day is not None and not days:
            days.append(monitor.day)
            monitor.clock(FIRST_NS + 20 * DAY_NS)
    assert monitor.day is not None
    days.append(monitor.day)
    assert [round((day.wall_ns - FIRST_NS) / DAY_NS) for day in days] == [-380, 20]
    assert [len(remember(memory, day).days) for day in days] == [1, 21]
    assert LEAK in {finding.effect for finding in monitor.findings()}


def test_a_drive_begins_with_what_is_known_and_sees_overnight_changes() -> None:
    config, drive = demo_config(), emulated(5, 150.0)
    monitors = [LastingMonitor(config, memory, FIRST_NS, 0) for memory in (Memory("a robot"), None)]
    for sample in drive:
        for monitor in monitors:
            feed(monitor, sample)
        monitors[0].findings()
    assert monitors[0].findings() == monitors[1].findings() == []
    assert monitors[1].day is None
    day = monitors[0].day
    assert day is not None
    # Of the emulated robot: 0.2 % between the radii, 2 % of tread less 0.3 % of the gyro's scale.
    for value, sigma, truth in zip(day.values[:2], day.sigmas[:2], (0.017, 0.002), strict=True):
        assert abs(value - truth) < 4.0 * sigma + 1e-3
    found = known(remember(Memory("a robot"), day), FIRST_NS)
    assert found is not None
    assert found.means[TRAVEL] == pytest.approx(day.values[1])
    assert found.sigmas[TURN] < 0.006
    # Overnight the left tyre has lost 1 %: seen from the start on.
    again = LastingMonitor(config, remember(Memory("a robot"), day), FIRST_NS + DAY_NS, 0)
    for sample in emulated(6, 150.0, lambda _: (0.01, 0.0)):
        feed(again, sample)
    (finding,) = again.monitor.findings()
    assert "wheel_radius_error" in {finding.effect, *(name for name, _ in finding.also_fits)}
