import struct
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drd.config.keys import Dsp17xx, Fog
from drd.fog.dsp17xx import FRAME_BYTES, HEADER, Dsp17xxParser, crc32_mpeg2
from drd.units import RAD_PER_DEG

# The sample packet of KVH's 1775 IMU manual.
SAMPLE = bytes.fromhex(
    "FE81FF55 37A96A6E 38586C1F B75BF862 BF803E78 BB650D28 3B0A37AC 773D0028 4BFA34D8".replace(" ", "")
)


def parser(axis: Any = "z", **keys: Any) -> Dsp17xxParser:
    return Dsp17xxParser(Fog(protocol="dsp17xx", axis=axis, dsp17xx=Dsp17xx(**keys)))


def packet(z: float = 0.25, status: int = 0x77, sequence: int = 5, temperature: int = 21) -> bytes:
    body = HEADER + struct.pack(">6fBBh", 1.0, 2.0, z, 0.0, 0.0, -1.0, status, sequence, temperature)
    return body + crc32_mpeg2(body)


def test_the_check_value_of_crc32_mpeg2_is_met() -> None:
    assert crc32_mpeg2(b"123456789").hex() == "0376e6e7"


@pytest.mark.parametrize(("axis", "angle"), [("x", 2.0196e-5), ("y", 5.1599e-5), ("z", -1.3111e-5)])
def test_the_manuals_sample_packet_is_read(axis: str, angle: float) -> None:
    (reading,) = parser(axis).feed(SAMPLE)
    assert reading.value == pytest.approx(angle, rel=5e-5)
    assert reading[1:] == (True, 61, 40.0, True)


def test_units_are_as_configured() -> None:
    p = parser(rotation="rate", angle_unit="degrees", temperature_scale_c=0.01)
    (reading,) = p.feed(packet(z=-1.5, temperature=-250))
    assert (reading.value, reading.is_angle) == (-1.5 * RAD_PER_DEG, False)
    assert reading.temperature_c == pytest.approx(-2.5)


@pytest.mark.parametrize(("axis", "bit"), [("x", 0), ("y", 1), ("z", 2)])
def test_only_the_status_of_the_axis_in_use_counts(axis: str, bit: int) -> None:
    p = parser(axis)
    assert [r.valid for r in p.feed(packet(status=1 << bit) + packet(status=0xFF & ~(1 << bit)))] == [True, False]
    assert (p.counters["frames"], p.counters["bad_flag"]) == (2, 1)


@pytest.mark.parametrize("z", [float("nan"), float("inf"), float("-inf")])
def test_numbers_that_are_not_finite_never_come_out(z: float) -> None:
    p = parser()
    (reading,) = p.feed(packet(z=z))
    assert (reading.value, reading.valid, reading.sequence) == (0.0, False, 5)
    assert (p.counters["not_finite"], p.counters["bad_flag"]) == (1, 0)


def test_packets_are_found_byte_by_byte() -> None:
    p = parser()
    stream = SAMPLE * 3
    assert [r.sequence for byte in stream for r in p.feed(bytes([byte]))] == [61] * 3
    assert (p.counters["frames"], p.counters["foreign_bytes"]) == (3, 0)


def test_a_wrong_bit_anywhere_costs_only_its_packet() -> None:
    for bit in range(FRAME_BYTES * 8):
        wrong = bytearray(SAMPLE)
        wrong[bit // 8] ^= 1 << bit % 8
        p = parser()
        assert [r.sequence for r in p.feed(bytes(wrong) + SAMPLE)] == [61]
        assert (p.counters["bad_checksum"], p.counters["foreign_bytes"]) == (int(bit >= 32), FRAME_BYTES)


@pytest.mark.parametrize("kept", range(1, FRAME_BYTES))
def test_a_truncated_packet_costs_only_itself(kept: int) -> None:
    p = parser()
    assert [r.sequence for r in p.feed(SAMPLE[:kept] + SAMPLE)] == [61]
    assert p.counters["foreign_bytes"] == kept


def test_the_header_may_occur_inside_a_packet() -> None:
    z = struct.unpack(">f", HEADER)[0]
    inside = packet(z=z)
    assert inside.count(HEADER) == 2
    p = parser()
    # Without its first byte the packet's inner header is tried, and what follows is still found.
    assert len(p.feed(inside + inside[1:] + inside + SAMPLE)) == 3
    assert (p.counters["bad_checksum"], p.counters["foreign_bytes"]) == (1, 35)


def test_other_formats_and_messages_between_packets_are_foreign() -> None:
    p = parser()
    others = bytes.fromhex("FE81FF56") + bytes(36) + bytes.fromhex("FE81FF57") + bytes(36)
    bit_message = bytes.fromhex("FE8100AB") + bytes(8)
    stream = SAMPLE + others + SAMPLE + bit_message + SAMPLE
    assert len(p.feed(stream)) == 3
    assert p.counters == {
        "frames": 3,
        "bad_checksum": 0,
        "bad_flag": 0,
        "not_finite": 0,
        "foreign_bytes": len(others) + len(bit_message),
    }


def test_reset_forgets_half_a_packet() -> None:
    p = parser()
    p.feed(SAMPLE[:20])
    p.reset()
    assert p.feed(SAMPLE[20:] + SAMPLE) != []
    assert (p.counters["frames"], p.counters["bad_checksum"], p.counters["foreign_bytes"]) == (1, 0, FRAME_BYTES)


def test_after_any_garbage_the_next_good_packet_is_found() -> None:
    """A header in the garbage begins before the good packet, so its 36 bytes are complete, and refused, before it.

    Only a CRC that fits by chance, once in 2^32 headers, could take the packet's beginning.
    """
    rng = np.random.default_rng(5)
    p, fed = parser(), 0
    heads = (b"", b"", HEADER, HEADER[:3], SAMPLE[:30], HEADER + HEADER)
    lengths = rng.integers(0, 41, 100_000).tolist()
    choices = rng.integers(0, len(heads), 200_000).tolist()
    noise = rng.integers(0, 256, 4_100_000, dtype=np.uint8).tobytes()
    (expected,) = parser().feed(SAMPLE)
    at = 0
    for k, length in enumerate(lengths):
        data = heads[choices[2 * k]] + noise[at : at + length] + heads[choices[2 * k + 1]] + SAMPLE
        assert p.feed(data) == [expected]
        at, fed = at + length, fed + len(data)
    c = p.counters
    assert c["frames"] == 100_000
    assert c["bad_checksum"] > 50_000
    assert FRAME_BYTES * c["frames"] + c["foreign_bytes"] == fed


def test_endless_garbage_is_not_kept() -> None:
    p = parser()
    for _ in range(100):
        p.feed(b"\xfe\x81\xff" * 100)
    assert len(p._buffer) < FRAME_BYTES


PIECES = st.one_of(
    st.just(SAMPLE),
    st.integers(0, FRAME_BYTES).map(lambda n: SAMPLE[:n]),
    st.sampled_from([HEADER, HEADER[:2], b"\xfe\x81\xff\x56"]),
    st.binary(max_size=20),
)


@given(st.lists(PIECES, max_size=12).map(b"".join), st.lists(st.integers(0, 500), max_size=20))
def test_chunking_changes_nothing(stream: bytes, cuts: list[int]) -> None:
    whole, chunked = parser(), parser()
    places = [0, *sorted(cuts), len(stream)]
    readings = [r for a, b in pairwise(places) for r in chunked.feed(stream[a:b])]
    assert readings == whole.feed(stream)
    assert chunked.counters["frames"] == whole.counters["frames"]
    assert chunked.counters["foreign_bytes"] == whole.counters["foreign_bytes"]
