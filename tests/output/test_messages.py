import contextlib
import json
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drd.output.messages import MAX_REQUEST_BYTES, Refused, decode_request, encode, pose_json
from drd.samples import Pose, Reason, Validity

ANY_FLOAT = st.floats()
VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | ANY_FLOAT | st.text(max_size=20) | st.sampled_from(Validity),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5) | ANY_FLOAT, inner, max_size=4),
    max_leaves=12,
)


def strict(data: bytes) -> Any:
    def refuse(text: str) -> None:
        raise AssertionError(f"{text} is not JSON")

    return json.loads(data, parse_constant=refuse)


def a_pose(**changes: Any) -> Pose:
    values: dict[str, Any] = {
        "t_ns": 5_000_000_000,
        "sequence": 7,
        "x_m": 1.5,
        "y_m": -2.25,
        "heading_rad": 7.0,
        "speed_m_s": 0.5,
        "rate_rad_s": -0.125,
        "speed_sigma_m_s": 0.0625,
        "rate_sigma_rad_s": 0.03125,
        "covariance": (0.1, 0.2, 0.3, 0.4, 0.5, 0.6),
        "position_bound_m": 0.75,
        "validity": Validity.DEGRADED,
        "reasons": (Reason("encoders", "silent", 3_500_000_000),),
    }
    return Pose(**(values | changes))


def test_a_pose_is_json_with_units_in_its_names() -> None:
    assert strict(pose_json(a_pose(), 1_700_000_000_123_456_789)) == {
        "sequence": 7,
        "monotonic_ns": 5_000_000_000,
        "wall_ns": 1_700_000_000_123_456_789,
        "x_m": 1.5,
        "y_m": -2.25,
        "heading_rad": 7.0,
        "speed_m_s": 0.5,
        "rate_rad_s": -0.125,
        "speed_sigma_m_s": 0.0625,
        "rate_sigma_rad_s": 0.03125,
        "covariance_m_rad": [[0.1, 0.2, 0.3], [0.2, 0.4, 0.5], [0.3, 0.5, 0.6]],
        "position_bound_99_m": 0.75,
        "validity": "degraded",
        "reasons": [{"source": "encoders", "text": "silent", "since_s": 1.5}],
    }


@given(ANY_FLOAT, ANY_FLOAT, ANY_FLOAT)
@settings(deadline=None)
def test_a_number_that_is_not_finite_becomes_null_and_every_other_arrives_exactly(
    x_m: float, heading_rad: float, xx: float
) -> None:
    got = strict(pose_json(a_pose(x_m=x_m, heading_rad=heading_rad, covariance=(xx, 0, 0, 0, 0, 0)), 0))
    for value, sent in ((got["x_m"], x_m), (got["heading_rad"], heading_rad), (got["covariance_m_rad"][0][0], xx)):
        assert value == sent if math.isfinite(sent) else value is None


@given(st.dictionaries(st.text(max_size=5), VALUES, max_size=4))
@settings(deadline=None)
def test_any_health_becomes_strict_json(payload: dict[str, Any]) -> None:
    assert isinstance(strict(encode(payload)), dict)


def test_numpy_values_and_strangers_become_plain_json() -> None:
    payload = {
        "a": np.float64("nan"),
        "b": np.int32(4),
        "c": np.array([1.0, np.inf]),
        "d": {3},
        "e": object,
        "f": np.bool_(1),
    }
    got = strict(encode(payload))
    assert got | {"e": ""} == {"a": None, "b": 4, "c": [1.0, None], "d": [3], "e": "", "f": True}
    assert isinstance(got["e"], str)


def test_an_empty_request_is_an_empty_object() -> None:
    assert decode_request(b"") == {}


def test_a_request_is_read() -> None:
    assert decode_request(b' {"x_m": 1.5, "n": [1, "a", null]}') == {"x_m": 1.5, "n": [1, "a", None]}


@pytest.mark.parametrize(
    "data",
    [
        b"{",
        b"[]",
        b"null",
        b"1",
        b'"text"',
        b"\xff\xfe",
        b'{"x": NaN}',
        b'{"x": -Infinity}',
        b'{"x": 1e999}',
        b'{"x": ' + b"9" * 400 + b"}",
        b"[" * MAX_REQUEST_BYTES,
        b'{"x":' * 800,
        b" " * MAX_REQUEST_BYTES + b"{}",
    ],
)
def test_a_payload_that_is_no_request_is_refused(data: bytes) -> None:
    with pytest.raises(Refused):
        decode_request(data)


@given(st.binary(max_size=200) | st.text(alphabet='{}[]":,0123eE+-.nulNaInfity ', max_size=200).map(str.encode))
@settings(deadline=None)
def test_only_refused_escapes_from_a_request(data: bytes) -> None:
    with contextlib.suppress(Refused):
        value = decode_request(data)
        assert isinstance(value, dict)
        strict(encode(value))
