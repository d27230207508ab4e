"""`make honesty`: print the table of all drives, and fail if a promise is broken."""

import os
import sys
from pathlib import Path

from drd.commands import command, whole
from drd.config.schema import ConfigError
from drd_tools.honesty.promises import promises
from drd_tools.honesty.results import Results
from drd_tools.honesty.run import FULL_SEEDS, SHORT_SEEDS, run
from drd_tools.honesty.table import text_of

DESCRIPTION = """\
Judge the estimator on every drive that has a reference: the shared recordings of real robots, and simulated drives by
the hundred. Prints one table, and each promise that is broken.
"""
EPILOG = "Exit code: 0 all promises kept, 1 one is broken, 2 bad usage or input."


def main(argv: list[str]) -> int:
    """Run or read saved results, print, judge."""
    parser = command("python -m drd_tools.honesty", DESCRIPTION, EPILOG)
    add = parser.add_argument
    add("--short", action="store_true", help=f"{SHORT_SEEDS} seeds a scenario, fewer real drives: for CI")
    add("--seeds", type=whole(1), metavar="N", help=f"seeds a scenario (default {FULL_SEEDS})")
    add("--jobs", type=whole(1), default=os.cpu_count() or 1, metavar="N", help="processes (default: one a core)")
    add("--json", type=Path, metavar="FILE", help="keep the results here")
    add("--read", type=Path, metavar="FILE", help="print again what --json has kept, instead of running")
    chosen = parser.parse_args(argv)
    seeds = chosen.seeds or (SHORT_SEEDS if chosen.short else FULL_SEEDS)
    try:
        results = Results.read(chosen.read) if chosen.read else run(seeds, short=chosen.short, jobs=chosen.jobs)
        if chosen.json is not None:
            results.write(chosen.json)
    except (ConfigError, OSError) as error:
        print(f"honesty: {error}", file=sys.stderr)
        return 2
    print(text_of(results))
    return 0 if all(verdict.kept for verdict in promises(results)) else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
