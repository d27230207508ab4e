"""The daemon's messages as JSON: strict (no NaN or Infinity), compact, units in the names."""

import json
import math
from collections.abc import Mapping
from contextlib import suppress
from enum import Enum
from typing import Any

import msgspec

from drd.samples import Pose
from drd.units import S_PER_NS

MAX_REQUEST_BYTES = 4096

_ENCODER = json.JSONEncoder(separators=(",", ":"), allow_nan=False)


class Refused(Exception):  # noqa: N818  # an outcome, not a fault: the sender gets the reason and nothing stops
    """A request is refused; the text says why and goes back to the sender."""


def pose_dict(pose: Pose, wall_ns: int) -> dict[str, Any]:
    """The pose as plain values; `wall_ns` is CLOCK_REALTIME at `pose.t_ns`.

    `covariance_m_rad` is the full 3x3 matrix of x, y, heading (m^2, m rad, rad^2), `since_s` the time from a reason's
    start to the pose. `heading_rad` is not wrapped.
    """
    xx, xy, xh, yy, yh, hh = pose.covariance
    return {
        "sequence": pose.sequence,
        "monotonic_ns": pose.t_ns,
        "wall_ns": wall_ns,
        "x_m": pose.x_m,
        "y_m": pose.y_m,
        "heading_rad": pose.heading_rad,
        "speed_m_s": pose.speed_m_s,
        "rate_rad_s": pose.rate_rad_s,
        "speed_sigma_m_s": pose.speed_sigma_m_s,
        "rate_sigma_rad_s": pose.rate_sigma_rad_s,
        "covariance_m_rad": [[xx, xy, xh], [xy, yy, yh], [xh, yh, hh]],
        "position_bound_99_m": pose.position_bound_m,
        "validity": pose.validity.value,
        "reasons": [
            {"source": r.source, "text": r.text, "since_s": round((pose.t_ns - r.since_ns) * S_PER_NS, 3)}
            for r in pose.reasons
        ],
    }


def pose_json(pose: Pose, wall_ns: int) -> bytes:
    """`pose_dict` as JSON."""
    return encode(pose_dict(pose, wall_ns))


def encode(value: Mapping[str, Any]) -> bytes:
    """Compact JSON in ASCII. Non-finite numbers become null; types unknown to JSON become text."""
    with suppress(TypeError, ValueError):  # it does not support numpy types
        data = msgspec.json.encode(value)
        if data.isascii():  # it does not escape
            return data
    return _ENCODER.encode(_plain(value)).encode("ascii")


def decode_request(data: bytes) -> dict[str, Any]:
    """A request's payload: a JSON object of finite numbers, or nothing. Raises Refused; nothing else escapes."""
    if len(data) > MAX_REQUEST_BYTES:
        raise Refused(f"payload of {len(data)} bytes; at most {MAX_REQUEST_BYTES} are read")
    if not data:
        return {}
    try:
        value = json.loads(data, parse_constant=_finite, parse_float=_finite, parse_int=_whole)
    except (ValueError, RecursionError) as error:
        raise Refused(f"payload is not JSON: {str(error)[:100]}") from None
    if not isinstance(value, dict):
        raise Refused(f"payload is not a JSON object but a {type(value).__name__}")
    return value


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"{text} is not a finite number")
    return value


def _whole(text: str) -> int:
    _finite(text)  # a longer one overflows wherever it is compared with a float
    return int(text)


def _plain(value: Any) -> Any:
    """The value in types of strict JSON."""
    if isinstance(value, Enum):
        value = value.value
    elif callable(tolist := getattr(value, "tolist", None)):  # numpy scalars and arrays
        value = tolist()
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [_plain(v) for v in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if value is None or isinstance(value, str | int) else str(value)
