"""Checked messages of the daemon: whatever arrives becomes one of these or is counted as unreadable."""

from typing import Annotated, Any, Final, Literal

import msgspec

VALIDITIES: Final = ("initialising", "valid", "degraded", "invalid")
Whole = Annotated[int, msgspec.Meta(ge=0, le=2**63 - 1)]  # a longer one overflows as a float


class Reason(msgspec.Struct):
    """Reason why a pose is not fully valid, since `since_s` seconds before it."""

    source: str
    text: str
    since_s: float


class Pose(msgspec.Struct):
    """The fields of `drd/pose` that are shown; drd/output/README.md has their meaning."""

    sequence: Whole
    wall_ns: Whole
    x_m: float
    y_m: float
    heading_rad: float
    speed_m_s: float
    rate_rad_s: float
    covariance_m_rad: tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]
    position_bound_99_m: float
    validity: Literal["initialising", "valid", "degraded", "invalid"]
    reasons: list[Reason]


def read_pose(payload: bytes) -> Pose | None:
    """Read a pose; None: unreadable."""
    try:
        return msgspec.json.decode(payload, type=Pose)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return None


def read_health(payload: bytes) -> dict[str, Any] | None:
    """Read the health without a schema, since it may differ between daemon versions; None: unreadable."""
    try:
        return msgspec.json.decode(payload, type=dict[str, Any])
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return None
