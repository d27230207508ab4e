import math
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drd.config.keys import Dsp3000, Fog
from drd.fog.dsp3000 import KEPT_BYTES, Dsp3000Parser
from drd.units import DEG_PER_RAD

# A real line: ros-drivers/kvh_drivers, test/dsp3000_parser_utest.cpp.
REAL = b"       0.015733   1\r\n"


def parser(mode: Any = "rate") -> Dsp3000Parser:
    return Dsp3000Parser(Fog(protocol="dsp3000", dsp3000=Dsp3000(mode=mode)))


def values_deg(p: Dsp3000Parser, data: bytes) -> list[float]:
    return [r.value * DEG_PER_RAD for r in p.feed(data) if r.valid]


def line(value: float, flag: int = 1) -> bytes:
    return f"{value:15.6f}   {flag}\r\n".encode()


@pytest.mark.parametrize(("mode", "is_angle"), [("rate", False), ("incremental", True)])
def test_a_real_line_gives_its_value(mode: str, is_angle: bool) -> None:
    (reading,) = parser(mode).feed(REAL)
    assert reading.value * DEG_PER_RAD == pytest.approx(0.015733, abs=1e-12)
    assert (reading.is_angle, reading.sequence, reading.valid) == (is_angle, None, True)
    assert math.isnan(reading.temperature_c)


@pytest.mark.parametrize(
    "text", [b"-375.123456 1\r\n", b"  -0.000001   1\r\n", b"0.000000 1\r\n", b"359.999999   1\r\n"]
)
def test_the_manuals_form_is_taken_in_any_column(text: bytes) -> None:
    assert values_deg(parser(), b"\r\n" + text) == pytest.approx([float(text.split()[0])])


@pytest.mark.parametrize(
    "text",
    [
        b"\r\n",
        b"       0.01573   1\r\n",  # a digit is missing
        b"      0.0157333   1\r\n",
        b"    1234.015733   1\r\n",
        b"      +0.015733   1\r\n",
        b"        .015733   1\r\n",
        b"       1.573e-2   1\r\n",
        b"            nan   1\r\n",
        b"           -inf   1\r\n",
        b"       0.015733   2\r\n",
        b"       0.0157331\r\n",
        b"       0.015733    \r\n",
        b"       0.015733   1 \r\n",
        b"       0.015733   1\n",
        b"       0.015733\t1\r\n",
        b"       0,015733   1\r\n",
        b"      -\xb20.015733   1\r\n",
        "       \u0661.015733   1\r\n".encode(),
        b"     - 0.015733   1\r\n",
        b" 0.015733   1\r 0.015733   1\r\n",
        b"       0.015733" + b" " * 21 + b"1\r\n",
        b"\xff 0.015733   1\r\n",
        b"\xff0.015733   1\r\n",
        b"7" * KEPT_BYTES + b"0.015733   1\r\n",
    ],
)
def test_any_other_form_is_refused_and_the_next_line_kept(text: bytes) -> None:
    p = parser()
    assert values_deg(p, b"\r\n" + text + REAL) == pytest.approx([0.015733])
    assert p.counters == {"frames": 1, "malformed_lines": 2, "bad_flag": 0}


def test_lines_are_found_byte_by_byte() -> None:
    p = parser()
    assert [v for byte in REAL * 3 for v in values_deg(p, bytes([byte]))] == pytest.approx([0.015733] * 3)
    assert p.counters == {"frames": 3, "malformed_lines": 0, "bad_flag": 0}


def test_of_a_first_line_that_may_be_cut_nothing_is_believed() -> None:
    whole = b"     123.456789   1\r\n"
    for cut in range(len(whole)):
        p = parser()
        assert values_deg(p, whole[cut:] + whole) in (
            [pytest.approx(123.456789)],
            [pytest.approx(123.456789)] * 2,
        )
        p.reset()
        assert len(values_deg(p, whole[cut:] + whole)) == 1 + (cut <= 4)


def test_an_endless_line_is_not_kept() -> None:
    p = parser()
    for _ in range(100):
        p.feed(b"0" * 1000)
        assert len(p._line) <= KEPT_BYTES
    assert values_deg(p, REAL) == pytest.approx([0.015733])
    assert p.counters == {"frames": 1, "malformed_lines": 1, "bad_flag": 0}


def test_a_fault_flag_makes_the_reading_invalid() -> None:
    p = parser()
    (reading,) = p.feed(line(1.5, flag=0))
    assert not reading.valid
    assert p.counters == {"frames": 1, "malformed_lines": 0, "bad_flag": 1}


def test_integrated_angles_become_wrapped_increments() -> None:
    p = parser("integrated")
    angles = [10.0, 12.5, 359.0, 1.0, 358.0, 170.0, 349.9]
    assert values_deg(p, b"".join(map(line, angles))) == pytest.approx([2.5, -13.5, 2.0, -3.0, 172.0, 179.9])
    assert p.counters["frames"] == 7


@pytest.mark.parametrize("interruption", ["fault", "reset"])
def test_after_an_interruption_an_integrated_angle_begins_anew(interruption: str) -> None:
    p = parser("integrated")
    assert values_deg(p, line(10) + line(11)) == pytest.approx([1.0])
    if interruption == "fault":
        assert values_deg(p, line(55, flag=0)) == []
    else:
        p.reset()
    readings = p.feed(line(100))
    assert [r.valid for r in readings] == [False]
    assert values_deg(p, line(101.25)) == pytest.approx([1.25])
    assert p.counters["bad_flag"] == (interruption == "fault")


def test_a_malformed_line_does_not_lose_the_integrated_angle() -> None:
    p = parser("integrated")
    assert values_deg(p, line(10) + b"  1x.000000   1\r\n" + line(12)) == pytest.approx([2.0])


def test_a_line_directly_after_any_garbage_is_found() -> None:
    """Nothing can hide a line with two blanks before its value, as in the known real one.

    Nor change its value: digits at the garbage's end are cut off from it by the blanks.
    """
    rng = np.random.default_rng(3)
    lengths = rng.integers(0, 41, 100_000)
    total = int(lengths.sum())
    noise = rng.integers(0, 256, total, dtype=np.uint8)
    # Half of it is made of what lines are made of.
    alike = np.repeat(rng.random(len(lengths)) < 0.5, lengths)
    noise[alike] = rng.choice(np.frombuffer(b" -.0123456789\r\n", dtype=np.uint8), int(alike.sum()))
    stream, p, at = noise.tobytes(), parser(), 0
    for length in lengths.tolist():
        readings = p.feed(stream[at : at + length] + REAL)
        assert readings
        assert readings[-1].value * DEG_PER_RAD == pytest.approx(0.015733, abs=1e-12)
        at += length
    assert p.counters["frames"] >= 100_000
    assert p.counters["malformed_lines"] >= 90_000


@pytest.mark.parametrize("garbage", [b"\x00", b"3", b"-", b"12.", b"  -9", b"0.015733   1\r", b"    9.000000   1\r"])
@pytest.mark.parametrize("is_first", [True, False])
def test_garbage_that_looks_like_a_part_of_a_line_changes_nothing(garbage: bytes, is_first: bool) -> None:
    p = parser()
    p.feed(b"" if is_first else b"\n")
    assert values_deg(p, garbage + REAL) == pytest.approx([0.015733])
    assert p.counters["malformed_lines"] == 1 + (not is_first)


PIECES = st.one_of(
    st.just(REAL),
    st.integers(0, len(REAL)).map(lambda n: REAL[n:]),
    st.binary(max_size=20),
    st.text(" -.0123456789\r\n", max_size=60).map(str.encode),
)


@given(st.lists(PIECES, max_size=12).map(b"".join), st.lists(st.integers(0, 300), max_size=20))
def test_chunking_changes_nothing(stream: bytes, cuts: list[int]) -> None:
    whole, chunked = parser("integrated"), parser("integrated")
    places = [0, *sorted(cuts), len(stream)]
    pairs = pairwise(places)
    readings = [(r.value, r.valid) for a, b in pairs for r in chunked.feed(stream[a:b])]
    assert readings == [(r.value, r.valid) for r in whole.feed(stream)]
    assert chunked.counters == whole.counters
