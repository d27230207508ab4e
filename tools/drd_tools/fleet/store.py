"""Store of a fleet: its tables as Parquet, in a folder or a bucket, written atomically.

An update puts each recording's rows into one file, `pending/*.parquet`, as soon as they are ready, and compacts from
time to time: moves them into the tables' own files (see `schema`). Each file is replaced whole. Until the pending files
are removed, at the end, they have precedence: an interrupted compaction is simply repeated.
"""

import hashlib
import json
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import datetime, timedelta
from functools import cached_property
from pathlib import Path
from typing import Any, Final
from urllib.parse import quote

import duckdb
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.dataset as ds
import pyarrow.parquet as pq

from drd.config.schema import ConfigError
from drd_tools.fleet.files import Files
from drd_tools.fleet.schema import LABELS, MAINTENANCE, PENDING, RECORDINGS, TABLES, TIME, VERSION

Rows = Mapping[str, Sequence[Mapping[str, Any]]]  # a recording's, by table

ABOUT, INDEX, NAMES_OF_DONE = "store.json", "index.parquet", "maintenance.parquet"
# 0.4 GB: far more than a file of a table holds, and small enough for any machine.
MOST_VALUES: Final = 50_000_000
SIZES: Final = "select max(greatest(num_values, row_group_num_rows)) from parquet_metadata(?)"
# The range of Python's datetime, in microseconds since 1970.
FIRST_US, LAST_US = ((at - datetime(1970, 1, 1)) // timedelta(microseconds=1) for at in (datetime.min, datetime.max))
MOST_PUT: Final = 2000  # recordings per file, without products
MOST_PENDING: Final = 256  # recordings compacted at once: limits the memory to some tens of MB


class Store:
    """Tables of a fleet. Only one process may write; any number may read."""

    def __init__(self, path: str | Path):
        self.files = Files(path)
        about = self.files.read(ABOUT)
        self.exists = about is not None
        version = VERSION if about is None else _version(about)
        if version != VERSION:
            raise ConfigError(f"{self.files.url}/{ABOUT}", "schema", str(VERSION), str(version))

    # ---- reading ---------------------------------------------------------------------------------------------------

    def table(self, name: str, robots: Collection[str] | None = None) -> pa.Table:
        """Read a table, whole or for some robots; rows are sorted by file (robot and period), then by recording.

        Names are those of `schema.TABLES`, and maintenance. Raises KeyError.
        """
        if name == "maintenance":
            return _of_robots(self._read(self._existing([NAMES_OF_DONE]), MAINTENANCE), robots)
        schema, folders = TABLES[name].schema, None if robots is None else {_folder(robot) for robot in robots}
        names = [f for f in self.files.below(name, ".parquet") if folders is None or f.split("/")[1] in folders]
        table = self._read(names, schema)
        pending = self.pending()
        if not pending:
            return table
        rows = self._read(pending, PENDING)
        table = pa.concat_tables([_without(table, _flat(rows, "recordings")["recording"]), _flat(rows, name)])
        return _of_robots(table, robots)

    def pending(self) -> list[str]:
        """Names of the files not yet compacted."""
        return self.files.below("pending", ".parquet")

    def index(self) -> pa.Table:
        """Table of recordings, from one file."""
        names = self._existing([INDEX])
        return self._read(names, RECORDINGS) if names else self.table("recordings")

    def _read(self, names: Sequence[str], schema: pa.Schema) -> pa.Table:
        if not names:
            return schema.empty_table()
        paths = [self.files.path(name) for name in names]
        with _parquet_errors(f"{self.files.url}/{names[0]}" + (", ..." if names[1:] else "")):
            self._check_size(paths)
            found = ds.dataset(paths, schema=schema, format="parquet", filesystem=self.files.arrow())
            return _checked(found.to_table())

    def _check_size(self, paths: Sequence[str]) -> None:
        """Raise ValueError for a file whose metadata claim a size that would fill the memory: a few bytes can do that.

        DuckDB reads them, since pyarrow aborts the process if the sizes stated for a column contradict each other.
        """
        urls = list(paths) if self.files.is_local else [self.files.system.unstrip_protocol(path) for path in paths]
        (most,) = self._duckdb.execute(SIZES, [urls]).fetchone()
        if most is not None and most > MOST_VALUES:  # None: no file has rows
            raise ValueError(f"{most} rows or values; at most {MOST_VALUES} are read")

    @cached_property
    def _duckdb(self) -> Any:
        connection = duckdb.connect()
        if not self.files.is_local:
            connection.register_filesystem(self.files.system)
        return connection

    # ---- writing ---------------------------------------------------------------------------------------------------

    @contextmanager
    def writing(self) -> Iterator[None]:
        """Keep other writers out of a folder; a bucket has no locks. Raises ConfigError."""
        if not self.exists:
            self.files.write(ABOUT, json.dumps({"format": "drd-fleet-store", "schema": VERSION}).encode())
            self.exists = True
        if not self.files.is_local:
            yield
            return
        import fcntl  # noqa: PLC0415  # not available on all platforms, where reading still works

        with Path(self.files.path("lock")).open("wb") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as error:
                raise ConfigError("--store", "", "a store that nobody else updates", self.files.url) from error
            yield

    def put(self, rows: Rows) -> None:
        """Store a recording's rows, by table, in place of its earlier ones."""
        table = pa.Table.from_pylist([{name: list(rows.get(name, ())) for name in TABLES}], PENDING)
        name = hashlib.sha256(rows["recordings"][0]["uri"].encode()).hexdigest()[:24]
        self.files.write(f"pending/{name}.parquet", _parquet(table))

    def put_all(self, rows: Sequence[Rows]) -> None:
        """Store the rows of many recordings at once, and compact."""
        for at in range(0, len(rows), MOST_PUT):
            part = [{name: list(one.get(name, ())) for name in TABLES} for one in rows[at : at + MOST_PUT]]
            self.files.write(f"pending/all-{at:06d}.parquet", _parquet(pa.Table.from_pylist(part, PENDING)))
        self.compact()

    def rows(self, recordings: Collection[str]) -> dict[str, dict[str, list[dict[str, Any]]]]:
        """Rows of compacted recordings, by recording and by table."""
        wanted = pa.array(sorted(recordings), pa.string())
        index = self.index()
        known = index.filter(pc.is_in(index["recording"], wanted)).to_pylist()
        found: dict[str, dict[str, list[dict[str, Any]]]] = {r: {name: [] for name in TABLES} for r in recordings}
        for name in TABLES:
            files = self._existing(sorted({_file(name, row) for row in known}))
            table = self._read(files, TABLES[name].schema)
            for row in table.filter(pc.is_in(table["recording"], wanted)).to_pylist():
                found[row["recording"]][name].append(row)
        return found

    def compact(self) -> None:
        """Move pending rows into the tables' files."""
        names = self.pending()
        for at in range(0, len(names), MOST_PENDING):
            self._compact(names[at : at + MOST_PENDING])

    def _compact(self, names: Sequence[str]) -> None:
        pending, index = self._read(names, PENDING), self.index()
        fresh = _flat(pending, "recordings")
        # A long recording has several names, which may have changed.
        old = index.filter(pc.is_in(index["uri"], pc.unique(fresh["uri"])))
        changed, was = (
            pa.chunked_array([*old["recording"].chunks, *fresh["recording"].chunks], pa.string()),
            old.to_pylist(),
        )
        places = {table: {_file(table, row) for row in [*was, *fresh.to_pylist()]} for table in TABLES}
        for table, files in places.items():
            new = _flat(pending, table)
            of = pa.array([_file(table, row) for row in new.select([n for n, _ in LABELS]).to_pylist()], pa.string())
            for file in sorted(files):
                added = new.filter(pc.equal(of, file)) if len(of) else new
                self._replace(file, added, changed)
        self.files.write(INDEX, _parquet(pa.concat_tables([_without(index, changed), fresh]).sort_by("recording")))
        for name in names:
            self.files.remove(name)

    def _replace(self, file: str, added: pa.Table, changed: pa.ChunkedArray) -> None:
        """Replace the rows of `changed` recordings in a file by the `added` ones."""
        before = self._read(self._existing([file]), added.schema)
        table = pa.concat_tables([_without(before, changed), added]).sort_by("recording")
        if len(table):
            self.files.write(file, _parquet(table))
        else:
            self.files.remove(file)

    def _existing(self, names: Sequence[str]) -> list[str]:
        return [name for name in names if self.files.system.exists(self.files.path(name))]

    def keep_maintenance(self, rows: Sequence[Mapping[str, Any]]) -> None:
        """Store the maintenance log, in place of the earlier one."""
        self.files.write(NAMES_OF_DONE, _parquet(pa.Table.from_pylist(list(rows), MAINTENANCE)))


def existing(path: str) -> Store:
    """Open a store made by an update. Raises ConfigError if there is none."""
    store = Store(path)
    if not store.exists:
        raise ConfigError(path, "", "a store of `drd fleet update`", "none there")
    return store


@contextmanager
def _parquet_errors(where: str) -> Iterator[None]:
    """Turn errors from a foreign or damaged file into a ConfigError."""
    try:
        yield
    except (pa.ArrowException, duckdb.Error, OSError, ValueError) as error:
        raise ConfigError(where, "", "a Parquet file of the store", str(error)[:200]) from error


def _checked(table: pa.Table) -> pa.Table:
    """Check a table. Raises ValueError if a text is not UTF-8, a time is no date, or a recording or robot is null."""
    table.validate(full=True)
    for name in {"recording", "robot"} & set(table.column_names):
        if table[name].null_count:
            raise ValueError(f"a row without {name}")
    for field in table.schema:
        if field.type == TIME and table[field.name].null_count < len(table):
            low, high = pc.min_max(table[field.name].cast(pa.int64())).as_py().values()
            if not FIRST_US <= low <= high <= LAST_US:
                raise ValueError(f"{field.name}: a time beyond the years 1 to 9999")
    return table


def _version(about: bytes) -> Any:
    try:
        return json.loads(about)["schema"]
    except (ValueError, KeyError, TypeError, RecursionError):
        return "none"


def _folder(robot: str) -> str:
    name = quote(robot, safe=" ")
    return f"%2E{name[1:]}" if name.startswith(".") else name


def _file(table: str, row: Mapping[str, Any]) -> str:
    start: datetime | None = row["start_utc"]
    period = "undated" if start is None else start.strftime(TABLES[table].period)
    return f"{table}/{_folder(row['robot'])}/{period}.parquet"


def _of_robots(table: pa.Table, robots: Collection[str] | None) -> pa.Table:
    return table if robots is None else table.filter(pc.is_in(table["robot"], pa.array(list(robots), pa.string())))


def _without(table: pa.Table, recordings: pa.ChunkedArray) -> pa.Table:
    return table.filter(pc.invert(pc.is_in(table["recording"], pc.unique(recordings))))


def _flat(pending: pa.Table, name: str) -> pa.Table:
    """Rows of one table from the rows of pending files."""
    schema = TABLES[name].schema
    rows = pending[name].combine_chunks().flatten()
    columns = [rows.field(i) if len(rows) else pa.array([], field.type) for i, field in enumerate(schema)]
    with _parquet_errors("pending"):
        return _checked(pa.Table.from_arrays(columns, schema=schema))


def _parquet(table: pa.Table) -> bytes:
    out = pa.BufferOutputStream()
    pq.write_table(table, out, compression="zstd")
    return bytes(out.getvalue())
