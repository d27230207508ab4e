"""Files of a fleet: labels and rules in YAML, the log of maintenance, and the Parquet tables of a store."""

import json
import os
import tempfile
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Final

import pyarrow as pa
import pyarrow.parquet as pq

from drd.config.schema import ConfigError
from drd_tools.fleet.labels import as_text, from_text, read_maintenance, read_own, read_rules, ruled
from drd_tools.fleet.schema import TABLES
from drd_tools.fleet.store import Store

NAME: Final = "site/robot7/2026-03-12_081500"
# The files of a store, of which byte 0 of an input chooses the one that it is.
FILES: Final = ("store.json", "index.parquet", "maintenance.parquet", "pending/a.parquet", "recordings/7/2026.parquet",
                "findings/7/2026.parquet", "products/7/2026-03.parquet")  # fmt: skip

MOST: Final = 1000  # rows that are looked at: millions of nulls fit in some bytes


@cache
def _folder(_: int) -> Path:
    """One for each process."""
    return Path(tempfile.mkdtemp(prefix="drd-fuzz-fleet-"))


def labels(data: bytes) -> None:
    """Byte 0: the log of maintenance, rules, or a recording's own labels."""
    file = _folder(os.getpid()) / "file"
    file.write_bytes(data[1:])
    with suppress(ConfigError):
        if data[:1] < b"\x55":
            for row in read_maintenance(str(file)):
                assert row["date"].tzinfo is not None
        else:
            own = read_own(file) if data[:1] >= b"\xaa" else from_text("{}")
            own = own if data[:1] >= b"\xaa" else ruled(read_rules(str(file)), NAME, own)
            assert from_text(as_text(own)).columns() == own.columns()


def store(data: bytes) -> None:
    """Byte 0: which file of a store the rest is, and whether as Parquet or as JSON of rows; the others are absent."""
    name, content = FILES[data[0] % len(FILES)] if data else "", data[1:]
    if data[:1] >= b"\x80" and name.endswith(".parquet"):
        content = _parquet_of(content)
    if not content:
        return
    folder = _folder(os.getpid()) / "store"
    file = folder / name
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(content)
    try:
        with suppress(ConfigError):
            _read(folder, name)
    finally:
        file.unlink()


def _parquet_of(rows: bytes) -> bytes:
    """A file with these rows, of whatever types they have; nothing where they are no rows."""
    try:
        out = pa.BufferOutputStream()
        pq.write_table(pa.Table.from_pylist(json.loads(rows)), out)
    except Exception:  # a Parquet file of the fuzzer's, not of drd's
        return b""
    return bytes(out.getvalue())


def _read(folder: Path, name: str) -> None:
    found, table = Store(folder), name.partition("/")[0].partition(".")[0]
    if table == "index":
        found.rows(found.index()["recording"][:3].to_pylist())
    for each in TABLES if table == "pending" else (table,) if table in (*TABLES, "maintenance") else ():
        found.table(each)[:MOST].to_pylist()
        found.table(each, ["7"])[:MOST].to_pylist()
