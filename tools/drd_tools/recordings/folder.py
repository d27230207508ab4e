"""The neutral recording folder, in plain text: robot.yaml, encoders.csv, fog.csv and reference.csv."""

import hashlib
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from drd.arrays import Array
from drd.batch.logs import COUNTS, RATE, RATE_AND_TEMPERATURE, SPEEDS, EncoderLog, FogLog
from drd.config.keys import Config
from drd.config.robot import Robot, load_robot
from drd.config.schema import ConfigError, Loaded, read_text
from drd.effects.model import Term
from drd.units import RAD_PER_DEG

# Number of rows formatted at once.
CHUNK: Final = 4096
POSES: Final = ("time_s", "x_m", "y_m", "heading_deg")
# Further columns: the uncertainty of an estimate.
COVARIANCE: Final = ("xx_m2", "xy_m2", "xh_m_rad", "yy_m2", "yh_m_rad", "hh_rad2")
BOUND: Final = "position_bound_99_m"
WRAPPED_DEG: Final = 361.0  # largest span of wrapped headings: +-3.142 rad is slightly more than a turn
VALID: Final = "valid"  # 1; 0: degraded, invalid or initialising
ESTIMATES: Final = (*POSES, *COVARIANCE, BOUND, VALID)
ESTIMATES_FORM: Final = "%.9f,%.6f,%.6f,%.6f" + ",%.6g" * 7 + ",%d"
GAP_S, GAP_ROWS = 0.5, 5.0  # after both, the wheels' counts are a sum that says little about single steps


@dataclass(frozen=True)
class ReferenceLog:
    """Poses, shape (n,) each. The heading is continuous: whole turns are kept if the rows show them."""

    time_s: Array
    x_m: Array
    y_m: Array
    heading_rad: Array


@dataclass(frozen=True)
class Recording:
    """A recording folder, or a file that the daemon recorded. `sha256` has the hash of each file read.

    `wheels`: None if the robot has no encoders; its radius and tread are then NaN unless robot.yaml states them.
    `config`: the daemon's configuration in force, if known. `model`: the model file that changed the nominal robot,
    `terms` the effects that it adds, `notes` sentences about those left out. `zero_s`: zero of their time in a part of
    a recording, see `zero_for_terms`.
    """

    folder: Path
    nominal: Robot
    wheels: EncoderLog | None
    fog: FogLog | None
    reference: ReferenceLog | None
    sha256: dict[str, str]
    model: Path | None = None
    terms: tuple[Term, ...] = ()
    notes: tuple[str, ...] = ()
    config: Config | None = None
    zero_s: float | None = None

    @property
    def name(self) -> str:
        """The folder's name, or the file's without its suffix."""
        path = self.folder.resolve()
        return path.stem if path.suffix == ".mcap" else path.name

    @property
    def encoders(self) -> EncoderLog:
        """The wheels' log, for callers that require it. Raises ConfigError if there is none."""
        if self.wheels is None:
            raise ConfigError(str(self.folder), "encoders.csv", "this file in the folder", "none")
        return self.wheels

    def wheel_gaps(self) -> npt.NDArray[np.bool_]:
        """Steps (n - 1,) between the wheels' rows without counts, or with only their sum over a long time."""
        log = self.encoders
        apart_s = np.diff(log.time_s)
        gaps: npt.NDArray[np.bool_] = apart_s > max(GAP_S, GAP_ROWS * float(np.median(apart_s)))
        return gaps if log.is_lost is None else gaps | log.is_lost[1:]

    def wheel_angles_rad(self) -> tuple[Array, Array]:
        """Angles of the left and the right wheel since the first row, rad, shape (n,) each."""
        log, per_revolution = self.encoders, self.nominal.counts_per_revolution
        if log.left_counts is not None and log.right_counts is not None and per_revolution is not None:
            factor = 2.0 * math.pi / per_revolution
            return factor * (log.left_counts - log.left_counts[0]), factor * (log.right_counts - log.right_counts[0])
        assert log.left_rad_s is not None
        assert log.right_rad_s is not None
        step_s = np.diff(log.time_s, prepend=log.time_s[0])
        return np.cumsum(log.left_rad_s * step_s), np.cumsum(log.right_rad_s * step_s)


def read_recording(folder: Path) -> Recording:
    """Read a recording folder. Raises only ConfigError, with file, line and column or key."""
    if not folder.is_dir():
        raise ConfigError(str(folder), "", "a recording folder", "a file" if folder.exists() else "nothing there")
    names = ("robot.yaml", "encoders.csv", "fog.csv", "reference.csv")
    sha256 = {name: file_hash(folder / name) for name in names if (folder / name).exists()}
    if "robot.yaml" not in sha256 or not sha256.keys() & {"encoders.csv", "fog.csv"}:
        name = "robot.yaml" if "robot.yaml" not in sha256 else "encoders.csv"
        raise ConfigError(str(folder), name, "this file in the folder", "none")
    has_wheels = "encoders.csv" in sha256
    loaded = load_robot(folder / "robot.yaml", has_wheels)
    return Recording(
        folder,
        loaded.value,
        _read_encoders(folder / "encoders.csv", loaded) if has_wheels else None,
        _read_fog(folder / "fog.csv") if "fog.csv" in sha256 else None,
        read_reference_log(folder / "reference.csv") if "reference.csv" in sha256 else None,
        sha256,
    )


@dataclass(frozen=True)
class Table:
    """Numbers of a CSV file, shape (n, columns), and the line number of each row, shape (n,)."""

    file: Path
    header: tuple[str, ...]
    values: Array
    line: list[int]

    def refuse(self, row: int, column: str, expected: str) -> ConfigError:
        """Make the error that names one cell."""
        got = f"{self.values[row, self.header.index(column)]:.12g}"
        return ConfigError(f"{self.file}:{self.line[row]}", column, expected, got)


def read_table(
    file: Path,
    headers: tuple[tuple[str, ...], ...],
    rows: int = 1,
    *,
    among: bool = False,
    cells: Mapping[str, Callable[[str], float]] = MappingProxyType({}),
    rising: bool | None = True,
) -> Table:
    """Read a CSV file of numbers that has one of `headers`, the first column a rising time, and at least `rows` rows.

    `among`: columns may be in any order, with others among them. `cells`: readers of columns whose cells are not
    plain numbers; they raise ValueError with what is expected. `rising`: False: times may repeat; None: no times.
    Empty lines, and lines with # before the header, are skipped. Raises ConfigError with file, line and column.
    """
    lines = read_text(file, "utf-8-sig").splitlines()  # spreadsheets put a byte order mark first
    first = next((k for k, line in enumerate(lines) if line.strip() and not line.lstrip().startswith("#")), None)
    expected = " or ".join(",".join(h) for h in headers) + " (in any order, commas between them)" * among
    if first is None:
        raise ConfigError(str(file), "", f"the header {expected}", "an empty file")
    names = tuple(cell.strip() for cell in lines[first].split(","))
    fits = (lambda h: all(names.count(name) == 1 for name in h)) if among else (lambda h: h == names)
    header = next(filter(fits, headers), ())
    if not header:
        hint = " (1 rad/s is 57.29578 deg/s)" if "rate_rad_s" in names else ""
        raise ConfigError(f"{file}:{first + 1}", "header", expected, repr(lines[first].strip()[:80]) + hint)
    numbered = [(number, line) for number, line in enumerate(lines[first + 1 :], first + 2) if line.strip()]
    if len(numbered) < rows:
        raise ConfigError(str(file), "", f"at least {rows} row{'s' * (rows > 1)} of numbers", str(len(numbered)))
    places = {name: names.index(name) for name in header}
    wanted = list(places.values()) if among else None
    readers: dict[int | str, Callable[[str], float]] = {places[n]: cells[n] for n in header if n in cells}
    try:
        bare = [line for _, line in numbered]
        values = np.loadtxt(bare, delimiter=",", ndmin=2, comments=None, usecols=wanted, converters=readers or None)
    except ValueError:
        values = np.full((1, 1), np.nan)
    plain = [k for k, name in enumerate(header) if name not in cells]
    if values.shape[1] != len(header) or not np.isfinite(values[:, plain]).all():
        _blame(file, numbered, places, cells, None if among else len(names))
    table = Table(file, header, values, [number for number, _ in numbered])
    step = np.diff(values[:, 0])
    stuck = np.flatnonzero(step <= 0.0 if rising else step < 0.0)
    if rising is not None and stuck.size:
        raise table.refuse(int(stuck[0]) + 1, header[0], f"a time after {values[stuck[0], 0]:.12g}")
    return table


def _blame(
    file: Path,
    numbered: list[tuple[int, str]],
    places: Mapping[str, int],
    readers: Mapping[str, Callable[[str], float]],
    width: int | None,
) -> None:
    """Find the first unreadable cell, or row of another `width`, and raise the error that names it."""
    for number, line in numbered:
        row = [cell.strip() for cell in line.split(",")]
        if width is not None and len(row) != width:
            raise ConfigError(f"{file}:{number}", "", f"{width} columns", str(len(row)))
        for name, place in places.items():
            cell = row[place] if place < len(row) else ""
            try:
                readers.get(name, finite)(cell)
            except ValueError as error:
                raise ConfigError(f"{file}:{number}", name, str(error), repr(cell[:40])) from error
    raise ConfigError(str(file), "", "a table of numbers", "something else")


def write_table(file: Path, header: Sequence[str], rows: Array, form: str) -> None:
    """Write a CSV file of numbers, shape (n, columns), each row formatted by `form`. Raises OSError."""
    with file.open("w", encoding="utf-8", newline="") as out:
        out.write(",".join(header) + "\n")
        for part in np.split(rows, range(CHUNK, len(rows), CHUNK)):
            out.write(f"{form}\n" * len(part) % tuple(part.ravel().tolist()))


def finite(cell: str) -> float:
    """Parse a plain finite number. Raises ValueError."""
    try:
        value = math.nan if "_" in cell else float(cell)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ValueError("a finite number")
    return value


def file_hash(file: Path) -> str:
    """Compute the SHA-256 in hex. Raises ConfigError."""
    try:
        with file.open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as error:
        raise ConfigError(str(file), "", "a readable file", str(error.strerror)) from error


def _read_encoders(file: Path, robot: Loaded[Robot]) -> EncoderLog:
    table = read_table(file, (COUNTS, SPEEDS), rows=2)
    time_s, left, right = table.values.T
    if table.header == SPEEDS:
        return EncoderLog(time_s, None, None, left, right)
    if robot.value.counts_per_revolution is None:
        path = "wheel.counts_per_revolution"
        raise ConfigError(robot.place(path), path, "a number, since encoders.csv has counts", "null")
    for name, counts in zip(COUNTS[1:], (left, right), strict=True):
        broken = np.flatnonzero(counts != np.round(counts))
        if broken.size:
            raise table.refuse(int(broken[0]), name, "a whole number of counts")
    return EncoderLog(time_s, left, right, None, None)


def _read_fog(file: Path) -> FogLog:
    table = read_table(file, (RATE, RATE_AND_TEMPERATURE))
    temperature_c = table.values[:, 2] if table.header == RATE_AND_TEMPERATURE else None
    return FogLog(table.values[:, 0], table.values[:, 1] * RAD_PER_DEG, temperature_c)


def read_reference_log(file: Path) -> ReferenceLog:
    """Read a reference.csv. Raises ConfigError."""
    time_s, x_m, y_m, heading_deg = read_table(file, (POSES,)).values.T
    return ReferenceLog(time_s, x_m, y_m, continuous_rad(heading_deg))


def at_rows(log: object, rows: Any) -> dict[str, Any]:
    """The columns of a log, by name, at these rows: indices, or True for each row."""
    return {name: column[rows] for name, column in vars(log).items() if isinstance(column, np.ndarray)}


def wrapped(angle_rad: Array) -> Array:
    """Wrap angles to (-pi, pi]."""
    return np.asarray(math.pi - np.mod(math.pi - angle_rad, 2.0 * math.pi))


def continuous_rad(heading_deg: Array) -> Array:
    """Unwrap headings (n,) of a reference.

    If they span more than a turn, they are not wrapped, and sparse rows may truly be more than half a turn apart.
    """
    heading_rad = heading_deg * RAD_PER_DEG
    return np.unwrap(heading_rad) if np.ptp(heading_deg) <= WRAPPED_DEG else heading_rad
