import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drd.config.keys import Ecore, Fog
from drd.fog.ecore import EcoreParser
from drd.samples import FogReading
from drd.units import DEG_PER_RAD

NO_PROFILE = Ecore(status_byte=0, temperature_byte=0)
# Made by an independent codec for a unit of +-100 deg/s; m1 to m4 are 0.
VECTORS = {
    "80 00 00 00 00 00 00 00": 0,
    "93 40 00 00 00 00 19 4d": 3277,
    "ed 00 00 00 00 03 66 33": -3277,
    "c1 00 00 00 00 01 7f 7f": 32767,
    "c0 00 00 00 00 02 00 00": -32768,
}
GOOD = bytes.fromhex("93 40 00 00 00 00 19 4d")


def parser(profile: Ecore = NO_PROFILE, full_scale_deg_s: float = 100) -> EcoreParser:
    return EcoreParser(Fog(protocol="ecore", full_scale_deg_s=full_scale_deg_s, ecore=profile))


def frame(m1_to_m6: bytes) -> bytes:
    """An intact frame, made bit by bit as the format is described."""
    m = bytes([-sum(m1_to_m6) % 256]) + m1_to_m6
    bits = "".join(f"{byte:08b}" for byte in m)
    return bytes(int(("1" if i == 0 else "0") + bits[i : i + 7], 2) for i in range(0, 56, 7))


def counts(reading: FogReading, full_scale_deg_s: float = 100) -> float:
    return reading.value * DEG_PER_RAD / full_scale_deg_s * 32768


@pytest.mark.parametrize(("packet", "expected"), VECTORS.items())
def test_known_frames_give_their_counts(packet: str, expected: int) -> None:
    (reading,) = parser().feed(bytes.fromhex(packet))
    assert counts(reading) == pytest.approx(expected, abs=1e-9)
    assert (reading.is_angle, reading.sequence, reading.valid) == (False, None, True)
    assert math.isnan(reading.temperature_c)


@pytest.mark.parametrize("full_scale_deg_s", [30, 60, 100])
def test_the_full_scale_scales_the_counts(full_scale_deg_s: float) -> None:
    (reading,) = parser(full_scale_deg_s=full_scale_deg_s).feed(GOOD)
    assert reading.value * DEG_PER_RAD == pytest.approx(3277 * full_scale_deg_s / 32768)


def test_frames_are_found_byte_by_byte() -> None:
    stream = bytes.fromhex("".join(VECTORS))
    p = parser()
    readings = [reading for byte in stream for reading in p.feed(bytes([byte]))]
    assert [round(counts(reading)) for reading in readings] == list(VECTORS.values())
    assert p.counters == {
        "frames": 5,
        "bad_checksum": 0,
        "bad_flag": 0,
        "framing_errors": 0,
        "foreign_bytes": 0,
    }


@pytest.mark.parametrize(("temperature", "expected_c"), [("0a28", 26.0), ("ff9c", -1.0), ("8000", -327.68)])
def test_the_temperature_is_where_the_profile_says(temperature: str, expected_c: float) -> None:
    packet = frame(bytes.fromhex("0055" + temperature + "1234"))
    (reading,) = parser(Ecore()).feed(packet)
    assert reading.temperature_c == pytest.approx(expected_c)
    moved = Ecore(temperature_byte=2, temperature_scale_c=0.5, temperature_offset_c=-10)
    (reading,) = parser(moved).feed(frame(bytes.fromhex("55" + temperature + "001234")))
    assert reading.temperature_c == pytest.approx(expected_c * 50 - 10)


@pytest.mark.parametrize(
    ("mask", "good", "status", "valid"),
    [(0, 0, 0xFF, True), (0x81, 0x01, 0x7F, True), (0x81, 0x01, 0xFF, False), (0x81, 0x01, 0x00, False)],
)
def test_the_status_bits_are_judged_as_configured(mask: int, good: int, status: int, valid: bool) -> None:
    p = parser(Ecore(status_byte=2, status_mask=mask, status_good=good))
    (reading,) = p.feed(frame(bytes([0, status, 0, 0, 0, 1])))
    assert reading.valid is valid
    assert (p.counters["frames"], p.counters["bad_flag"]) == (1, not valid)


def test_a_wrong_sum_is_refused_and_the_next_frame_kept() -> None:
    for byte in range(8):
        for bit in range(7):
            wrong = bytearray(GOOD)
            wrong[byte] ^= 1 << bit
            p = parser()
            assert [round(counts(r)) for r in p.feed(bytes(wrong) + GOOD)] == [3277]
            assert (p.counters["bad_checksum"], p.counters["frames"]) == (1, 1)


@pytest.mark.parametrize("kept", range(1, 8))
def test_a_truncated_frame_costs_only_itself(kept: int) -> None:
    p = parser()
    assert len(p.feed(GOOD[:kept] + GOOD)) == 1
    assert (p.counters["framing_errors"], p.counters["foreign_bytes"]) == (1, kept)


def test_reset_forgets_half_a_frame() -> None:
    p = parser()
    p.feed(GOOD[:5])
    p.reset()
    assert p.feed(GOOD[5:]) == []
    assert len(p.feed(GOOD)) == 1
    assert (p.counters["foreign_bytes"], p.counters["framing_errors"]) == (8, 0)


def test_after_any_garbage_the_next_good_frame_is_found() -> None:
    """Its first byte has the sync bit, which starts a frame in every state: there is nothing that could swallow it.

    The garbage may hold intact frames by chance; the good one is the last reading of each call all the same.
    """
    rng = np.random.default_rng(1)
    p, fed = parser(), 0
    (expected,) = parser().feed(GOOD)
    lengths = rng.integers(0, 41, 100_000)
    noise = rng.integers(0, 256, int(lengths.sum()), dtype=np.uint8).tobytes()
    for length in lengths.tolist():
        readings = p.feed(noise[fed : fed + length] + GOOD)
        assert readings
        # Compared without the temperature, which is NaN.
        assert readings[-1].value == expected.value
        fed += length
    c = p.counters
    assert c["frames"] >= 100_000
    assert 8 * (c["frames"] + c["bad_checksum"]) + c["foreign_bytes"] == fed + 8 * 100_000


def test_garbage_without_sync_bits_adds_no_reading() -> None:
    rng = np.random.default_rng(2)
    p, frames = parser(), 0
    for length in rng.integers(0, 41, 5_000).tolist():
        frames += len(p.feed(rng.integers(0, 128, length, dtype=np.uint8).tobytes() + GOOD))
    assert frames == p.counters["frames"] == 5_000
    assert p.counters["framing_errors"] == p.counters["bad_checksum"] == 0


PIECES = st.one_of(st.just(GOOD), st.integers(0, 8).map(lambda n: GOOD[:n]), st.binary(max_size=20))


@given(st.lists(PIECES, max_size=12).map(b"".join), st.lists(st.integers(0, 300), max_size=20))
def test_chunking_changes_nothing(stream: bytes, cuts: list[int]) -> None:
    whole, chunked = parser(Ecore()), parser(Ecore())
    places = [0, *sorted(cuts), len(stream)]
    readings = [r for a, b in pairwise(places) for r in chunked.feed(stream[a:b])]
    assert readings == whole.feed(stream)
    assert chunked.counters == whole.counters
