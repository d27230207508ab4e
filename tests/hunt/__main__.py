"""`python -m hunt`: search for drives and faults that make the published pose lie."""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import msgspec

from drd_tools.report.terminal import print_table
from hunt.judge import once
from hunt.search import Case, Tally, causes, hunt, repeats

CASES_FROM: Final = 1.5  # the ratio that is never to be passed


def main(argv: Sequence[str] | None = None) -> int:
    """Search, simplify and print. Returns 0, or 1 where something outside the named classes is beyond the goal."""
    parser = argparse.ArgumentParser(
        prog="python -m hunt",
        description="Genomes of drives, faults, robots and configurations go through drd.pipeline as bytes and frames "
        "in simulated time; those with the largest error over bound in valid rows breed.",
        epilog="example: python -m hunt --drives 100000 --jobs 2 --output out/hunt",
    )
    parser.add_argument(
        "--drives", type=int, default=1000, help="in all; a search goes on from its file [default 1000]"
    )
    parser.add_argument("--jobs", type=int, default=1, help="processes [default 1]")
    parser.add_argument("--seed", type=int, default=1, help="of a new search [default 1]")
    parser.add_argument("--output", type=Path, metavar="DIR", help="takes hunt.json and cases.json")
    parser.add_argument("--cases", action="store_true", help="simplify the worst cases, too")
    parser.add_argument("--replay", metavar="FILE:NUMBER", help="drive a case of cases.json again")
    arguments = parser.parse_args(argv)
    if arguments.replay:
        return _replay(*arguments.replay.rsplit(":", 1))
    if arguments.output is None:
        parser.error("--output: expected a folder")
    arguments.output.mkdir(parents=True, exist_ok=True)
    found = hunt(arguments.output / "hunt.json", arguments.drives, arguments.jobs, arguments.seed)
    _print_tallies("drives", found.tallies)
    _print_tallies("at random, one kind of event", found.single)
    cases = causes(found.niches.values(), CASES_FROM) if arguments.cases else []
    cases += [*found.wrong.values(), *found.jumps.values()]
    (arguments.output / "cases.json").write_bytes(msgspec.json.format(msgspec.json.encode(cases)))
    _print_cases(cases)
    return int(any(not case.genome.named for case in cases))


def _replay(file: str, number: str) -> int:
    case = msgspec.json.decode(Path(file).read_bytes(), type=list[Case])[int(number)]
    _print_cases([Case(case.genome, once(case.genome))])
    scores = repeats(case.genome)
    print(f"{len(scores)} other robots and noises: " + " ".join(f"{score:.2f}" for score in scores))
    return 0


def _print_tallies(about: str, tallies: dict[str, Tally]) -> None:
    rows = [
        [
            name,
            str(t.drives),
            str(t.rows),
            f"{100.0 * t.beyond / max(1, t.rows):.2f}",
            str(t.drives_beyond),
            f"{t.worst:.2f}",
        ]
        for name, t in sorted(tallies.items(), key=lambda row: -row[1].beyond / max(1, row[1].rows))
    ]
    print_table([about, "drives", "valid rows", "% beyond", "drives with", "worst"], rows)


def _print_cases(cases: Sequence[Case]) -> None:
    for number, case in enumerate(cases):
        f = case.found
        ratios = f"{f.score:.2f} (position {f.position:.2f}, heading {f.heading:.2f}) at {f.at_s:.1f} s"
        print(f"{number}: {ratios}, {f.beyond} of {f.rows} rows, jump {f.jump:.2f} {' '.join(f.wrong)}")
        print(f"   {case.genome.text()}")


if __name__ == "__main__":
    raise SystemExit(main())
