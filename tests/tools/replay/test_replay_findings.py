"""A replay's monitor beside the live one, and what it prints."""

import msgspec
import pytest
from emulated_demo import demo_config, emulated

from drd.monitor.constants import Constants
from drd.monitor.library import CHANGE, TRAVEL, TURN
from drd.monitor.monitor import Monitor
from drd.samples import GyroSample, WheelSample
from drd_tools.replay.findings import Live, Reported, monitored, sentences

KNOWN = Constants({TURN: 0.017, TRAVEL: 0.002, CHANGE: 0.0}, {TURN: 0.003, TRAVEL: 3e-4, CHANGE: 0.2})
BEFORE = 31  # samples that came before the live monitor was there


@pytest.fixture(scope="module")
def samples() -> list[GyroSample | WheelSample]:
    """From 60 s on the left wheel counts 1.5 % too much."""
    return emulated(3, 130.0, lambda t_s: (0.015 * (t_s > 60.0), 0.0))


@pytest.fixture(scope="module")
def live(samples: list[GyroSample | WheelSample]) -> Live:
    """As the recording of a daemon has it, through JSON."""
    monitor, live = Monitor(demo_config(), KNOWN), Live()
    for number, sample in enumerate(samples[BEFORE:]):
        if isinstance(sample, GyroSample):
            monitor.gyro(sample)
        else:
            monitor.wheels(sample)
        if number % 200 == 199:
            message = {"findings": monitor.findings(), "known": KNOWN, "began_ns": monitor.zero_ns}
            live.take(msgspec.json.decode(msgspec.json.encode(message)))
    return live


def replayed(samples: list[GyroSample | WheelSample], live: Live | None) -> Reported:
    gyro = [s for s in samples if isinstance(s, GyroSample)]
    wheels = [s for s in samples if isinstance(s, WheelSample)]
    return monitored(gyro, wheels, demo_config(), None, live)


def test_the_replay_says_what_the_live_monitor_said(samples: list[GyroSample | WheelSample], live: Live) -> None:
    told = replayed(samples, live)
    assert (live.starts, live.known) == (1, KNOWN)
    assert len(live.told) > 2
    assert told.comparison(live) == f"the live monitor's {len(live.told)} lists of findings are repeated to the bit"
    (text,) = sentences(told, samples[0].t_ns)
    assert text.startswith("monitor: ")
    assert "wheel_radius_error" in text


def test_other_samples_are_not_the_same(samples: list[GyroSample | WheelSample], live: Live) -> None:
    assert "are not those of the replay" in replayed(samples[: len(samples) // 2], live).comparison(live)


def test_a_monitor_that_began_twice_is_not_compared() -> None:
    twice = Live()
    for began_ns in (None, 1, 2):
        twice.take({"began_ns": began_ns, "findings": []})
    assert twice.starts == 2
    assert "began 2 times" in Reported([], None, frozenset()).comparison(twice)
    assert Reported([], None, frozenset()).comparison(Live()) == ""
