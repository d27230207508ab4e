"""Text tables: CSV with a header, or columns of numbers and words separated by spaces; also gzipped."""

import csv
import math
import zlib
from pathlib import Path
from typing import Final

import numpy as np

from drd.arrays import Array
from drd.batch.samples import LATEST_S, stamps_ns
from drd.config.schema import ConfigError
from drd_tools.importing.can_formats import opened
from drd_tools.importing.streams import Gyro, Origin, Reference, Source, Times, Wheels
from drd_tools.report.terminal import columns

SHOWN: Final = 40
SEPARATORS: Final = ",;\t"
# Header names that mark the time column, unless --time states it.
TIME_NAMES: Final = ("time_s", "time", "t", "stamp", "timestamp", "sec", "secs")


class TextTable(Source):
    """A file of rows. Columns are named by the header, or numbered from 1. Raises ConfigError.

    `time`: the column of times (None: found in the header), `unit_s`: its unit in s, `wheel_unit` and `degrees`: units
    of the wheels' columns and the heading, `temperature`: column of the gyro's, in degC.
    """

    def __init__(
        self,
        path: Path,
        time: str | None,
        unit_s: float,
        wheel_unit: str | None,
        *,
        degrees: bool,
        temperature: str | None = None,
    ):
        self.path, self._unit_s, self._wheel_unit, self._degrees = path, unit_s, wheel_unit, degrees
        self._temperature, self._time = temperature, time
        lines = [(k, line) for k, line in enumerate(_lines(path), 1) if line.strip() and not line.startswith("#")]
        if not lines:
            raise ConfigError(str(path), "", "a table of numbers", "an empty file")
        first = lines[0][1]
        self._separator = max(SEPARATORS, key=first.count) if any(c in first for c in SEPARATORS) else None
        cells = self._cells(first)
        self.names: list[str] = []
        if not any(map(_is_number, cells)):
            self.names, lines = cells, lines[1:]
        if not lines:
            raise ConfigError(str(path), "", "rows under the header", "none")
        self._numbers, self._rows = [k for k, _ in lines], [self._cells(line) for _, line in lines]
        self._width = len(self.names) or len(self._rows[0])
        for number, row in zip(self._numbers, self._rows, strict=True):
            if self._separator is not None and len(row) != self._width:
                raise ConfigError(f"{path}:{number}", "", f"{self._width} columns", str(len(row)))

    def listing(self) -> list[str]:
        """Table of the columns with their ranges, and a proposed command."""
        rows = [["column", "name", "smallest", "largest", "median step"]]
        for k in range(min(self._width, SHOWN)):
            name = self.names[k] if self.names else ""
            try:
                values = self.column(str(k + 1), "")
            except ConfigError:
                rows.append([str(k + 1), name, repr(self._rows[0][k][:20]) if k < len(self._rows[0]) else "", "", ""])
                continue
            step = np.median(np.diff(values)) if len(values) > 1 else 0.0
            rows.append([str(k + 1), name, f"{values.min():.9g}", f"{values.max():.9g}", f"{step:.6g}"])
        words = f"drd import {self.path} --time COLUMN --time-unit s --gyro X,Y,Z --gyro-unit rad_s --output DIR"
        return [f"{self.path}: {len(self._rows)} rows", *columns(rows, (1,), ""), "",
                "name the columns by name or number:", f"  {words}"]  # fmt: skip

    def gyro(self, name: str) -> tuple[Gyro, Origin]:
        """One column, or three: x, y, z."""
        columns = self._columns(name, "--gyro", (1, 3))
        axes = ("x", "y", "z") if len(columns) == 3 else ("",)
        time_ns, origin = self._times(name)
        temperature_c = self.column(self._temperature, "--temperature") if self._temperature else None
        return Gyro(time_ns, np.stack(columns, axis=1), axes, None, temperature_c), origin

    def wheels(self, name: str) -> tuple[Wheels, Origin]:
        """Two columns: left and right."""
        left, right = self._columns(name, "--wheels", (2,))
        if self._wheel_unit is None:
            raise ConfigError("command line", "--wheels-unit", "what the two columns are", "nothing")
        time_ns, origin = self._times(name)
        return Wheels(time_ns, left, right, self._wheel_unit), origin

    def reference(self, name: str) -> tuple[Reference, Origin]:
        """Three columns: x, y, heading."""
        x_m, y_m, heading = self._columns(name, "--reference", (3,))
        time_ns, origin = self._times(name)
        heading = np.radians(heading) if self._degrees else heading
        origin.notes.append(f"heading in {'degrees' if self._degrees else 'radians'}")
        return Reference(time_ns, x_m, y_m, heading), origin

    def column(self, name: str, option: str) -> Array:
        """Numbers of a column, shape (n,). Raises ConfigError with the line that has none."""
        k = self._index(name, option)
        try:
            values = np.array([row[k] for row in self._rows], dtype=float)
            if np.isfinite(values).all():
                return values
        except (IndexError, ValueError):
            pass
        for number, row in zip(self._numbers, self._rows, strict=True):
            if k >= len(row) or not _is_number(row[k]):
                got = repr(row[k][:40]) if k < len(row) else f"{len(row)} columns"
                raise ConfigError(f"{self.path}:{number}", f"{option} {name}".strip(), "a finite number", got)
        raise AssertionError(name)

    def _times(self, name: str) -> tuple[Times, Origin]:
        column = self._time or next((n for n in self.names if n.lower() in TIME_NAMES), None)
        if column is None:
            raise ConfigError("command line", "--time", f"the column of times in {self.path}", "nothing")
        time_s = self.column(column, "--time") * self._unit_s
        if np.abs(time_s).max() > LATEST_S:
            got = f"up to {np.abs(time_s).max():.9g} s"
            raise ConfigError(str(self.path), "--time-unit", f"one that makes times of at most {LATEST_S:g} s", got)
        origin = Origin(f"columns {name}", f"table, {self._width} columns", f"column {column}, {self._unit_s:g} s each")
        return stamps_ns(time_s, 0), origin

    def _columns(self, text: str, option: str, counts: tuple[int, ...]) -> list[Array]:
        names = text.split(",")
        if len(names) not in counts:
            raise ConfigError("command line", option, f"{' or '.join(map(str, counts))} columns", repr(text))
        return [self.column(name, option) for name in names]

    def _index(self, name: str, option: str) -> int:
        if name in self.names:
            return self.names.index(name)
        if name.isdecimal() and 1 <= int(name) <= self._width:
            return int(name) - 1
        known = f"one of {', '.join(self.names)}, or a number" if self.names else "a number"
        raise ConfigError(str(self.path), option, f"{known} from 1 to {self._width}", repr(name))

    def _cells(self, line: str) -> list[str]:
        if self._separator is None:
            return line.split()
        try:
            (cells,) = csv.reader([line], delimiter=self._separator, skipinitialspace=True)
        except csv.Error as error:
            raise ConfigError(str(self.path), "", "rows of cells", str(error)) from error
        return [cell.strip() for cell in cells]


def _is_number(text: str) -> bool:
    try:
        return "_" not in text and math.isfinite(float(text))
    except ValueError:
        return False


def _lines(path: Path) -> list[str]:
    try:
        with opened(path) as file:
            data: bytes = file.read()
        return data.decode("utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        expected = "a text file (UTF-8, also in gzip), or one of the kinds that `drd import --help` lists"
        raise ConfigError(str(path), "", expected, f"bytes that begin with {data[:8]!r}") from error
    except (OSError, EOFError, zlib.error) as error:
        got = str(getattr(error, "strerror", None) or error)
        raise ConfigError(str(path), "", "a readable text file (UTF-8, also in gzip)", got) from error
