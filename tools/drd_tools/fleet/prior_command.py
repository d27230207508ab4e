"""`drd fleet prior`: write the prior for a robot's daemon."""

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from statistics import median
from typing import Any

from drd.commands import command, writing
from drd.config.schema import ConfigError
from drd_tools.fleet.prior import Expected, expect, write_prior
from drd_tools.fleet.sentences import amount
from drd_tools.fleet.series import CONSTANTS, day_of
from drd_tools.fleet.statistics import analyse
from drd_tools.fleet.store import existing
from drd_tools.report.terminal import columns

Table = Mapping[str, Sequence[Any]]
Rows = Sequence[Mapping[str, Any]]
DESCRIPTION = """\
Write the prior for a robot's daemon: the robot's constants, estimated from its own history and the fleet's population,
as model.yaml (for model.file of the configuration, and drd replay --model), and their standard deviations as prior.yaml
next to it (keys of estimation.initial: put them into the configuration, or pass the file to drd replay --config).
"""
EXAMPLES = """\
examples:
  drd fleet prior fleet --robot 7 --output robot7/model.yaml
  drd fleet prior fleet --robot 7 --before 2026-06-01 --output robot7/model.yaml      (as if it were that day)
  drd replay friday/ --model robot7/model.yaml --config robot7/prior.yaml --output poses.csv

  drd fleet prior fleet --robot warthog --check recordings/warthog_*            (does the prior help?)

--check shows the position error of the first 60 and 120 s of recordings, with robot.yaml alone and with a prior of the
recordings that began before each of them; nothing is written. A robot that is not in the store gets the
population's mean and scatter.

Exit code: 0 done, 2 bad usage or input.
"""


def main(argv: list[str]) -> int:
    """Write the files, print the constants. Raises ConfigError on bad input."""
    parser = command("drd fleet prior", DESCRIPTION, EXAMPLES)
    add = parser.add_argument
    add("store", metavar="STORE", help="folder or bucket that drd fleet update has filled")
    add("--robot", required=True, metavar="ID", help="robot for which to write the prior")
    add("--place", metavar="NAME", help="place of the next drives (default: any)")
    add("--before", type=datetime.fromisoformat, metavar="DATE", help="only recordings before (default: all)")
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument("--output", type=Path, metavar="model.yaml", help="file; prior.yaml is written next to it")
    what.add_argument("--check", type=Path, nargs="+", metavar="RECORDING", help="folders of the store's recordings")
    chosen = parser.parse_args(argv)
    if chosen.output is not None and chosen.output.name != "model.yaml":
        parser.error(f"--output: expected a file named model.yaml, got {chosen.output.name}")
    store = existing(chosen.store)
    table, done = store.table("constants").to_pydict(), store.table("maintenance").to_pylist()
    if chosen.check is not None:
        return _check(chosen.check, table, done, chosen.robot, chosen.place)
    day = day_of(chosen.before if chosen.before is not None else datetime.now(UTC))
    expected = expect(analyse(_before(table, day), done), chosen.robot, day, chosen.place)
    with writing(chosen.output.parent):
        files = write_prior(expected, chosen.robot, chosen.output.parent)
    print(*columns([("constant", "expected", "own recordings"), *map(_row, expected)], text=(0, 1)), sep="\n")
    print(f"\nwrote {files[0]} and {files[1]}")
    return 0


def _before(table: Table, day: float) -> Table:
    keep = [start is not None and day_of(start) < day for start in table["start_utc"]]
    return {name: [v for v, k in zip(column, keep, strict=True) if k] for name, column in table.items()}


def _check(folders: Sequence[Path], table: Table, done: Rows, robot: str, place: str | None) -> int:
    from drd_tools.fleet.prior_check import compare  # noqa: PLC0415  # the estimator

    starts = dict(zip((r.rpartition("/")[2] for r in table["recording"]), table["start_utc"], strict=True))
    rows = []
    for folder in folders:
        name = folder.resolve().name
        if starts.get(name) is None:
            raise ConfigError(str(folder), "", "a recording of the store whose start is known", "another")
        day = day_of(starts[name])
        earlier = _before(table, day)
        if robot not in earlier["robot"]:
            print(f"{name}: no earlier recording of {robot}")
            continue
        without, with_it = compare(folder, expect(analyse(earlier, done), robot, day, place), robot)
        rows.append([name, *(f"{e.position_m:.3f}" for pair in zip(without, with_it, strict=True) for e in pair)])
    header = ["position error, rms, m", "60 s", "with prior", "120 s", "with prior"]
    if rows:
        middle = [f"{median(float(row[k]) for row in rows):.3f}" for k in range(1, len(header))]
        print(*columns([header, *rows, ["median", *middle]]), sep="\n")
    return 0


def _row(e: Expected) -> tuple[str, str, str]:
    return CONSTANTS[e.name].label, amount(e.name, e.value, e.sigma), str(e.recordings)
