"""`drd fleet query`: tables of the store, filtered or by SQL."""

import json
import sys
from typing import Any, Final

import duckdb
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv as pacsv

from drd.commands import command
from drd.config.schema import ConfigError
from drd_tools.fleet.schema import TABLES
from drd_tools.fleet.store import Store, existing
from drd_tools.report.terminal import print_table

NAMES: Final = (*TABLES, "maintenance")
WIDEST: Final = 60  # characters of a cell in the terminal
DESCRIPTION = """\
Print a table of a fleet's store. With --sql, DuckDB runs the query; it sees all tables by name.
The columns are described in drd_tools/fleet/schema.py.
"""
EXAMPLES = f"""\
tables: {", ".join(NAMES)}

examples:
  drd fleet query fleet                                            the tables and their numbers of rows
  drd fleet query fleet findings --robot 7 --effect wheel_radius_error
  drd fleet query fleet constants --robot 7 --csv > constants.csv
  drd fleet query fleet --sql "select robot, count(*) from findings where status = 'confirmed' group by robot"

Exit code: 0 done, 2 bad usage or input.
"""


def main(argv: list[str]) -> int:
    """Run the command. Raises ConfigError on bad input."""
    parser = command("drd fleet query", DESCRIPTION, EXAMPLES)
    add = parser.add_argument
    add("store", metavar="STORE", help="folder or bucket of the tables")
    add("table", nargs="?", choices=NAMES, metavar="TABLE", help="one of the tables below")
    add("--robot", action="append", metavar="ID", help="rows of this robot; may be repeated")
    add("--effect", metavar="NAME", help="rows of this effect (findings, products)")
    add("--sql", metavar="QUERY", help="a query over all tables")
    form = parser.add_mutually_exclusive_group()
    form.add_argument("--csv", action="store_true", help="print CSV")
    form.add_argument("--json", action="store_true", help="print a line of JSON for each row")
    chosen = parser.parse_args(argv)
    store = existing(chosen.store)
    if chosen.sql is not None:
        if chosen.table or chosen.effect:
            parser.error("--sql names its tables and filters itself")
        table = _by_sql(store, chosen.sql, chosen.robot)
    elif chosen.table is None:
        table = pa.table({"table": list(NAMES), "rows": [len(store.table(name, chosen.robot)) for name in NAMES]})
    else:
        table = store.table(chosen.table, chosen.robot)
        if chosen.effect is not None:
            if "effect" not in table.column_names:
                parser.error(f"{chosen.table} has no column effect")
            table = table.filter(pc.equal(table["effect"], chosen.effect))
    _print(table, "csv" if chosen.csv else "json" if chosen.json else "")
    return 0


def _by_sql(store: Store, query: str, robots: list[str] | None) -> pa.Table:
    with duckdb.connect() as connection:
        for name in NAMES:
            if name in query:
                connection.register(name, store.table(name, robots))
        try:
            return connection.sql(query).to_arrow_table()
        except (duckdb.Error, AttributeError) as error:
            raise ConfigError("--sql", "", "a query that returns a table", str(error)) from error


def _print(table: pa.Table, form: str) -> None:
    if form == "csv":
        sys.stdout.flush()
        pacsv.write_csv(_flat(table), sys.stdout.buffer)
        return
    rows = table.to_pylist()
    if form == "json":
        for row in rows:
            print(json.dumps(row, default=str))
        return
    print_table(table.column_names, [[_cell(value) for value in row.values()] for row in rows])


def _flat(table: pa.Table) -> pa.Table:
    """Replace lists by JSON: CSV has none."""
    for i, field in enumerate(table.schema):
        if pa.types.is_list(field.type):
            cells = [None if v is None else json.dumps(v) for v in table[i].to_pylist()]
            table = table.set_column(i, field.name, pa.array(cells, pa.string()))
    return table


def _cell(value: Any) -> str:
    if value is None:
        return ""
    text = f"{value:.6g}" if isinstance(value, float) else str(value)
    return text if len(text) <= WIDEST else f"{text[: WIDEST - 3]}..."
