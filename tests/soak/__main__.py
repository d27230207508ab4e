"""`python -m soak`: hours of sensor data with faults through the daemon's core, as fast as it goes."""

import argparse
from collections.abc import Sequence
from pathlib import Path

from soak.run import rounds_for, soak
from soak.text import as_json, failures, table


def main(argv: Sequence[str] | None = None) -> int:
    """Run it and print the table. Returns 0, or 1 where something was not shown."""
    parser = argparse.ArgumentParser(
        prog="python -m soak",
        description="The daemon's core (drd.pipeline) is fed with emulated sensors' bytes and frames in simulated "
        "time.  Each lap of 2 minutes has one fault; the faults come in turn. Every pose is held against the truth, "
        "every counter against what was sent, memory at the end against memory after the first round.",
        epilog="example: make soak SOAK_HOURS=24",
    )
    parser.add_argument("--hours", type=float, default=24.0, help="of simulated time, in whole rounds [default 24]")
    parser.add_argument("--output", type=Path, required=True, metavar="DIR", help="takes soak.txt and soak.json")
    parser.add_argument("--seed", type=int, default=1, help="of all random numbers [default 1]")
    parser.add_argument("--monitor", action="store_true", help="the monitor's process gets the samples, too")
    arguments = parser.parse_args(argv)
    if not 0.0 < arguments.hours <= 1000.0:
        parser.error("--hours: expected a number above 0, up to 1000")
    arguments.output.mkdir(parents=True, exist_ok=True)
    result = soak(arguments.output, rounds_for(arguments.hours), arguments.seed, arguments.monitor)
    text = table(result)
    print(text)
    for name, content in (("soak.txt", f"{text}\n"), ("soak.json", as_json(result))):
        (arguments.output / name).write_text(content, encoding="utf-8")
        print(f"wrote {arguments.output / name}")
    return 1 if failures(result) else 0


if __name__ == "__main__":
    raise SystemExit(main())
