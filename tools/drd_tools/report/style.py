"""One look for all pictures: colours, fonts, grids."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final

import matplotlib as mpl
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

# Okabe and Ito (2008): told apart by all readers, and in grey by their lightness.
BLUE: Final = "#0072B2"
SKY: Final = "#56B4E9"
GREEN: Final = "#009E73"
ORANGE: Final = "#E69F00"
VERMILION: Final = "#D55E00"
PURPLE: Final = "#CC79A7"
SERIES: Final = (BLUE, VERMILION, GREEN, ORANGE, SKY, PURPLE)
INK: Final = "#222222"
GREY: Final = "#808080"
TRUE_GREY: Final = "#B4B4B4"
GRID: Final = "#E6E6E6"
BOUND: Final = "#DCEFFA"

DPI: Final = 150
STYLE: Final[Any] = {
    "font.size": 11.0,
    "font.family": "DejaVu Sans",  # comes with matplotlib
    "text.color": INK,
    "axes.edgecolor": GREY,
    "axes.titlelocation": "left",
    "axes.titlesize": 11,
    "axes.titleweight": "bold",
    "axes.titlepad": 10,
    "xtick.color": GREY,
    "ytick.color": GREY,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "legend.frameon": False,
    "legend.fontsize": 10,
}


@contextmanager
def styled() -> Iterator[None]:
    """The project's look, for figures that are made and saved inside."""
    with mpl.rc_context(STYLE):
        yield


def make_figure(width_in: float = 10.0, height_in: float = 4.5) -> Figure:
    """An empty figure that lays its panels out by itself. Call it, and save, inside `styled()`."""
    return Figure(figsize=(width_in, height_in), dpi=DPI, facecolor="white", layout="constrained")


def tidy(axes: Any, title: str, ticks: int = 8) -> None:
    """Title, grid, two spines and round ticks."""
    axes.set_title(title)
    axes.grid(color=GRID, linewidth=0.8)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    for axis in (axes.xaxis, axes.yaxis):
        if axis.get_scale() == "linear":
            axis.set_major_locator(MaxNLocator(ticks, steps=[1, 2, 5, 10]))
