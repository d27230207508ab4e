"""What is known of the robot, from whatever arrives."""

import json
from typing import Any

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from web_robot import HEALTH, pose_payload

from drd_tools.web.daemon import Heard
from drd_tools.web.metrics import metrics_text
from drd_tools.web.state import State

ANY: st.SearchStrategy[Any] = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=10),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=4),
    max_leaves=8,
)
POSE_FIELDS, HEALTH_FIELDS = st.sampled_from([*json.loads(pose_payload())]), st.sampled_from([*HEALTH])


def test_poses_are_counted_and_so_are_those_that_are_missing() -> None:
    state = State()
    for sequence in (1, 2, 5, 1, 2):  # three and four are lost, then the daemon starts anew
        state.take_poses([Heard(pose_payload(sequence), 10.0, 0)])
    assert state.counters == {"poses_received": 5, "poses_lost": 2, "messages_unreadable": 0}


def test_delay_rate_and_age_are_those_of_the_arrivals() -> None:
    state = State()
    for i in range(100):
        state.take_poses([Heard(pose_payload(i, wall_ns=10**9), 10.0 + 0.05 * i, 10**9 + i * 10**6)])
    assert state.rate_hz(14.95) == pytest.approx(20.0, abs=0.4)
    assert state.pose_age_s(15.95) == pytest.approx(1.0)
    assert state.delays_s() == pytest.approx({0.5: 0.05, 0.9: 0.09, 0.99: 0.099})
    assert state.delay_sum_s == pytest.approx(4.95)


def test_the_rate_of_the_fastest_encoders_is_that_of_the_arrivals() -> None:
    state = State()
    for i in range(5000):
        state.take_poses([Heard(pose_payload(i), 10.0 + 0.001 * i, 0)])
    assert state.rate_hz(15.0) == pytest.approx(1000.0, abs=1.0)


def test_the_pages_time_goes_on_evenly() -> None:
    state = State()
    assert state.wall_s(101.5) - state.wall_s(100.0) == pytest.approx(1.5)


@given(st.binary(max_size=60) | st.dictionaries(POSE_FIELDS, ANY, max_size=3).map(lambda changes: changes))
@settings(deadline=None)
def test_whatever_comes_as_a_pose_is_shown_or_counted(changes: bytes | dict[str, Any]) -> None:
    state = State()
    payload = changes if isinstance(changes, bytes) else json.dumps(json.loads(pose_payload()) | changes).encode()
    state.take_poses([Heard(payload, 1.0, 0)])
    assert state.counters["poses_received"] + state.counters["messages_unreadable"] == 1
    msgspec.json.encode(state.pose_message(1))
    assert metrics_text(state, 1.0, True, 0, 0)


@given(st.binary(max_size=60) | st.dictionaries(HEALTH_FIELDS, ANY, max_size=3))
@settings(deadline=None)
def test_whatever_comes_as_health_is_told_or_counted(changes: bytes | dict[str, Any]) -> None:
    state = State()
    payload = changes if isinstance(changes, bytes) else json.dumps(HEALTH | changes).encode()
    readable = state.take_health(Heard(payload, 1.0, 0))
    assert readable != bool(state.counters["messages_unreadable"])
    json.loads(msgspec.json.encode(state.health_message))
    assert metrics_text(state, 1.0, True, 0, 0)


def test_deep_nesting_and_endless_numbers_are_unreadable_or_told() -> None:
    state = State()
    for payload in (b'{"a":' * 100_000, b'{"a":' * 900 + b"1" + b"}" * 900, b'{"uptime_s":' + b"9" * 6000 + b"}"):
        state.take_health(Heard(payload, 1.0, 0))
        state.take_poses([Heard(payload, 1.0, 0)])
        assert metrics_text(state, 1.0, True, 0, 0)
    assert state.take_health(Heard(b'{"uptime_s":' + b"9" * 300 + b"}", 1.0, 0))
    assert "drd_uptime_seconds" in metrics_text(state, 1.0, True, 0, 0)
