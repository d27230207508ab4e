"""Report of a fleet: one page that needs no server, for one robot or a thousand."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import cache
from pathlib import Path
from typing import Any, Final, NamedTuple
from urllib.parse import quote

import numpy as np
from markupsafe import Markup
from matplotlib import colormaps
from matplotlib.colors import rgb2hex

from drd_tools.fleet.changes import CREEP
from drd_tools.fleet.events import Event
from drd_tools.fleet.pictures import COLOURS, overview, trend
from drd_tools.fleet.sentences import Sentence, figure, headline, sentences
from drd_tools.fleet.series import CONSTANTS, natural
from drd_tools.fleet.statistics import Fitted, Statistics
from drd_tools.report.page import Page, rendered

PAGE: Final = "fleet.html"
SHOWN: Final = 50  # rows of the heat map that are not collapsed
TRENDS: Final = 12  # pictures; each takes a quarter of a second
URGENT: Final = 25  # sentences in the table of what to inspect
LEAST_TRENDS: Final = 4  # pictures, even if less is found
TREND: Final = (
    "Line and band: the level with 90 %; red: when it changed, with 90 %; green: maintenance. What place, batch and "
    "season do to all robots is taken off."
)
OLD: Final = 100  # recordings listed per robot, the newest


class Cell(NamedTuple):
    """A cell of the heat map."""

    text: str
    colour: str
    ink: str
    title: str
    found: bool


class Row(NamedTuple):
    """A recording of a robot."""

    name: str
    place: str
    start: str
    cells: list[str]
    verdict: str
    report: str


@dataclass(frozen=True)
class Robot:
    """A robot with its cells, the sentences about it, and its recordings."""

    name: str
    number: int
    cells: list[Cell]
    sentences: list[str]
    recordings: list[Row]


def write_report(
    found: Statistics, constants: Mapping[str, Sequence[Any]], recordings: Sequence[Mapping[str, Any]], folder: Path
) -> list[Path]:
    """Write fleet.html and its pictures. `constants`: columns, `recordings`: rows of these tables. Raises OSError."""
    folder.mkdir(parents=True, exist_ok=True)
    said = sentences(found)
    robots = _robots(found, said, constants, recordings, folder)
    page = Page("Fleet", [*headline(found, len(robots), len(recordings)), *[s.text for s in said[:3] if not s.is_over]])
    files = [folder / "overview.png"]
    names = list(found.fitted)
    page.heading("What to inspect first")
    urgent, over = [s for s in said if not s.is_over], [s for s in said if s.is_over]
    table = [(str(k), s.text, s.look_at) for k, s in enumerate(urgent[:URGENT], 1)]
    page.table(("", "what", "look at"), table or [("", "nothing has changed", "")], _more(urgent), text_columns=(1, 2))
    if over:
        page.text("What was, and is back as it was:")
        rows = [(str(k), s.text) for k, s in enumerate(over[:URGENT], 1)]
        page.table(("", "what"), rows, _more(over), text_columns=(1,))
    if not names:
        page.save(folder / PAGE)
        return [folder / PAGE]
    page.heading("Robots and effects")
    overview(files[0], [r.name for r in robots], names, _changes(found, [r.name for r in robots]))
    page.picture(files[0], "Blue: smaller than at first, red: larger; grey: not seen.")
    page.text("Each cell: the change since the robot's first recordings; framed: a change that is found.")
    page.text("A robot's name leads to its recordings.")
    labels = [f"{CONSTANTS[n].label}, {CONSTANTS[n].unit}" for n in names]
    page.markup(_markup("heat", robots, labels))
    page.heading("Trends and changes")
    files += _trends(page, found, said, folder)
    _groups(page, found)
    page.heading("Recordings by robot")
    page.markup(_markup("recordings", sorted(robots, key=lambda r: natural(r.name)), labels))
    page.save(folder / PAGE)
    return [folder / PAGE, *files]


def _more(said: Sequence[Sentence]) -> str:
    return f"The first {URGENT} of {len(said)}; the others stand with their robots." if len(said) > URGENT else ""


def _markup(part: str, robots: Sequence[Robot], labels: Sequence[str]) -> Markup:
    values = {"part": part, "robots": robots, "labels": labels, "shown": SHOWN}
    return Markup(rendered("drd_tools.fleet", "robots.html.j2", values))  # it escapes


def _changes(found: Statistics, robots: Sequence[str]) -> Any:
    """Change of each constant since the robot's first segment, in prior sigmas: (constants, robots), NaN if unknown."""
    rows = []
    for f in found.fitted.values():
        of = {name: _change(f, i) for i, name in enumerate(f.log.robots)}
        rows.append([of.get(robot, np.nan) / f.log.constant.jump for robot in robots])
    return np.array(rows)


def _change(fitted: Fitted, robot: int) -> float:
    line = fitted.trends[robot]
    if not len(line.level):
        return np.nan
    return float(line.level[-1] - line.level[0 if line.segments[0][0] == CREEP else line.first])


def _robots(
    found: Statistics, said: Sequence[Sentence], constants: Mapping[str, Sequence[Any]],
    recordings: Sequence[Mapping[str, Any]], folder: Path,
) -> list[Robot]:  # fmt: skip
    """All robots, the most urgent first."""
    rows = _rows(found, constants, recordings, folder)
    told: dict[str, list[Sentence]] = {}
    for s in said:
        told.setdefault(s.robot, []).append(s)
    known = {r for f in found.fitted.values() for r in f.log.robots} | set(rows)
    weight = {r: max((s.weight for s in told.get(r, ())), default=0.0) for r in known}
    events = {(e.robot, e.name): e for e in found.found}
    order = sorted(known, key=lambda r: (-weight[r], natural(r)))
    number = {name: {r: i for i, r in enumerate(f.log.robots)} for name, f in found.fitted.items()}
    return [
        Robot(
            robot, k, [_cell(f, number[n].get(robot), events.get((robot, n))) for n, f in found.fitted.items()],
            [s.text for s in told.get(robot, ())], rows.get(robot, []),
        )
        for k, robot in enumerate(order)
    ]  # fmt: skip


def _cell(fitted: Fitted, robot: int | None, event: Event | None) -> Cell:
    change = np.nan if robot is None else _change(fitted, robot)
    if not np.isfinite(change):
        return Cell("", "#D8D8D8", "#222", "not seen", False)
    part = float(np.clip(change / fitted.log.constant.jump, -1.0, 1.0))
    colour = _colours()[round((len(_colours()) - 1) * (0.5 + 0.5 * part))]
    title = "" if event is None else f"probability {event.probability:.2f}"
    ink = "#fff" if abs(part) > 0.6 else "#222"
    return Cell(figure(fitted.log.name, change), colour, ink, title, event is not None)


@cache
def _colours() -> list[str]:
    """The colours of the heat map, from the smallest to the largest change."""
    return [rgb2hex(colour) for colour in colormaps[COLOURS](np.arange(colormaps[COLOURS].N))]


def _rows(
    found: Statistics, constants: Mapping[str, Sequence[Any]], recordings: Sequence[Mapping[str, Any]], folder: Path
) -> dict[str, list[Row]]:
    """The recordings of each robot, the newest first."""
    names = list(found.fitted)
    values: dict[str, dict[str, str]] = {}
    columns = [constants[c] for c in ("recording", "name", "value", "sigma")]
    for recording, name, value, sigma in zip(*columns, strict=True):
        if name in CONSTANTS and value is not None and sigma is not None:
            c = CONSTANTS[name]
            values.setdefault(recording, {})[name] = f"{c.factor * value:.2f} ± {c.factor * sigma:.2f}"
    by_robot: dict[str, list[Mapping[str, Any]]] = {}
    for row in recordings:
        by_robot.setdefault(str(row["robot"]), []).append(row)
    made = {}
    for robot, every in by_robot.items():
        own = sorted(every, key=lambda r: str(r["start_utc"] or ""), reverse=True)[:OLD]
        made[robot] = [
            Row(str(r["recording"]), str(r["place"] or ""), _when(r["start_utc"]),
                [values.get(r["recording"], {}).get(n, "") for n in names], str(r.get("verdict") or ""),
                _report(r.get("uri"), folder))
            for r in own
        ]  # fmt: skip
    return made


def _when(start: datetime | None) -> str:
    return "" if start is None else f"{start:%Y-%m-%d %H:%M}"


def _report(uri: str | None, folder: Path) -> str:
    """Link to the recording's own report, if its folder has one."""
    if not uri or "://" in uri:
        return ""
    for place in (Path(uri) / "report.html", Path(uri) / "diagnosis" / "report.html"):
        if place.is_file():
            return quote(os.path.relpath(place, folder))
    return ""


def _trends(page: Page, found: Statistics, said: Sequence[Sentence], folder: Path) -> list[Path]:
    """Draw the most urgent trends, and those that moved most if few changes were found."""
    files = list[Path]()
    shown = {(s.robot, s.name): s.text for s in said if s.robot}
    moved = [
        (-abs(_change(f, i)) / f.log.constant.jump, robot, name)
        for name, f in found.fitted.items()
        for i, robot in enumerate(f.log.robots)
        if len(f.trends[i].level) > 1
    ]
    for _, robot, name in sorted(moved)[:LEAST_TRENDS]:
        shown.setdefault((robot, name), f"{robot}, {CONSTANTS[name].label}: no change is sure.")
    for (robot, name), text in list(shown.items())[:TRENDS]:
        events = [e for e in found.found if (e.robot, e.name) == (robot, name)]
        files.append(folder / f"trend_{len(files)}.png")
        trend(files[-1], found.fitted[name], robot, events)
        page.picture(files[-1], f"{text} {TREND}")
    return files


def _groups(page: Page, found: Statistics) -> None:
    """Add the table that compares places and batches."""
    every = [(o, f) for f in found.fitted.values() for o in f.offsets if o.kind != "robot"]
    rows, standing_out = [], found.standing_out
    for o, f in sorted(every, key=lambda one: one[0].p)[:URGENT]:
        c = f.log.constant
        size = f"{c.factor * o.size:+.2f} ± {c.factor * o.sigma:.2f} {c.unit}"
        rows.append((o.kind, o.who, c.label, size, f"{o.p:.2g}", "yes" if o in standing_out else ""))
    if rows:
        page.heading("Places and batches")
        page.table(("", "which", "constant", "off the others", "p", "stands out"), rows, text_columns=(1, 2, 3))
