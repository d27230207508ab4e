"""`python -m drd_tools.trial`: score the diagnosis."""

import argparse
import json
import sys
from collections.abc import Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from drd.schema import ConfigError
from drd_tools.diagnose.outcome import write_json
from drd_tools.simulate.conditions import Reference
from drd_tools.trial.draw import drawings
from drd_tools.trial.run import read_answers, run
from drd_tools.trial.text import told

RESULTS = "results.json"
DESCRIPTION = """\
Run the diagnosis on recordings whose answer is known, and score it: share of recordings in which nothing is missing and
something is claimed, names right first, names right as a set, truth within the 90 % intervals, and what was confused.

Recordings are those of a folder with answers.json (--folder), and drawn ones (--simulated N): N nulls with noise as
on the data sheets, N stressed ones (noise off the sheets by 30 %, heavy tails, reference late and off the centre),
N drives of each effect at each visibility (12 and 25), and N pairs. A case depends on its name and the seed only.
"""
EXAMPLES = """\
examples:
  python -m drd_tools.trial --folder ../shared/trials --output out/given
  python -m drd_tools.trial --simulated 40 --only 'null-*' --output out/nulls
  python -m drd_tools.trial --simulated 1 --only '*-d25-*' --seed 3 --jobs 1 --output out/singles
  python -m drd_tools.trial --draw out/nulls                              (print again)
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run, save, print. Returns the exit code: 0, or 2 for bad usage or input."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    parser = _parser()
    chosen = parser.parse_args(arguments)
    try:
        if chosen.draw is not None:
            print(told(_read(chosen.draw / RESULTS)))
            return 0
        if chosen.output is None or not (chosen.folder or chosen.simulated):
            parser.error("give --output DIR with --folder or --simulated, or --draw DIR")
        results = _run(chosen)
    except ConfigError as error:
        print(f"drd_tools.trial: {error}", file=sys.stderr)
        return 2
    print(told(results))
    print(f"\nwrote {chosen.output / RESULTS}; {parser.prog} --draw {chosen.output} prints it again")
    return 0


def _run(chosen: argparse.Namespace) -> dict[str, Any]:
    only = tuple(chosen.only)
    answers = [] if chosen.folder is None else read_answers(chosen.folder)
    answers = [a for a in answers if any(fnmatchcase(a["case"], pattern) for pattern in only)]
    Reference.parse(chosen.reference)
    low, high = chosen.minutes
    if not 0.5 <= low <= high <= 600.0:
        raise ConfigError("--minutes", "", "0.5 <= LOW <= HIGH <= 600", f"{low:g} {high:g}")
    drawn = list(drawings(chosen.simulated, chosen.seed, (low, high), chosen.reference, only))
    if not answers and not drawn:
        raise ConfigError("--only", "", "a pattern that some case's name matches", " ".join(only))
    again = ["--seed", str(chosen.seed), "--simulated", str(chosen.simulated), "--reference", chosen.reference]
    again += ["--minutes", f"{low:g}", f"{high:g}"]
    if chosen.folder is not None:
        again += ["--folder", str(chosen.folder)]
    results: dict[str, Any] = {"format": "drd-trial/1", "arguments": again, "records": []}
    try:
        chosen.output.mkdir(parents=True, exist_ok=True)
        for record in run(chosen.folder, answers, drawn, chosen.jobs):
            results["records"].append(record)
            # After each: a long trial that is stopped keeps what it has.
            write_json(chosen.output / RESULTS, results)
    except OSError as error:
        raise ConfigError(str(chosen.output), "", "a folder to write to", str(error)) from error
    return _read(chosen.output / RESULTS)


def _read(file: Path) -> dict[str, Any]:
    try:
        results: Any = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ConfigError(str(file), "", "results of a trial", str(error)) from error
    if not isinstance(results, dict) or results.get("format") != "drd-trial/1":
        raise ConfigError(str(file), "format", "drd-trial/1", "something else")
    return results


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m drd_tools.trial",
        description=DESCRIPTION,
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add: Any = parser.add_argument
    add("--folder", type=Path, metavar="DIR", help="recordings with answers.json")
    add("--simulated", type=_count, default=0, metavar="N", help="so many of each kind (default 0)")
    add("--seed", type=_count, default=0, metavar="S", help="other drawn cases (default 0)")
    add("--minutes", type=float, nargs=2, default=(4.0, 10.0), metavar=("LOW", "HIGH"), help="of a drive (4 10)")
    add("--reference", default="full", metavar="WHEN", help="full (default), sparse:SECONDS, ends or none")
    add("--only", nargs="+", default=["*"], metavar="PATTERN", help="only cases whose names match one of these")
    add("--jobs", type=_jobs, default=2, metavar="N", help="processes (default 2)")
    add("--output", type=Path, metavar="DIR", help="folder for results.json")
    add("--draw", type=Path, metavar="DIR", help="only print what this folder holds")
    return parser


def _count(text: str) -> int:
    value = int(text)
    if value < 0:
        raise argparse.ArgumentTypeError(f"0 or more, got {text}")
    return value


def _jobs(text: str) -> int:
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"1 or more, got {text}")
    return value


if __name__ == "__main__":
    raise SystemExit(main())
