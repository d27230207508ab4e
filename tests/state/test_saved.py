"""State files: exact, checked, refused with a reason."""

import dataclasses
import hashlib
import json
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sensors import NO_BIAS, drive, feed, make

from drd.estimation.basis import Basis
from drd.estimation.estimate import Estimate, estimate_of
from drd.state.saved import Moment, Saved, decoded, encoded
from drd.state.sealed import StateError

MOMENT = Moment(1_700_000_000_123_456_789, 5_000_000_000, "abc")


def estimate(seconds: float = 20.0) -> Estimate:
    e = make(NO_BIAS)
    feed(e, drive(seconds))
    found = e.estimate()
    assert found is not None
    return found


DRIVEN = Saved(estimate(), MOMENT, Basis({"robot.tread_m": 0.5}, {"fog.axis": "z"}, {"model": {"who": "me"}}), "r2")


def sealed(body: bytes, version: int = 2) -> bytes:
    return f"drd-state/{version} sha256={hashlib.sha256(body).hexdigest()}\n".encode() + body


def changed(**values: Any) -> bytes:
    """A file with a right checksum and other values of the estimate."""
    content = json.loads(encoded(DRIVEN).split(b"\n", 1)[1])
    for path, value in values.items():
        inner, *names = content["estimate"], *path.split("__")
        for name in names[:-1]:
            inner = inner[name]
        inner[names[-1]] = value
    return sealed(json.dumps(content).encode())


def test_what_is_written_is_read_to_the_bit() -> None:
    read = decoded(encoded(DRIVEN))
    assert (read.moment, read.basis, read.robot) == (MOMENT, DRIVEN.basis, "r2")
    assert read.estimate.nominal == DRIVEN.estimate.nominal
    assert read.estimate.P.tobytes() == DRIVEN.estimate.P.tobytes()
    assert not read.estimate.at_rest
    assert read.estimate.speed_m_s == DRIVEN.estimate.speed_m_s


@settings(deadline=None)
@given(st.integers(0, len(encoded(DRIVEN)) - 1), st.integers(1, 255))
def test_any_changed_byte_is_noticed(where: int, flip: int) -> None:
    data = bytearray(encoded(DRIVEN))
    data[where] ^= flip
    with pytest.raises(StateError):
        decoded(bytes(data))


@settings(deadline=None)
@given(st.integers(0, len(encoded(DRIVEN)) - 1))
def test_a_cut_file_is_refused(length: int) -> None:
    with pytest.raises(StateError):
        decoded(encoded(DRIVEN)[:length])


@settings(deadline=None)
@given(st.binary(max_size=300))
def test_any_bytes_are_refused_with_a_text(body: bytes) -> None:
    for data in (body, sealed(body)):
        with pytest.raises(StateError) as caught:
            decoded(data)
        assert str(caught.value)


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=6,
)


@settings(deadline=None)
@given(
    st.sampled_from(["nominal", "P", "at_rest", "lost", "nominal__x_m", "nominal__tread_m", "P__0", "speed_m_s"]),
    json_values,
)
def test_wrong_values_under_a_right_checksum_raise_nothing_else(path: str, value: Any) -> None:
    content = json.loads(encoded(DRIVEN).split(b"\n", 1)[1])
    inner, *names = content["estimate"], *path.split("__")
    for name in names[:-1]:
        inner = inner[name]
    inner[int(names[-1]) if isinstance(inner, list) else names[-1]] = value
    try:
        read = decoded(sealed(json.dumps(content).encode()))
    except StateError:
        return
    assert math.isfinite(read.estimate.nominal.x_m)
    assert np.isfinite(read.estimate.P).all()


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({"nominal__tread_m": -0.5}, "nominal.tread_m: expected a number from 0.005"),
        ({"nominal__x_m": 1e12}, "nominal.x_m: expected"),
        ({"nominal__x_m": 10**400}, "out of range - at .*nominal.x_m"),  # found by the fuzzer: no float holds it
        ({"nominal__gyro_bias_rad_s": None}, r"Expected `float`, got `null` - at `\$.nominal.gyro_bias_rad_s`"),
        ({"at_rest": 1}, r"Expected `bool`, got `int` - at `\$.at_rest`"),
        ({"P": [[0.0] * 9] * 8}, r"Expected `array` of length >= 11 - at `\$.P`"),
        ({"P": (-np.eye(11)).tolist()}, "variances of at least 0"),
        ({"P": np.triu(np.ones((11, 11))).tolist()}, "symmetric"),
        ({"P": (np.eye(11) + 0.9 * (np.eye(11, k=1) + np.eye(11, k=-1))).tolist()}, "positive semidefinite"),
        ({"P": (np.diag([0.0] + [1.0] * 10) + 0.1 * (np.eye(11, k=1) + np.eye(11, k=-1))).tolist()}, "variance is 0"),
    ],
)
def test_what_cannot_be_is_refused_and_named(values: dict[str, Any], text: str) -> None:
    with pytest.raises(StateError, match=text):
        decoded(changed(**values))


def test_another_version_is_refused_as_such() -> None:
    body = encoded(DRIVEN).split(b"\n", 1)[1]
    with pytest.raises(StateError, match="version 3; this drd reads version 2"):
        decoded(sealed(body, 3))


def test_an_estimate_that_would_be_refused_is_not_written() -> None:
    nominal = dataclasses.replace(DRIVEN.estimate.nominal, x_m=math.nan)
    broken = dataclasses.replace(DRIVEN, estimate=dataclasses.replace(DRIVEN.estimate, nominal=nominal))
    with pytest.raises(ValueError, match="x_m"):
        encoded(broken)


@pytest.mark.parametrize("seconds", [0.1, 1.0, 60.0, 300.0])
def test_every_state_of_a_drive_is_fit_to_be_written(seconds: float) -> None:
    found = estimate(seconds)
    assert estimate_of(found.plain()).P.tobytes() == found.P.tobytes()


@settings(deadline=None)
@given(json_values | st.fixed_dictionaries({"robot": json_values, "wall_ns": json_values, "basis": json_values}))
def test_any_json_under_a_right_checksum_raises_nothing_else(content: Any) -> None:
    for body in (json.dumps(content).encode(), b"[" * 100_000, b'{"wall_ns": NaN}', b'{"robot": "\xff"}'):
        with pytest.raises(StateError):
            decoded(sealed(body))
