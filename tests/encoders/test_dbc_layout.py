"""The layout described by a DBC file: what it reads, and how it refuses a file that does not fit."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from drd.config.keys import Dbc, Encoders, Left, Right
from drd.config.schema import ConfigError
from drd.encoders import make_layout
from drd.samples import CanFrame, Side, WheelReading

# WHEELS: two little-endian counters, one signed. OTHER: a float speed. MUX: one side per multiplexer value.
TEXT = """VERSION ""
NS_ :
BS_:
BU_: ROBOT
BO_ 256 WHEELS: 8 ROBOT
 SG_ LEFT_COUNT : 0|16@1+ (0.5,10) [0|0] "counts" ROBOT
 SG_ RIGHT_COUNT : 16|16@1- (1,0) [0|0] "counts" ROBOT
 SG_ LEFT_SPEED : 39|16@0- (0.01,0) [0|0] "km/h" ROBOT
 SG_ OVERLAP : 0|32@1+ (1,0) [0|0] "" ROBOT
BO_ 2566848513 OTHER: 4 ROBOT
 SG_ RIGHT_SPEED : 0|32@1- (1,0) [0|0] "km/h" ROBOT
BO_ 513 MUX: 4 ROBOT
 SG_ WHICH M : 0|8@1+ (1,0) [0|0] "" ROBOT
 SG_ MUX_LEFT m1 : 8|24@1+ (1,0) [0|0] "" ROBOT
 SG_ MUX_RIGHT m2 : 8|24@1+ (1,0) [0|0] "" ROBOT
SIG_VALTYPE_ 2566848513 RIGHT_SPEED : 1;
"""
OTHER_ID = 2566848513 - 2**31


@pytest.fixture
def base(tmp_path: Path) -> Path:
    (tmp_path / "robot.dbc").write_text(TEXT)
    return tmp_path


COUNTS = Encoders(
    layout="dbc",
    counts_per_revolution=1000,
    dbc=Dbc(file="robot.dbc"),
    left=Left(message="WHEELS", signal="LEFT_COUNT"),
    right=Right(message="WHEELS", signal="RIGHT_COUNT"),
)
SPEEDS = replace(
    COUNTS,
    dbc=Dbc(file="robot.dbc", quantity="speed", speed_unit_m_s=1 / 3.6),
    left=Left(message="WHEELS", signal="LEFT_SPEED"),
    right=Right(message="OTHER", signal="RIGHT_SPEED"),
)


def test_counts_are_raw_integers_whatever_the_files_factor(base: Path) -> None:
    layout = make_layout(COUNTS, base)
    readings = layout.decode(CanFrame(0, 256, False, bytes.fromhex("0201feff00000000")))
    assert readings == (WheelReading(Side.LEFT, 0x0102), WheelReading(Side.RIGHT, -2))
    assert layout.modulus_counts == 1 << 16
    assert layout.can_ids == ((256, False),)


def test_speeds_are_scaled_to_metres_per_second_from_two_messages(base: Path) -> None:
    layout = make_layout(SPEEDS, base)
    for frame, side, speed_m_s in (
        (CanFrame(0, 256, False, bytes.fromhex("00000000fe980000")), Side.LEFT, -1.0),
        (CanFrame(0, OTHER_ID, True, bytes.fromhex("00009041")), Side.RIGHT, 5.0),
    ):
        (reading,) = layout.decode(frame)
        assert isinstance(reading, WheelReading)
        assert reading.side is side
        assert reading.value == pytest.approx(speed_m_s)
    assert layout.reports_speed
    assert set(layout.can_ids) == {(256, False), (OTHER_ID, True)}


def test_a_multiplexed_message_tells_of_the_side_it_holds(base: Path) -> None:
    encoders = replace(
        COUNTS,
        left=Left(message="MUX", signal="MUX_LEFT"),
        right=Right(message="MUX", signal="MUX_RIGHT"),
    )
    layout = make_layout(encoders, base)
    assert layout.decode(CanFrame(0, 513, False, bytes.fromhex("01050000"))) == ((Side.LEFT, 5),)
    assert layout.decode(CanFrame(0, 513, False, bytes.fromhex("02070000"))) == ((Side.RIGHT, 7),)
    assert layout.decode(CanFrame(0, 513, False, bytes.fromhex("03070000"))) == ()
    assert not any(layout.counters.values())


def test_short_frames_and_numbers_that_are_none_are_counted(base: Path) -> None:
    layout = make_layout(SPEEDS, base)
    assert layout.decode(CanFrame(0, 256, False, bytes(7))) == ()
    assert layout.decode(CanFrame(0, OTHER_ID, True, bytes.fromhex("0000c07f"))) == ()
    assert layout.decode(CanFrame(0, OTHER_ID, False, bytes(4))) == ()
    assert layout.counters == {"wrong_length": 1, "undecodable": 0, "not_finite": 1}


def test_a_factor_that_no_float_holds_is_counted_and_raises_nothing(base: Path) -> None:
    """Found by the fuzzer."""
    (base / "robot.dbc").write_text(TEXT.replace("16@0- (0.01,0)", f"16@0- ({'9' * 400},0)"))
    layout = make_layout(SPEEDS, base)
    assert layout.decode(CanFrame(0, 256, False, b"\x11" * 8)) == ()
    assert layout.counters["undecodable"] == 1


@pytest.mark.parametrize(
    ("encoders", "text"),
    [
        (replace(COUNTS, dbc=Dbc(file=None)), r"encoders\.dbc\.file: expected a DBC file"),
        (replace(COUNTS, dbc=Dbc(file="no.dbc")), r"encoders\.dbc\.file: expected a readable DBC file at .*no\.dbc"),
        (replace(COUNTS, dbc=Dbc(file="bad.dbc")), r"encoders\.dbc\.file: expected a readable DBC file"),
        (replace(COUNTS, dbc=Dbc(file=".")), r"encoders\.dbc\.file: expected a readable DBC file"),
        (
            replace(COUNTS, left=Left(message="WHEEL", signal="LEFT_COUNT")),
            r"encoders\.left\.message: expected a message of the file: MUX, OTHER, WHEELS, got 'WHEEL'",
        ),
        (
            replace(COUNTS, left=Left(message="OTHER", signal="LEFT_COUNT")),
            r"encoders\.left\.signal: expected a signal of message OTHER: RIGHT_SPEED, got 'LEFT_COUNT'",
        ),
        (replace(COUNTS, right=Right(message="WHEELS")), r"encoders\.right\.signal: .* got None"),
        (
            replace(COUNTS, right=Right(message="WHEELS", signal="LEFT_COUNT")),
            r"encoders\.right\.signal: expected a signal other than",
        ),
        (
            replace(COUNTS, right=Right(message="WHEELS", signal="OVERLAP")),
            r"encoders\.right\.signal: expected counters of the same kind",
        ),
        (replace(COUNTS, counts_per_revolution=None), r"encoders\.counts_per_revolution"),
    ],
)  # fmt: skip
def test_what_does_not_fit_the_file_is_refused_by_its_key(base: Path, encoders: Encoders, text: str) -> None:
    (base / "bad.dbc").write_bytes(b"\xff\x00 no such thing \x81")
    with pytest.raises(ConfigError, match=text):
        make_layout(encoders, base)


def test_what_it_takes_from_the_file_tells_another_layout_and_not_another_name_or_comment(base: Path) -> None:
    def taken(text: str, name: str = "robot.dbc", encoders: Encoders = COUNTS) -> str:
        (base / name).write_text(text)
        found = make_layout(replace(encoders, dbc=replace(encoders.dbc, file=name)), base).from_file
        assert found is not None
        return found

    assert taken(TEXT) == taken(TEXT + 'CM_ BO_ 256 "the wheels";\n', "other.dbc")
    changes = [("BO_ 256 W", "BO_ 257 W"), ("LEFT_COUNT : 0|16", "LEFT_COUNT : 1|16"), ("16|16@1-", "16|16@1+")]
    assert len({taken(TEXT), *(taken(TEXT.replace(old, new)) for old, new in changes)}) == 4
    mux = replace(COUNTS, left=Left(message="MUX", signal="MUX_LEFT"), right=Right(message="MUX", signal="MUX_RIGHT"))
    assert taken(TEXT, encoders=mux) != taken(TEXT.replace("MUX_LEFT m1", "MUX_LEFT m3"), encoders=mux)


def test_a_missing_cantools_is_refused_with_the_command_that_installs_it(
    base: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "cantools", None)
    with pytest.raises(ConfigError, match=r"encoders\.layout: expected .*pip install 'drd\[dbc\]'"):
        make_layout(COUNTS, base)


def test_cantools_is_not_imported_before_a_dbc_layout_is_made() -> None:
    code = "import sys, drd.encoders.stream; sys.exit('cantools' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
