"""Any other layout, described by a DBC file: one message and signal per side, counts or speed.

Needs cantools (the extra drd[dbc]), which is imported and given the file when the daemon starts, not later.
"""

import re
from copy import copy
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from drd.config.keys import Encoders
from drd.config.schema import ConfigError
from drd.encoders.layout import CounterRestart, Layout, counts_per_revolution, side_key, wheels
from drd.samples import CanFrame, Side, WheelReading

if TYPE_CHECKING:
    from cantools.database.can import Database, Message, Signal


# A message's length in bytes; a signal's start and length in bits. The longest messages of SAE J1939 have 1785 bytes;
# for absurd sizes in a file, cantools would take much memory and minutes.
_SIZES: Final = re.compile(rb"\bBO_\s+\d+\s+\w+\s*:\s*(\d+)|(\d+)\s*\|\s*(\d+)\s*@")
_LARGEST: Final = 8 * 1785


class _Field:
    """One side's signal, decoded without its neighbours: cantools rejects a message whose signals overlap."""

    def __init__(self, message: "Message", signal: "Signal", base: Path, side: Side):
        self.can_id = (message.frame_id, message.is_extended_frame)
        self.length = message.length
        self._signal = signal
        # The signals that select this one in a multiplexed message, each with its selecting values.
        self._selectors: list[tuple[str, list[int]]] = []
        plain = [_plain(signal)]
        while signal.multiplexer_signal is not None:
            self._selectors.append((signal.multiplexer_signal, signal.multiplexer_ids or []))
            signal = message.get_signal_by_name(signal.multiplexer_signal)
            plain.append(_plain(signal))
        parts = [(s.name, s.start, s.length, s.byte_order, s.is_signed, s.is_float) for s in plain]
        self.text = str((self.can_id, self.length, self._signal.scale, self._signal.offset, parts, self._selectors))
        try:
            self._codec = type(message)(
                message.frame_id,
                message.name,
                message.length,
                plain,
                is_extended_frame=message.is_extended_frame,
                strict=True,
            )
        except Exception as error:  # anything that cantools rejects in the signal's place
            expected = f"a signal that lies within message {message.name}"
            raise ConfigError(str(base), side_key(side, "signal"), expected, str(error)) from error

    def decode(self, data: bytes) -> float | None:
        """The signal's raw value; None if the frame does not contain it. Raises what cantools raises."""
        raw: Any = self._codec.decode(data, decode_choices=False, scaling=False)
        if any(raw[name] not in ids for name, ids in self._selectors):
            return None
        value: float = raw[self._signal.name]
        return value

    def scaled(self, raw: float) -> float:
        """The physical value, by the file's factor and offset."""
        value: Any = self._signal.raw_to_scaled(raw, decode_choices=False)
        return float(value)


class Dbc(Layout):
    """Two signals of a DBC file.

    Counts are a signal's raw integers: the file's factor and offset do not apply, since the counter wraps in raw
    integers. Speeds are its physical values times `dbc.speed_unit_m_s`.
    """

    def __init__(self, encoders: Encoders, base: Path):
        database = load_database(encoders, base)
        found = {side: find_signal(database, encoders, base, side) for side in Side}
        if found[Side.LEFT] == found[Side.RIGHT]:
            got = str(encoders.right.signal)
            raise ConfigError(str(base), side_key(Side.RIGHT, "signal"), "a signal other than the left wheel's", got)
        self.reports_speed = encoders.dbc.quantity == "speed"
        self._speed_unit_m_s = encoders.dbc.speed_unit_m_s
        if not self.reports_speed:
            self.counts_per_revolution = counts_per_revolution(encoders, base)
        self._fields: dict[tuple[int, bool], list[tuple[Side, _Field]]] = {}
        for side, (message, signal) in found.items():
            field = _Field(message, signal, base, side)
            self._fields.setdefault(field.can_id, []).append((side, field))
        self.can_ids = tuple(self._fields)
        self.from_file = "; ".join(field.text for fields in self._fields.values() for _, field in fields)
        self.modulus_counts: int | None = None if self.reports_speed else _modulus_counts(found, base)
        self.counters = {"wrong_length": 0, "undecodable": 0, "not_finite": 0}

    def decode(self, frame: CanFrame) -> tuple[WheelReading | CounterRestart, ...]:
        """The wanted signals in this frame; a multiplexed message may contain none."""
        fields = self._fields.get((frame.can_id, frame.extended), [])
        if any(len(frame.data) < field.length for _, field in fields):
            self.counters["wrong_length"] += 1
            return ()
        readings = (self._reading(side, field, frame.data) for side, field in fields)
        return tuple(reading for reading in readings if reading is not None)

    def _reading(self, side: Side, field: _Field, data: bytes) -> WheelReading | None:
        try:
            value = field.decode(data)
            if value is not None and self.reports_speed:
                value = field.scaled(value) * self._speed_unit_m_s
        except Exception:  # cantools and bitstruct may raise anything on foreign bytes or an absurd factor
            self.counters["undecodable"] += 1
            return None
        if value is None:
            return None
        if not isfinite(value):
            self.counters["not_finite"] += 1
            return None
        return WheelReading(side, value)


def load_database(encoders: Encoders, base: Path) -> "Database":
    """Read the DBC file. Raises ConfigError if the file or cantools is missing or the file is not a DBC file."""
    try:
        import cantools  # noqa: PLC0415 - optional: only this layout needs it
    except ImportError as error:
        expected = "the Python package cantools for layout dbc (pip install 'drd[dbc]')"
        raise ConfigError(str(base), "encoders.layout", expected, str(error)) from error
    if encoders.dbc.file is None:
        raise ConfigError(str(base), "encoders.dbc.file", "a DBC file, since the layout is dbc", "nothing")
    file = base / encoders.dbc.file
    try:
        for number in (int(text) for sizes in _SIZES.findall(file.read_bytes()) for text in sizes if text):
            if number > _LARGEST:
                raise ValueError(f"a length or position of {number}, beyond the bits of a message")
        # Not strict: files in use often contain overlapping signals, which do not affect the wanted ones.
        database: Any = cantools.database.load_file(file, database_format="dbc", strict=False)
    except Exception as error:  # a parser of foreign text may raise anything
        got = " ".join(str(error).split()) or type(error).__name__
        raise ConfigError(str(base), "encoders.dbc.file", f"a readable DBC file at {file}", got) from error
    return database  # type: ignore[no-any-return]  # a file of format dbc is a CAN database


def find_signal(database: "Database", encoders: Encoders, base: Path, side: Side) -> tuple["Message", "Signal"]:
    """The message and signal of one side. Raises ConfigError naming the key whose name is not in the file."""
    wheel, where = wheels(encoders)[side], str(base / str(encoders.dbc.file))
    message = next((m for m in database.messages if m.name == wheel.message), None)
    if message is None:
        names = ", ".join(sorted(m.name for m in database.messages)[:20])
        raise ConfigError(where, side_key(side, "message"), f"a message of the file: {names}", repr(wheel.message))
    signal = next((s for s in message.signals if s.name == wheel.signal), None)
    if signal is None:
        names = ", ".join(s.name for s in message.signals)
        expected = f"a signal of message {message.name}: {names}"
        raise ConfigError(where, side_key(side, "signal"), expected, repr(wheel.signal))
    return message, signal


def _modulus_counts(found: dict[Side, tuple["Message", "Signal"]], base: Path) -> int | None:
    """Modulus of the two raw counters; None for float signals."""
    left, right = (found[side][1] for side in Side)
    if (left.length, left.is_float) != (right.length, right.is_float):
        got = f"{left.name} with {left.length} bits and {right.name} with {right.length}"
        raise ConfigError(str(base), side_key(Side.RIGHT, "signal"), "counters of the same kind on both sides", got)
    return None if left.is_float else 1 << left.length


def _plain(signal: "Signal") -> "Signal":
    """The signal without its part in a multiplexed message."""
    plain = copy(signal)
    plain.is_multiplexer, plain.multiplexer_ids, plain.multiplexer_signal = False, None, None
    return plain
