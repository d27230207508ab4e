"""`drd fleet report`: one page on a whole store."""

from pathlib import Path

from drd.commands import command, writing
from drd_tools.fleet.statistics import analyse
from drd_tools.fleet.store import existing

DESCRIPTION = """\
Report which robots, floors and gyro batches have changed, since when and with what certainty, and what to inspect
first: on one page, DIR/fleet.html, with all robots and effects as a heat map, trends with their changes, outliers, and
the recordings of each robot with links to their own reports. It needs no server.
"""
EXAMPLES = """\
examples:
  drd fleet report fleet --output out/fleet

Exit code: 0 done, 2 bad usage or input.
"""


def main(argv: list[str]) -> int:
    """Analyse the store's constants, print the findings, write the page. Raises ConfigError on bad input."""
    parser = command("drd fleet report", DESCRIPTION, EXAMPLES)
    parser.add_argument("store", metavar="STORE", help="folder or bucket that drd fleet update has filled")
    parser.add_argument("--output", type=Path, required=True, metavar="DIR", help="folder for fleet.html")
    chosen = parser.parse_args(argv)
    from drd_tools.fleet.report import URGENT, write_report  # noqa: PLC0415  # matplotlib is slow
    from drd_tools.fleet.sentences import headline, sentences  # noqa: PLC0415

    store = existing(chosen.store)
    constants, recordings = store.table("constants").to_pydict(), store.index().to_pylist()
    found = analyse(constants, store.table("maintenance").to_pylist())
    said = sentences(found)
    robots = {row["robot"] for row in recordings}
    print(*headline(found, len(robots), len(recordings)), *[s.text for s in said[:URGENT]], sep="\n")
    with writing(chosen.output):
        files = write_report(found, constants, recordings, chosen.output)
    print(f"\nwrote {files[0]}")
    return 0
