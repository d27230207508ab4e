"""Reader of rate-table recordings, which refuses those whose columns are implausible."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from scipy.stats import theilslopes

from drd.arrays import Array
from drd.config.schema import ConfigError
from drd_tools.calibrate.gyro.data_sets import SETTLE_S, DataSets, data_sets_of_samples, joined
from drd_tools.recordings.folder import file_hash, finite, read_table

COLUMNS: Final = ("time_s", "table_rate_deg_s", "rate_deg_s", "temperature_c")
TURNS_DEG_S: Final = 1.0  # a table whose rate varies less never turned
EARTH_RATE_DEG_H: Final = 15.041
LARGEST_SCALE_ERROR: Final = 0.2  # ten times that of Table I: beyond it the columns or units are wrong
WORKING_RANGE_C: Final = (-60.0, 125.0)  # of any electronics


@dataclass(frozen=True)
class RateTable:
    """One file's columns, each of shape (k,), and its SHA-256 in hexadecimal digits."""

    file: Path
    time_s: Array
    table_rate_deg_s: Array
    rate_deg_s: Array
    temperature_c: Array
    sha256: str


def files_in(paths: Iterable[Path]) -> list[Path]:
    """List the files, and the *.csv of each folder, sorted by name. Raises ConfigError."""
    files: list[Path] = []
    for path in paths:
        found = sorted(path.glob("*.csv")) if path.is_dir() else [path]
        if not found:
            raise ConfigError(str(path), "folder", "rate-table files *.csv", "none")
        files += found
    seen: dict[Path, Path] = {}
    for file in files:
        if (other := seen.setdefault(file.resolve(), file)) is not file:
            raise ConfigError(str(file), "file", "each file once", f"it twice (also as {other})")
    return files


def read_rate_table(file: Path) -> RateTable:
    """Read the columns, in any order; ignore others. Raises ConfigError with file, line and column."""
    table = read_table(file, (COLUMNS,), among=True, cells={"temperature_c": _temperature_c})
    time_s, table_rate_deg_s, rate_deg_s, temperature_c = table.values.T
    return RateTable(file, time_s, table_rate_deg_s, rate_deg_s, temperature_c, file_hash(file))


def _temperature_c(cell: str) -> float:
    try:
        return finite(cell)
    except ValueError as error:
        raise ValueError(f"{error} (of a gyro without a sensor, a thermometer's)") from error


def data_sets(tables: Sequence[RateTable], settle_s: float = SETTLE_S, latitude_deg: float | None = None) -> DataSets:
    """Check the files and make their data sets. With a latitude, the Earth's rate is added to the true rate. (46)

    Raises ConfigError if the columns contradict each other or no data set is left.
    """
    for table in tables:
        _check_columns(str(table.file), [table])
    where = str(tables[0].file) if len(tables) == 1 else f"{len(tables)} files"
    _check_columns(where, tables)
    rates_deg_s = np.concatenate([table.table_rate_deg_s for table in tables])
    if _span(rates_deg_s) < TURNS_DEG_S:
        got = f"{np.median(rates_deg_s):g} deg/s throughout; a log at standstill is for `drd calibrate noise`"
        raise ConfigError(where, "table_rate_deg_s", "a table that turns, at several rates", got)
    parts = [_data_sets_of(table, settle_s) for table in tables]
    for table, part in zip(tables, parts, strict=True):
        _check_slope(str(table.file), part)
    data = joined(parts)
    if not len(data):
        expected = f"rates that the table holds for more than the settling time of {settle_s:g} s and 10 samples"
        raise ConfigError(where, "table_rate_deg_s", expected, "none (see --settle)")
    _check_slope(where, data)
    _check_temperature(tables)
    if latitude_deg is None:
        return data
    earth_deg_s = EARTH_RATE_DEG_H / 3600.0 * math.sin(math.radians(latitude_deg))
    return replace(data, table_rate_deg_s=data.table_rate_deg_s + earth_deg_s)


def _data_sets_of(table: RateTable, settle_s: float) -> DataSets:
    t = table.time_s
    return data_sets_of_samples(
        t,
        table.table_rate_deg_s,
        table.rate_deg_s,
        table.temperature_c,
        settle_s=settle_s,
        describe=lambda first, last: f"{table.file.name}, {t[first]:.1f} to {t[last - 1]:.1f} s",
    )


def _check_columns(where: str, tables: Sequence[RateTable]) -> None:
    """Refuse swapped columns, judged by which columns are correlated and which is constant from row to row."""
    w, g, T = (
        np.concatenate([getattr(table, name) for table in tables])
        for name in ("table_rate_deg_s", "rate_deg_s", "temperature_c")
    )
    if not _is_same_quantity(w, g):
        if _is_same_quantity(w, T):
            got = "one that does not, while temperature_c does: the two columns look swapped"
            raise ConfigError(where, "rate_deg_s", "a reading that follows table_rate_deg_s", got)
        if _is_same_quantity(g, T):
            got = "the gyro following temperature_c: table_rate_deg_s and temperature_c look swapped"
            raise ConfigError(where, "table_rate_deg_s", "the rate that the gyro follows", got)
    held_table, held_gyro = (float(np.mean(np.diff(x) == 0.0)) if len(x) > 1 else 0.0 for x in (w, g))
    if held_table < 0.5 and held_gyro > 0.9:
        got = "a rate that changes from row to row, while rate_deg_s is held: the two columns look swapped"
        raise ConfigError(where, "table_rate_deg_s", "rates that are held for a while", got)


def _check_slope(where: str, data: DataSets) -> None:
    """Refuse a gyro whose readings differ from the table's rates by more than 20 % in scale."""
    if len(data) < 2 or np.ptp(data.table_rate_deg_s) < TURNS_DEG_S:
        return
    few = data.select(np.unique(np.linspace(0, len(data) - 1, 400).astype(np.int64)))  # theilslopes compares all pairs
    slope = float(theilslopes(few.rate_deg_s, few.table_rate_deg_s)[0])
    if abs(slope - 1.0) <= LARGEST_SCALE_ERROR:
        return
    expected = "a reading of about 1 deg/s for each deg/s of the table"
    reasons = {
        -1.0: "opposite signs; check the table's sign and fog.positive",
        math.radians(1.0): "rate_deg_s looks like rad/s",
        math.degrees(1.0): "table_rate_deg_s looks like rad/s",
    }
    near = [text for value, text in reasons.items() if abs(slope / value - 1.0) <= LARGEST_SCALE_ERROR]
    reason = near[0] if near else "the two columns do not belong together, or their units differ"
    raise ConfigError(where, "rate_deg_s", expected, f"{slope:.3g}: {reason}")


def _check_temperature(tables: Sequence[RateTable]) -> None:
    for table in tables:
        cold, warm = (float(v) for v in np.percentile(table.temperature_c, (5.0, 95.0)))
        if cold < WORKING_RANGE_C[0] or warm > WORKING_RANGE_C[1]:
            hint = ": it looks like kelvin" if 200.0 < cold <= warm < 400.0 else ""
            expected = "temperatures in degC from {:g} to {:g}".format(*WORKING_RANGE_C)
            raise ConfigError(str(table.file), "temperature_c", expected, f"{cold:g} to {warm:g}{hint}")


def _span(values: Array) -> float:
    """Range of the values, leaving out a few percent as spikes."""
    low, high = np.percentile(values, (1.0, 99.0))
    return float(high - low)


def _is_same_quantity(a: Array, b: Array) -> bool:
    """True if one follows the other with a slope near 1 or -1, unlike a temperature that merely drifts along."""
    a, b = (np.clip(x, *np.percentile(x, (2.0, 98.0))) for x in (a, b))  # without the few percent of spikes
    if min(a.std(), b.std()) < 1e-9:
        return False
    return abs(float(np.corrcoef(a, b)[0, 1])) > 0.9 and 0.7 < a.std() / b.std() < 1.4
