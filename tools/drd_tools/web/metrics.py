"""Metrics for Prometheus: text format 0.0.4, with names and units by its conventions.

Values that are unknown, or older than GONE_S, are left out, as the conventions require; `drd_up` and the ages remain.
"""

import math
import re
from collections.abc import Iterator, Mapping
from typing import Any, Final, TypeGuard

from drd_tools.web.messages import VALIDITIES, Pose
from drd_tools.web.state import SILENT_S, State

CONTENT_TYPE: Final = "text/plain; version=0.0.4"
GONE_S: Final = 10.0
_S_PER_MS: Final = 1e-3

Labels = Mapping[str, str]
Sample = tuple[str, Labels, float]  # suffix of the family's name ("_sum", or none), labels, value


def metrics_text(state: State, now_s: float, alive: bool, browsers: int, dropped: int) -> str:
    """All metrics at `now_s` (CLOCK_MONOTONIC)."""
    pose_age_s, health_age_s = state.pose_age_s(now_s), state.health_age_s(now_s)
    lines = [*_own(state, alive, pose_age_s, health_age_s, browsers, dropped)]
    if state.pose is not None and pose_age_s is not None and pose_age_s < GONE_S:
        lines += _pose(state.pose)
    if health_age_s is not None and health_age_s < GONE_S:
        lines += [*_health(state.health), *_learned(state.health), *_counters(state.health.get("counters"))]
    return "\n".join(lines) + "\n"


def _own(
    state: State, alive: bool, pose_age_s: float | None, health_age_s: float | None, browsers: int, dropped: int
) -> Iterator[str]:
    is_up = alive and pose_age_s is not None and pose_age_s < SILENT_S
    yield from _gauge("drd_up", f"1 while the daemon is there and a pose came within {SILENT_S:g} s", is_up)
    yield from _gauge("drd_pose_age_seconds", "time since the newest pose came", pose_age_s)
    yield from _gauge("drd_health_age_seconds", "time since the newest health came", health_age_s)
    count = float(state.counters["poses_received"])
    delays: list[Sample] = [("", {"quantile": f"{q:g}"}, s) for q, s in state.delays_s().items()]
    samples = [*delays, ("_sum", {}, state.delay_sum_s), ("_count", {}, count)]
    text = "from the pose's time to its arrival here, by the two machines' clocks; quantiles of the newest 1200 poses"
    yield from _family("drd_pose_delay_seconds", "summary", text, samples)
    for name, help_text in (
        ("poses_received", "poses that came"),
        ("poses_lost", "poses missing in the sequence"),
        ("messages_unreadable", "messages that are no pose or health"),
    ):
        yield from _counter(f"drd_{name}_total", help_text, state.counters[name])
    yield from _gauge("drd_web_browsers", "browsers that are connected", browsers)
    yield from _counter("drd_web_messages_dropped_total", "messages that a slow browser did not get", dropped)


def _pose(pose: Pose) -> Iterator[str]:
    states: list[Sample] = [("", {"state": name}, float(name == pose.validity)) for name in VALIDITIES]
    yield from _family("drd_validity", "gauge", "1 for the pose's validity, 0 for the others", states)
    text = "how long this source has been a reason why the pose is not simply valid"
    reasons = {reason.source: reason.since_s for reason in pose.reasons}
    yield from _family("drd_reason_seconds", "gauge", text, [("", {"source": k}, s) for k, s in reasons.items()])
    for name, help_text, value in (
        ("position_x_meters", "forward of the origin", pose.x_m),
        ("position_y_meters", "to the left of the origin", pose.y_m),
        (
            "position_bound_99_meters",
            "radius that holds the true position in 99 of 100 cases",
            pose.position_bound_99_m,
        ),
        ("heading_radians", "counter-clockwise, whole turns kept", pose.heading_rad),
        ("heading_sigma_radians", "its standard deviation", math.sqrt(max(0.0, pose.covariance_m_rad[2][2]))),
        ("speed_meters_per_second", "forward speed", pose.speed_m_s),
        ("yaw_rate_radians_per_second", "yaw rate", pose.rate_rad_s),
    ):
        yield from _gauge(f"drd_{name}", help_text, value)


def _health(health: Mapping[str, Any]) -> Iterator[str]:
    about = {"robot": str(health.get("robot")), "version": str(health.get("version"))}
    yield from _family("drd_info", "gauge", "the daemon", [("", about, 1.0)])
    yield from _gauge("drd_uptime_seconds", "since the daemon's start", health.get("uptime_s"))
    for what in ("fog", "wheel", "pose"):
        yield from _gauge(f"drd_{what}_rate_hertz", "measured by the daemon", health.get(f"{what}_rate_hz"))
    for what in ("mean", "max"):
        text = f"{what} of the last period, from an input's arrival at the daemon to its pose"
        milliseconds = health.get(f"latency_{what}_ms")
        seconds = milliseconds * _S_PER_MS if _is_number(milliseconds) else None
        yield from _gauge(f"drd_latency_{what}_seconds", text, seconds)
    yield from _gauge("drd_fog_temperature_celsius", "told by the gyro", health.get("fog_temperature_c"))


def _learned(health: Mapping[str, Any]) -> Iterator[str]:
    learned = health.get("learned")
    learned = learned if isinstance(learned, dict) else {}
    for part, text in (("value", "what the filter has learned"), ("sigma", "its standard deviation")):
        values: dict[str, Any] = {k: entry.get(part) for k, entry in learned.items() if isinstance(entry, dict)}
        samples: list[Sample] = [("", {"quantity": k}, v) for k, v in values.items() if _is_number(v)]
        yield from _family(
            f"drd_learned_{part}", "gauge", f"{text}, in the unit that the quantity's name ends with", samples
        )


def _counters(counters: Any) -> Iterator[str]:
    seen = set()
    for part, counts in counters.items() if isinstance(counters, dict) else ():
        for name, count in counts.items() if isinstance(counts, dict) else ():
            family = re.sub(r"[^a-z0-9_]", "_", f"drd_{part}_{name}_total".lower())
            if _is_number(count) and count >= 0 and family not in seen:
                seen.add(family)
                yield from _counter(family, f"{part}: {name}, counted by the daemon", count)


def _gauge(name: str, text: str, value: Any) -> Iterator[str]:
    return _family(name, "gauge", text, [("", {}, value)] if _is_number(value) else [])


def _counter(name: str, text: str, value: float) -> Iterator[str]:
    return _family(name, "counter", text, [("", {}, value)])


def _family(name: str, kind: str, text: str, samples: list[Sample]) -> Iterator[str]:
    if not samples:
        return
    yield f"# HELP {name} {_escaped(text)}"
    yield f"# TYPE {name} {kind}"
    for suffix, labels, value in samples:
        inside = ",".join(f'{key}="{_escaped(label)}"' for key, label in labels.items())
        yield f"{name}{suffix}{f'{{{inside}}}' if inside else ''} {float(value)!r}"


def _is_number(value: Any) -> TypeGuard[float]:
    return isinstance(value, int | float) and abs(value) < 1e300  # a longer integer is no float


def _escaped(text: str) -> str:
    return text.replace("\\", r"\\").replace("\n", r"\n").replace('"', r"\"")
