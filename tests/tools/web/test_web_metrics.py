"""/metrics, read by Prometheus' own client."""

import json
import re
from typing import Any

import pytest
from prometheus_client.parser import text_string_to_metric_families
from web_robot import HEALTH, pose_payload

from drd_tools.web.daemon import Heard
from drd_tools.web.metrics import GONE_S, metrics_text
from drd_tools.web.state import State


def state(health: dict[str, Any] = HEALTH, **pose: Any) -> State:
    made = State()
    for i in range(10):
        made.take_poses([Heard(pose_payload(i, **pose), 100.0, 1_000_000_000 + i * 1_000_000)])
    made.take_health(Heard(json.dumps(health).encode(), 100.0, 0))
    return made


def values(text: str) -> dict[tuple[str, str], float]:
    """By name and the labels' values."""
    return {
        (sample.name, ",".join(sample.labels.values())): sample.value
        for family in text_string_to_metric_families(text)
        for sample in family.samples
    }


def test_what_prometheus_reads_is_what_is_known() -> None:
    reason = {"source": "fog", "text": "silent", "since_s": 2.5}
    found = values(metrics_text(state(validity="degraded", reasons=[reason]), 100.5, True, 3, 4))
    assert found["drd_up", ""] == 1
    assert found["drd_pose_age_seconds", ""] == pytest.approx(0.5)
    assert found["drd_pose_delay_seconds", "0.5"] == pytest.approx(0.005)
    assert found["drd_pose_delay_seconds_sum", ""] == pytest.approx(0.045)
    assert found["drd_pose_delay_seconds_count", ""] == found["drd_poses_received_total", ""] == 10
    assert [found["drd_validity", s] for s in ("initialising", "valid", "degraded", "invalid")] == [0, 0, 1, 0]
    assert found["drd_reason_seconds", "fog"] == 2.5
    assert found["drd_position_bound_99_meters", ""] == 0.9
    assert found["drd_heading_sigma_radians", ""] == pytest.approx(0.01)
    assert found["drd_latency_max_seconds", ""] == pytest.approx(0.002)
    assert found["drd_fog_rate_hertz", ""] == 10
    assert found["drd_learned_value", "tread_m"] == 0.61
    assert ("drd_learned_sigma", "wheel_jitter_s") not in found
    assert found["drd_fog_samples_total", ""] == 77
    assert found["drd_encoders_port_opens_total", ""] == 1
    assert found["drd_info", "carousel,1.2.3"] == 1
    assert found["drd_web_browsers", ""] == 3
    assert found["drd_web_messages_dropped_total", ""] == 4


def test_names_and_types_follow_prometheus_conventions() -> None:
    text = metrics_text(state(), 100.0, True, 0, 0)
    families = list(text_string_to_metric_families(text))
    names = [family.name for family in families]
    assert len(names) == len(set(names))
    for family in families:
        assert re.fullmatch(r"drd_[a-z0-9_]+", family.name)
        assert family.documentation
        assert not re.search(r"_(ms|hz|m|s|rad|percent)$", family.name), "base units, in words"
        if family.type == "counter":
            assert all(sample.name.endswith("_total") for sample in family.samples)
        else:
            assert not family.name.endswith("_total")
    assert text.endswith("\n")


def test_what_is_old_is_left_out_and_the_ages_remain() -> None:
    found = values(metrics_text(state(), 100.0 + GONE_S, True, 0, 0))
    assert found["drd_up", ""] == 0
    assert found["drd_pose_age_seconds", ""] == GONE_S
    assert {"drd_validity", "drd_info", "drd_fog_samples_total"}.isdisjoint(name for name, _ in found)
    assert values(metrics_text(state(), 100.0, False, 0, 0))["drd_up", ""] == 0
    assert values(metrics_text(State(), 100.0, False, 0, 0))["drd_poses_received_total", ""] == 0


def test_names_from_the_network_cannot_break_the_format() -> None:
    strange = {
        "robot": 'a"b\\c\nd',
        "counters": {'x"} 1\n': {"Ü n": 5, "b": True, "c": -1}, "x": {"y": 1}, "X": {"Y": 2}},
    }
    found = values(metrics_text(state(HEALTH | strange), 100.0, True, 0, 0))
    assert found["drd_info", 'a"b\\c\nd,1.2.3'] == 1
    assert found["drd_x___1____n_total", ""] == 5
    assert found["drd_x_y_total", ""] == 1
