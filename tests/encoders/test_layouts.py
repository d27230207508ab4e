"""Byte vectors of the built-in layouts, written out from the sources their modules name."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from drd.config.keys import Cia406, Encoders, Left, Odrive, Right, Vesc
from drd.config.schema import ConfigError
from drd.encoders import make_layout
from drd.encoders.layout import CounterRestart, Layout
from drd.samples import CanFrame, Side, WheelReading

BASE = Path()
LEFT, RIGHT = Left(node=5), Right(node=6)


def frame(can_id: int, data: str, extended: bool = False) -> CanFrame:
    return CanFrame(1_000, can_id, extended, bytes.fromhex(data))


def cia406(key: Cia406 | None = None) -> Layout:
    return make_layout(Encoders(counts_per_revolution=4096, cia406=key or Cia406(), left=LEFT, right=RIGHT), BASE)


def odrive(message: Any) -> Layout:
    key = Odrive(message=message)
    return make_layout(Encoders(layout="odrive", counts_per_revolution=8192, odrive=key, left=LEFT, right=RIGHT), BASE)


def vesc() -> Layout:
    key = Vesc(pole_pairs=7, gear_ratio=2.0)
    return make_layout(Encoders(layout="vesc", vesc=key, left=LEFT, right=RIGHT), BASE)


def agilex() -> Layout:
    return make_layout(Encoders(layout="agilex"), BASE)


def test_a_cia406_position_is_little_endian_in_the_first_four_bytes_of_tpdo1() -> None:
    assert cia406().decode(frame(0x185, "78563412")) == (WheelReading(Side.LEFT, 0x12345678),)
    assert cia406().decode(frame(0x186, "00000080")) == (WheelReading(Side.RIGHT, 0x80000000),)


def test_a_cia406_position_may_lie_anywhere_in_any_tpdo() -> None:
    layout = cia406(Cia406(tpdo=2, byte_offset=2, byte_length=3))
    assert layout.decode(frame(0x285, "ffff563412ff")) == (WheelReading(Side.LEFT, 0x123456),)
    assert layout.modulus_counts == 1 << 24
    assert layout.decode(frame(0x185, "ffff563412ff")) == ()


def test_a_cia406_position_that_ends_beyond_the_frame_is_counted() -> None:
    layout = cia406(Cia406(byte_offset=2, byte_length=3))
    assert layout.decode(frame(0x185, "ffff5634")) == ()
    assert layout.counters["wrong_length"] == 1


def test_a_64_bit_position_keeps_every_bit() -> None:
    layout = cia406(Cia406(byte_length=8))
    assert layout.decode(frame(0x185, "feffffffffffffff"))[0] == (Side.LEFT, 2**64 - 2)


def test_a_boot_up_message_restarts_the_counter_of_its_side_only() -> None:
    layout = cia406()
    assert layout.decode(frame(0x706, "00")) == (CounterRestart(Side.RIGHT, ()),)
    assert layout.decode(frame(0x706, "05")) == ()
    assert layout.counters["boot_ups"] == 1


def test_nodes_are_started_at_the_beginning_and_after_their_boot_up_where_asked() -> None:
    layout = cia406(Cia406(start_nodes=True))
    assert [(f.can_id, f.data.hex()) for f in layout.start_frames()] == [(0, "0105"), (0, "0106")]
    (restart,) = layout.decode(frame(0x705, "00"))
    assert isinstance(restart, CounterRestart)
    assert [(f.can_id, f.data.hex(), f.extended) for f in restart.reply] == [(0, "0105", False)]


def test_without_start_nodes_and_sync_nothing_is_sent() -> None:
    for layout in (cia406(), agilex(), odrive("counts"), vesc()):
        assert layout.start_frames() == ()
        assert layout.cyclic is None


def test_sync_is_an_empty_frame_80h_at_the_configured_period() -> None:
    assert cia406(Cia406(sync_period_s=0.05)).cyclic == (CanFrame(0, 0x080, False, b""), 0.05)


def test_an_emergency_is_counted_and_its_end_is_not() -> None:
    layout = cia406()
    assert layout.decode(frame(0x085, "1010010000000000")) == ()
    layout.decode(frame(0x085, "0000000000000000"))
    layout.decode(frame(0x085, ""))
    assert layout.counters["emergencies"] == 1


def test_cia406_reads_position_heartbeat_and_emergency_of_both_nodes() -> None:
    assert set(cia406(Cia406(tpdo=3)).can_ids) == {(i, False) for i in (0x385, 0x386, 0x705, 0x706, 0x085, 0x086)}


def test_agilex_odometers_are_big_endian_millimetres_left_first() -> None:
    layout = agilex()
    readings = layout.decode(frame(0x311, "000003e8fffffc18"))
    assert readings == (WheelReading(Side.LEFT, 1000), WheelReading(Side.RIGHT, -1000))
    assert layout.metres_per_count(0.2) == 0.001
    assert layout.modulus_counts == 1 << 32
    assert layout.can_ids == ((0x311, False),)


def test_odrive_estimates_are_little_endian_float_revolutions() -> None:
    layout = odrive("estimates")
    assert layout.decode(frame(0x0A9, "0000c03f00002041")) == (WheelReading(Side.LEFT, 1.5),)
    assert layout.decode(frame(0x0C9, "000020c000000000")) == (WheelReading(Side.RIGHT, -2.5),)
    assert layout.modulus_counts is None
    assert layout.metres_per_count(0.5) == pytest.approx(3.14159265)


def test_odrive_estimates_of_a_geared_motor_are_its_turns() -> None:
    geared = Encoders(layout="odrive", odrive=Odrive(gear_ratio=7.5))
    assert make_layout(geared, BASE).metres_per_count(0.5) == pytest.approx(3.14159265 / 7.5)
    counts = replace(geared, counts_per_revolution=8192, odrive=Odrive(message="counts", gear_ratio=7.5))
    with pytest.raises(ConfigError, match=r"encoders\.odrive\.gear_ratio: expected 1, .* got 7\.5"):
        make_layout(counts, BASE)


@pytest.mark.parametrize("position", ["0000c07f", "0000807f", "000080ff"])
def test_an_odrive_estimate_that_is_no_number_is_counted(position: str) -> None:
    layout = odrive("estimates")
    assert layout.decode(frame(0x0A9, position + "00000000")) == ()
    assert layout.counters["not_finite"] == 1


def test_odrive_counts_are_the_signed_shadow_count() -> None:
    layout = odrive("counts")
    assert layout.decode(frame(0x0AA, "feffffff0a000000")) == (WheelReading(Side.LEFT, -2),)
    assert layout.modulus_counts == 1 << 32
    assert layout.metres_per_count(0.1) == pytest.approx(0.62831853 / 8192)
    assert layout.decode(frame(0x0A9, "feffffff0a000000")) == ()


def test_a_vesc_tachometer_is_big_endian_with_six_counts_per_electrical_turn() -> None:
    layout = vesc()
    assert layout.decode(frame(0x1B05, "0000010200f00000", extended=True)) == (WheelReading(Side.LEFT, 258),)
    assert layout.decode(frame(0x1B06, "ffffffff00f00000", extended=True)) == (WheelReading(Side.RIGHT, -1),)
    assert layout.decode(frame(0x1B05, "0000010200f00000")) == ()
    assert layout.metres_per_count(0.1) == pytest.approx(0.62831853 / (6 * 7 * 2))


@pytest.mark.parametrize(
    ("layout", "can_id", "extended"),
    [
        (agilex(), 0x311, False),
        (odrive("counts"), 0x0AA, False),
        (odrive("estimates"), 0x0A9, False),
        (vesc(), 0x1B05, True),
    ],
)
@pytest.mark.parametrize("length", [0, 4, 7, 9, 64])
def test_a_frame_of_another_length_is_counted(layout: Layout, can_id: int, extended: bool, length: int) -> None:
    before = layout.counters["wrong_length"]
    assert layout.decode(CanFrame(0, can_id, extended, bytes(length))) == ()
    assert layout.counters["wrong_length"] == before + 1


@pytest.mark.parametrize("layout", [agilex(), odrive("counts"), odrive("estimates"), vesc(), cia406()])
def test_the_same_number_with_the_other_id_length_is_another_identifier(layout: Layout) -> None:
    for can_id, extended in layout.can_ids:
        assert layout.decode(CanFrame(0, can_id, not extended, bytes(8))) == ()
    assert not any(layout.counters.values())


@pytest.mark.parametrize(("layout", "node"), [("cia406", 0), ("cia406", 128), ("odrive", 64)])
def test_a_node_that_the_identifiers_cannot_hold_is_refused(layout: Any, node: int) -> None:
    with pytest.raises(ConfigError, match=r"encoders\.right\.node: expected .* got " + str(node)):
        make_layout(Encoders(layout=layout, counts_per_revolution=100, right=Right(node=node)), BASE)


@pytest.mark.parametrize("layout", ["cia406", "odrive"])
def test_counts_need_their_number_per_turn(layout: Any) -> None:
    with pytest.raises(ConfigError, match=r"encoders\.counts_per_revolution"):
        make_layout(Encoders(layout=layout, odrive=Odrive(message="counts")), BASE)


def test_a_modulus_is_refused_where_nothing_is_counted() -> None:
    with pytest.raises(ConfigError, match=r"encoders\.modulus_counts: expected null, .* got 8192"):
        make_layout(Encoders(layout="odrive", modulus_counts=8192), BASE)
    counts = Encoders(layout="odrive", modulus_counts=8192, counts_per_revolution=100, odrive=Odrive(message="counts"))
    assert make_layout(counts, BASE).modulus_counts == 8192


def test_the_configured_modulus_overrides_the_layouts_own_but_cannot_exceed_it() -> None:
    encoders = Encoders(counts_per_revolution=4096, modulus_counts=36_000)
    assert make_layout(encoders, BASE).modulus_counts == 36_000
    with pytest.raises(ConfigError, match=r"encoders\.modulus_counts: expected at most 65536"):
        make_layout(Encoders(counts_per_revolution=4096, modulus_counts=65_537, cia406=Cia406(byte_length=2)), BASE)
