"""The distances of all effects as pictures, a page and a short table."""

from collections.abc import Sequence
from pathlib import Path
from textwrap import fill
from typing import Any, Final

import numpy as np
from matplotlib.colors import BoundaryNorm, ListedColormap

from drd.arrays import Array
from drd.commands import writing
from drd_tools.report.page import Page
from drd_tools.report.style import GREY, INK, ORANGE, SKY, VERMILION, picture
from drd_tools.report.terminal import columns
from drd_tools.trial.distance import ALIKE, ceiling
from drd_tools.trial.distances import MINUTES, SIZE, Distances, Pair
from drd_tools.trial.figures import Cells

PAGE: Final = "distances.html"
SHOWN: Final = 20  # pairs in the short table
# Edges of the classes: at d = 1, 2 and 4 the best method errs in one of three, one of six and one of forty drives.
EDGES: Final = (0.0, 1.0, 2.0, ALIKE, 8.0, 1e9)
COLOURS: Final = ("#7A2E00", VERMILION, ORANGE, "#DCEFFA", "#FFFFFF")
UNSEEN: Final = "#D8D8D8"
TITLE_LETTERS: Final = 90  # per line: the width of the picture
HEADER: Final = ("pair", "", "ceiling", "farthest d", "in", "nearest d", "in")
MANOEUVRES_HEADER: Final = ("", "manoeuvre", f"pairs with d below {ALIKE:g}", "effects not seen")


def write_page(distances: Distances, folder: Path) -> list[Path]:
    """Write the figures, a heat map of each manoeuvre and of the best per pair, and the page. Raises ConfigError."""
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        files = distances.write(folder)
        page = Page("Distances of all effects", lead(distances))
        page.heading("The closest pairs")
        page.table(HEADER, [_cells(distances, p) for p in distances.pairs()[:SHOWN]], TABLE, text_columns=(1,))
        page.table(MANOEUVRES_HEADER, _manoeuvres(distances), text_columns=(1,))
        numbered = [(f"{k}. {m}", distances.matrix(m)) for k, m in enumerate(distances.manoeuvres, 1)]
        for k, (title, matrix) in enumerate(
            [("Each pair in the manoeuvre that tells it best", distances.best()), *numbered]
        ):
            files.append(folder / f"distances_{k}.png")
            _draw(files[-1], title, distances.names, matrix)
            page.heading(title)
            page.picture(files[-1], CAPTION)
        page.save(folder / PAGE)
    return [*files, folder / PAGE]


TABLE: Final = (
    "The ceiling of telling them in the best manoeuvre, and their distance, of the nearer way round, in the best and "
    "in the worst."
)
CAPTION: Final = (
    f"Row: the effect that is there, seen with d = {SIZE:g} (what destroys readings: or larger). Column: "
    "what is fitted in its place, with all its parameters. Colour: the whitened distance that is left; numbers: "
    f"look-alikes, d below {ALIKE:g}. Grey rows: not seen at a plausible size."
)


def lead(distances: Distances) -> list[str]:
    """Summarise the matrices in a sentence or two."""
    pairs = distances.pairs()
    never = sum(p.farthest < ALIKE for p in pairs)
    return [
        f"{len(distances.manoeuvres)} manoeuvres of {MINUTES} minutes, {len(distances.names)} effects: of {len(pairs)} "
        f"pairs {never} look alike (d below {ALIKE:g}) in every manoeuvre that shows them.",
        f"At d = {ALIKE:g} the best method names the right one of two in {100.0 * ceiling([ALIKE]):.1f} % of the "
        f"drives; at 1 in {100.0 * ceiling([1.0]):.0f} %.",
    ]


def text(distances: Distances) -> str:
    """Text for the terminal: the closest pairs, and the number of look-alikes in each manoeuvre."""
    pairs = distances.pairs()
    shown = [_cells(distances, p) for p in pairs[:SHOWN]]
    return "\n".join(
        [
            *lead(distances),
            "",
            *columns([MANOEUVRES_HEADER, *_manoeuvres(distances)], text=(1,)),
            "",
            f"The {len(shown)} closest pairs of {len(pairs)}, in the manoeuvre that sets them farthest apart:",
            *columns([HEADER, *shown], text=(0, 1)),
        ]
    )


def _manoeuvres(distances: Distances) -> list[Cells]:
    return [
        [str(k), m, str(distances.alike(m)), str(len(distances.unseen(m)))]
        for k, m in enumerate(distances.manoeuvres, 1)
    ]


def _cells(distances: Distances, pair: Pair) -> Cells:
    def at(manoeuvre: str) -> Cells:
        return [f"{pair.by_manoeuvre[manoeuvre]:.2f}", str(distances.manoeuvres.index(manoeuvre) + 1)]

    return [*pair.names, f"{ceiling([pair.farthest]):.2f}", *at(pair.best), *at(pair.worst)]


def _draw(file: Path, title: str, names: Sequence[str], matrix: Array) -> None:
    """Draw a heat map with the distances of look-alikes as numbers."""
    with picture(file, 12.0, 10.5) as figure:
        axes: Any = figure.subplots()
        colours = ListedColormap(COLOURS).with_extremes(bad=UNSEEN)
        image = axes.imshow(np.ma.masked_invalid(matrix), cmap=colours, norm=BoundaryNorm(EDGES, len(COLOURS)))
        for i, k in zip(*np.nonzero(matrix < ALIKE), strict=True):
            ink = "white" if matrix[i, k] < EDGES[2] else INK
            axes.text(k, i, f"{matrix[i, k]:.1f}", ha="center", va="center", fontsize=6.5, color=ink)
        at = np.arange(len(names))
        axes.set_xticks(at, names, rotation=90, fontsize=8)
        axes.set_yticks(at, names, fontsize=8)
        axes.set_xticks(at[1:] - 0.5, minor=True)
        axes.set_yticks(at[1:] - 0.5, minor=True)
        axes.grid(which="minor", color=SKY, linewidth=0.3)
        axes.tick_params(which="minor", length=0)
        axes.set_title(fill(f"Distance in {MINUTES} minutes: {title}", TITLE_LETTERS))
        axes.set_xlabel("fitted in its place")
        axes.set_ylabel("what is there")
        bar = figure.colorbar(image, ax=axes, shrink=0.4, spacing="uniform", ticks=EDGES[:-1])
        bar.ax.set_yticklabels([f"{edge:g}" for edge in EDGES[:-1]])
        bar.set_label("whitened distance d", color=GREY)
