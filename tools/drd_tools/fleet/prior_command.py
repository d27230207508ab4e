"""`drd fleet prior`: what a robot's daemon should start with."""

from datetime import UTC, datetime
from pathlib import Path

from drd.commands import command, writing
from drd.config.schema import ConfigError
from drd_tools.fleet.prior import Expected, expect, write_prior
from drd_tools.fleet.sentences import amount
from drd_tools.fleet.series import CONSTANTS, day_of
from drd_tools.fleet.statistics import analyse
from drd_tools.fleet.store import Store
from drd_tools.report.terminal import columns

DESCRIPTION = """\
Write what a robot's daemon should start with: the robot's constants as its own history and the fleet's population have
them, as model.yaml (for model.file of the configuration, and drd replay --model), and how sure they are as prior.yaml
beside it (keys of estimation.initial: put them into the configuration, or give it to drd replay --config).
"""
EXAMPLES = """\
examples:
  drd fleet prior fleet --robot 7 --output robot7/model.yaml
  drd fleet prior fleet --robot 7 --before 2026-06-01 --output robot7/model.yaml      (as if it were that day)
  drd replay friday/ --model robot7/model.yaml --config robot7/prior.yaml --output poses.csv

A robot that the store does not know gets the population's mean, and its scatter.

Exit code: 0 done, 2 bad usage or input.
"""


def main(argv: list[str]) -> int:
    """Write the files, print the constants. Raises ConfigError on bad input."""
    parser = command("drd fleet prior", DESCRIPTION, EXAMPLES)
    add = parser.add_argument
    add("store", metavar="STORE", help="folder or bucket that drd fleet update has filled")
    add("--robot", required=True, metavar="ID", help="whose")
    add("--place", metavar="NAME", help="where it is going to drive (default: any)")
    add("--before", type=datetime.fromisoformat, metavar="DATE", help="only recordings before (default: all)")
    add("--output", type=Path, required=True, metavar="model.yaml", help="file; prior.yaml is written beside it")
    chosen = parser.parse_args(argv)
    if chosen.output.name != "model.yaml":
        parser.error("--output is a file named model.yaml")
    store = Store(chosen.store)
    if not store.exists:
        raise ConfigError(chosen.store, "", "a store of `drd fleet update`", "none there")
    before, table = chosen.before, store.table("constants").to_pydict()
    day = day_of(before if before is not None else datetime.now(UTC))
    keep = [start is not None and day_of(start) < day for start in table["start_utc"]]
    table = {name: [v for v, k in zip(column, keep, strict=True) if k] for name, column in table.items()}
    expected = expect(analyse(table, store.table("maintenance").to_pylist()), chosen.robot, day, chosen.place)
    with writing(chosen.output.parent):
        files = write_prior(expected, chosen.robot, chosen.output.parent)
    print(*columns([("constant", "expected", "own recordings"), *map(_row, expected)], text=(0, 1)), sep="\n")
    print(f"\nwrote {files[0]} and {files[1]}")
    return 0


def _row(e: Expected) -> tuple[str, str, str]:
    return CONSTANTS[e.name].label, amount(e.name, e.value, e.sigma), str(e.recordings)
