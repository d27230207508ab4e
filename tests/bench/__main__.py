"""`python -m bench`: all benchmarks in one run."""

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from bench import (
    allocation,
    clients,
    cpu,
    filter,
    fleet,
    flood,
    latency,
    load,
    overload,
    rates,
    realtime,
    recording,
    replay,
)
from bench.report import Refused, Report, as_json, table

BENCHMARKS: dict[str, Callable[[bool], Report]] = {
    "filter": filter.run,
    "allocation": allocation.run,
    "rates": rates.run,
    "latency": latency.run,
    "cpu": cpu.run,
    "flood": flood.run,
    "clients": clients.run,
    "recording": recording.run,
    "replay": replay.run,
    "load": load.run,
    "overload": overload.run,
    "fleet": fleet.run,
    "realtime": realtime.run,
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run benchmarks and print them. Returns 0, or 1 where one of them refused to print a figure."""
    parser = argparse.ArgumentParser(
        prog="python -m bench",
        description="Measure the daemon against yardsticks in the same run; ratios are what counts, as machines "
        "differ. Leave the machine alone meanwhile.",
    )
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"only these: {', '.join(BENCHMARKS)}")
    parser.add_argument("--quick", action="store_true", help="a few seconds, to see that it works; no figures to quote")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures there too")
    parser.add_argument("--minutes", type=float, default=1.0, help="how long `realtime` goes on [default 1]")
    arguments = parser.parse_args(argv)
    if not arguments.minutes >= 0.1:
        parser.error("--minutes: expected 0.1 or more")
    unknown = [name for name in arguments.names if name not in BENCHMARKS]
    if unknown:
        parser.error(f"no benchmark {unknown[0]!r}; there are {', '.join(BENCHMARKS)}")
    reports: dict[str, Report] = {}
    refusals = 0
    for name in arguments.names or BENCHMARKS:
        try:
            timed = name == "realtime"
            run = partial(realtime.run, minutes=arguments.minutes) if timed else BENCHMARKS[name]
            reports[name] = run(arguments.quick)
        except Refused as refusal:
            print(refusal, file=sys.stderr)
            refusals += 1
        else:
            print(f"{table(reports[name])}\n", flush=True)
    if arguments.json is not None:
        arguments.json.write_text(json.dumps(as_json(reports, arguments.quick), indent=2) + "\n", encoding="utf-8")
    return 1 if refusals else 0


if __name__ == "__main__":
    raise SystemExit(main())
