"""`drd trial`: how often the diagnosis is right."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from drd.commands import command, whole, writing
from drd.config.schema import ConfigError
from drd_tools.report.terminal import columns
from drd_tools.simulate.conditions import Reference
from drd_tools.trial import baselines, distances, fleet, live, live_cases, live_figures, plant, sbmi
from drd_tools.trial.figures import Figures, Table
from drd_tools.trial.plan import CONTACTS, LARGE, LARGE_BESIDE, NONE, Plan, drawings, is_chosen
from drd_tools.trial.planted import not_visible, planted_table, reported
from drd_tools.trial.results import Head, Row, Store, read_answers, save
from drd_tools.trial.run import Others, calls
from drd_tools.trial.text import PROGRAM, failures, text
from drd_tools.trial.workers import completed

NULLS_TIMES = 4  # nulls of each kind per case of an effect

DESCRIPTION = """\
Run the diagnosis blind on recordings with known answers and score it: share of recordings in which nothing is missing
and something is reported, names correct first and as a set, names wrong even as a class, unknown physics flagged and
misnamed, overlap of windows, truth within the 90 % intervals, and the benefit of the correction on another drive of the
same robot compared with an oracle that knows the truth; with 95 % Wilson intervals, and next to sparse regressions of
the same library (lasso, E-SINDy, BIC; those whose packages are installed: pip install 'drd[baselines]') and, with
--sbmi N, a classifier trained on N drives of the same kinds, a second each, to detect which effects are present.

Cases are drawn by seed, each from its name and the seed alone:
  null-plain-*, null-stressed-*    nothing is missing; stressed: noise 30 % off its datasheets, heavy tails, reference
                                   late, off the centre and rotated
  EFFECT-d8-*, -d12-*, -d20-*      one effect of the catalogue, of that detectability; EFFECT-event-*: one that
                                   destroys readings
  pair-*, triple-*                 two and three effects, each with d = 20
  unknown_*-d20-*                  physics that is in no catalogue
  null-KIND-*, any-KIND-*          nothing, or any effect with d = 20; KIND: sparse (a pose a minute), ends (at both
                                   ends only), none (no reference), contacts (the MuJoCo world)
--folder adds recordings with answers.json.

--plant uses real drives instead: each effect of the catalogue is planted in their raw data with d = 12 and 25, by the
noise weighting of that drive's diagnosis, and diagnosed; the findings are scored relative to those of the unmodified
drive: named first, in its class, size within 3 sigma, window, the 90 % intervals, and other names.

--distances instead simulates the drives that `drd diagnose` advises, 3 minutes each, and reports how well each of them
separates each effect, with d = 12, from each other one: distances.csv and .json, and heat maps in distances.html.

--live tests the monitor (drd/monitor) instead: drives of 8 minutes without a reference on which an effect begins in
mid-run with d = 8, 12 and 25 per 100 m, N of each, and four times as many with nothing missing, with stressed noise, on
asphalt, and on ground that changes; scored are the correct class within 60 s or 100 m, its onset, and false names.

--fleet tests the statistics of a fleet (drd fleet) instead: N fleets of 40 robots and 90 days as made by drd fleet
simulate --summaries, analysed evening by evening; scored are detected changes, their delay, date and robot, and false
detections.

Each case is saved when it is complete: the same command resumes where it was stopped. Results of another build of the
diagnosis are moved to results.old.jsonl.
"""
EXAMPLES = f"""\
examples:
  {PROGRAM} --each 1 --only '*-d20-*' --minutes 4 5 --output out/singles
  {PROGRAM} --each 40 --only 'null-*' --no-baselines --output out/nulls
  {PROGRAM} --large --seed 7 --output out/large                   (an hour on two cores)
  {PROGRAM} --folder ../shared/trials --output out/given
  {PROGRAM} --plant ../shared/recordings --glob 'warthog_*' --output out/planted   (15 minutes a drive)
  {PROGRAM} --distances --output out/distances                    (which effects each manoeuvre separates; a minute)
  {PROGRAM} --live 1 --output out/live                            (the monitor; five minutes)
  {PROGRAM} --fleet 5 --output out/fleets                         (the fleet's statistics; a minute each)
  {PROGRAM} --draw out/large --quote tools/drd_tools/trial/README.md     (print and draw again, and quote)

Exit code: 0 done, 2 bad usage or input.
"""


def main(argv: list[str]) -> int:
    """Run, save, print, draw. Returns the exit code: 0, or 2 for bad usage. Raises ConfigError on bad input."""
    parser = _parser()
    chosen = parser.parse_args(argv)
    if chosen.draw is not None:
        if not (chosen.draw / live.RESULTS).exists():
            return _drawn(chosen.draw, chosen.quote)
        _tell_live(chosen.draw)
        return 0
    drawn, instead = chosen.folder or chosen.each or chosen.large, chosen.plant or chosen.distances
    if chosen.live or chosen.fleet:
        option, run = ("--live", _live) if chosen.live else ("--fleet", _fleet)
        if drawn or instead:
            parser.error(f"{option} cannot be combined with --each, --large, --folder, --plant or --distances")
        with writing(chosen.output):
            run(chosen)
        return 0
    if not (drawn or instead):
        parser.error("give --each N, --large, --folder DIR, --plant RECORDINGS, --distances, --live N or --fleet N")
    if instead and (drawn or (chosen.plant and chosen.distances)):
        parser.error("--plant and --distances cannot be combined with each other, --each, --large or --folder")
    if chosen.distances:
        return _distances(chosen)
    with writing(chosen.output):
        (_plant if chosen.plant else _run)(chosen)
        return _drawn(chosen.output, chosen.quote)


def _live(chosen: argparse.Namespace) -> None:
    todo = [
        case
        for case in live_cases.cases(chosen.live, NULLS_TIMES * chosen.live, chosen.seed, chosen.remembers)
        if is_chosen(case.name, chosen.only)
    ]
    if not todo:
        raise ConfigError("--only", "", "a pattern that some case's name matches", " ".join(chosen.only))
    kept = live.Kept(chosen.output)
    done = kept.begin()
    if done:
        print(f"{len(done)} cases are there already", file=sys.stderr)
    for row in live.run([case for case in todo if case not in done], chosen.jobs):
        kept.add(row)
    _tell_live(chosen.output)


def _tell_live(folder: Path) -> None:
    rows = live.Kept(folder).read()
    seeds = ", ".join(map(str, sorted({row.case.seed for row in rows})))
    options = " --remembers" * any(row.case.remembers for row in rows)
    origin = f"Made by `drd trial --live{options}`, seed {seeds}: {len(rows)} cases."
    titles = "Trial of the monitor", origin, "Wrong, late or missed"
    _tell(folder / "live.html", titles, live_figures.tables(rows), live_figures.lines(rows))


def _fleet(chosen: argparse.Namespace) -> None:
    seeds = range(chosen.seed, chosen.seed + chosen.fleet)
    rows = sorted(fleet.run(seeds, chosen.jobs), key=lambda row: row.seed)
    origin = f"Made by `drd trial --fleet {chosen.fleet}`, seed {chosen.seed}."
    save(chosen.output / "fleet.jsonl", rows)
    titles = "Trial of the fleet's statistics", origin, "Missed, late, misdated, and what is not there"
    _tell(chosen.output / "fleet.html", titles, fleet.tables(rows), fleet.lines(rows))


def _tell(file: Path, titles: tuple[str, str, str], tables: Sequence[Table], lines: Sequence[str]) -> None:
    """Print tables and lines, and write them as a page; `titles`: the page's, its origin, and that of the lines."""
    from drd_tools.report.page import Page  # noqa: PLC0415  # its template engine is slow

    page = Page(titles[0], [titles[1]])
    for table in tables:
        page.heading(table.caption)
        page.table(table.header, table.rows)
        print("\n".join([table.caption, *columns([table.header, *table.rows]), ""]))
    page.heading(titles[2])
    page.code("\n".join(lines) or "none")
    page.save(file)
    print("\n".join(lines))
    print(f"\nwrote {file.with_suffix('.jsonl')}, {file}")


def _run(chosen: argparse.Namespace) -> None:
    only = tuple(chosen.only)
    answers = [] if chosen.folder is None else read_answers(chosen.folder)
    answers = [a for a in answers if is_chosen(a.case, only)]
    Reference.parse(chosen.reference)
    low, high = chosen.minutes
    if not 0.5 <= low <= high <= 600.0:
        raise ConfigError("--minutes", "", "0.5 <= LOW <= HIGH <= 600", f"{low:g} {high:g}")
    plan = LARGE if chosen.large else Plan(*[chosen.each] * len(NONE))
    drawn = list(drawings(plan, chosen.seed, (low, high), chosen.reference, only))
    if any(d.world == CONTACTS for d in drawn) and not baselines.is_there("mujoco"):
        print("No drives of the MuJoCo world: mujoco is not installed (pip install 'drd[mujoco]').", file=sys.stderr)
        drawn = [d for d in drawn if d.world != CONTACTS]
    if not answers and not drawn:
        raise ConfigError("--only", "", "a pattern that some case's name matches", " ".join(only))
    others = _others(chosen)
    folder = None if chosen.folder is None else str(chosen.folder)
    methods = [*others.names, *([f"{sbmi.METHOD} of {chosen.sbmi}"] if others.trained else [])]
    head = Head(seed=chosen.seed, minutes=(low, high), reference=chosen.reference, folder=folder, baselines=methods)
    store = Store(chosen.output)
    done = {row.case for row in store.begin(head)}
    answers, drawn = [a for a in answers if a.case not in done], [d for d in drawn if d.name not in done]
    if done:
        print(f"{len(done)} cases are there already, {len(answers) + len(drawn)} are to do", file=sys.stderr)
    if others.trained:
        sbmi.train(others.trained, chosen.sbmi, chosen.seed, (low, high), chosen.jobs)
    beside = LARGE_BESIDE if chosen.large else 1
    for row in completed(calls(chosen.folder, answers, drawn, others, beside), chosen.jobs):
        store.add(row)


def _distances(chosen: argparse.Namespace) -> int:
    from drd_tools.trial.distance_page import text as told  # noqa: PLC0415  # matplotlib is slow
    from drd_tools.trial.distance_page import write_page as write  # noqa: PLC0415

    found = distances.Distances(list(completed(distances.calls(chosen.seed), chosen.jobs)))
    files = write(found, chosen.output)
    print(f"{told(found)}\n\nwrote {', '.join(map(str, files))}")
    return 0


def _plant(chosen: argparse.Namespace) -> None:
    drives = plant.drives(chosen.plant, chosen.glob)
    store = Store(chosen.output)
    done = store.begin(Head(seed=chosen.seed, plant=str(chosen.plant), glob=chosen.glob))
    if done:
        print(f"{len(done)} cases are there already", file=sys.stderr)
    for row in plant.run(drives, chosen.seed, done, chosen.jobs, chosen.only):
        store.add(row)


def _others(chosen: argparse.Namespace) -> Others:
    """Other methods whose packages are installed; prints which are not."""
    names = baselines.installed() if chosen.baselines else ()
    missing = [f"{name} (package {baselines.PACKAGES[name]})" for name in baselines.PACKAGES if name not in names]
    if chosen.sbmi and not baselines.is_there(sbmi.PACKAGE):
        missing.append(f"{sbmi.METHOD} (package {sbmi.PACKAGE})")
    if (chosen.baselines or chosen.sbmi) and missing:
        print(f"Left out, not installed: {', '.join(missing)}; pip install 'drd[baselines]'", file=sys.stderr)
    return Others(names, chosen.output / sbmi.FILE if chosen.sbmi and baselines.is_there(sbmi.PACKAGE) else None)


def _drawn(folder: Path, quoting: Path | None) -> int:
    """Print and draw the results in a folder, and quote them."""
    from drd_tools.trial.page import Content, origin, quote, write_page  # noqa: PLC0415  # matplotlib is slow

    head, rows = Store(folder).read()
    if isinstance(head.plant, str):
        tables = [t for t in (planted_table(rows), not_visible(rows)) if t.rows]
        about = (
            f"Made by `drd trial --plant`, seed {head.seed}, drives {head.glob}, build {head.build} of the diagnosis."
        )
        content = Content(about, tables, "Each planted effect (+: not reported of the untouched drive)", reported(rows))
        print("\n".join(line for t in tables for line in (t.caption, *columns([t.header, *t.rows]), "")))
        quoting = None
    else:
        figures, again = Figures(rows), _again(head, rows)
        title = "Failures, and how to make each alone"
        content = Content(origin(figures, head), figures.tables(), title, failures(figures, again), figures)
        print(text(figures, again))
    files = write_page(content, folder)
    if quoting is not None:
        quote(figures, head, quoting)
        files.append(quoting)
    print(f"\nwrote {', '.join(str(f) for f in files)}; {PROGRAM} --draw {folder} prints and draws it again")
    return 0


def _again(head: Head, rows: Sequence[Row]) -> list[str]:
    """Arguments that draw the same cases again."""
    low, high = head.minutes
    numbers = [int(n) for row in rows if (n := row.case.rpartition("-")[2]).isdigit()]
    made = ["--seed", str(head.seed), "--minutes", f"{low:g}", f"{high:g}", "--reference", head.reference]
    made += ["--each", str(max(numbers) + 1)] if numbers else []
    return made + (["--folder", head.folder] if head.folder else [])


def _parser() -> argparse.ArgumentParser:
    parser = command(PROGRAM, DESCRIPTION, EXAMPLES)
    add: Any = parser.add_argument
    size = parser.add_mutually_exclusive_group()
    many: Any = size.add_argument
    many("--each", type=whole(0), default=0, metavar="N", help="N cases of each kind, effect and detectability")
    many("--large", action="store_true", help=f"the whole trial: {_sizes()}")
    add("--folder", type=Path, metavar="DIR", help="add recordings with answers.json")
    add("--plant", type=Path, metavar="RECORDINGS", help="instead: plant effects in the real drives of this folder")
    add("--distances", action="store_true", help="instead: how well each manoeuvre separates the effects")
    add("--live", type=whole(0), default=0, metavar="N", help="instead: N cases of each effect and d for the monitor")
    add("--remembers", action="store_true", help="with --live: the monitor begins with a memory of earlier drives")
    add("--fleet", type=whole(0), default=0, metavar="N", help="instead: N fleets for the fleet's statistics")
    add("--glob", default="*", metavar="PATTERN", help="with --plant: only drives whose names match")
    add("--seed", type=whole(0), default=0, metavar="S", help="seed of the cases (default 0)")
    add("--minutes", type=float, nargs=2, default=(4.0, 10.0), metavar=("LOW", "HIGH"), help="each drive (4 10)")
    add("--reference", default="full", metavar="WHEN",
        help="full (default), sparse:SECONDS, ends or none, if the kind does not state it")  # fmt: skip
    add("--only", nargs="+", default=["*"], metavar="PATTERN", help="only cases whose names match one of these")
    add("--no-baselines", dest="baselines", action="store_false", help="only the diagnosis, without other methods")
    add("--sbmi", type=whole(0), default=0, metavar="N", help="also SBMI, trained on N simulated drives (e.g. 400)")
    add("--jobs", type=whole(1), default=2, metavar="N", help="processes (default 2)")
    add("--quote", type=Path, metavar="FILE", help="insert the short table between the marks in FILE")
    add = parser.add_mutually_exclusive_group(required=True).add_argument
    add("--output", type=Path, metavar="DIR", help="folder for results.jsonl, trial.html and figures.md")
    add("--draw", type=Path, metavar="DIR", help="only print and draw the results in this folder")
    return parser


def _sizes() -> str:
    p = LARGE
    return (
        f"{2 * p.nulls} nulls, {p.singles} drives of each effect at each d, {2 * p.sets} sets, {p.unknowns} "
        f"of each unknown cause, {p.variants} with and without an effect for each other reference, {p.contacts} in "
        f"MuJoCo; the other methods on one in {LARGE_BESIDE}"
    )
