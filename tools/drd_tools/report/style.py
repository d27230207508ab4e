"""Common style of all pictures: colours, fonts, grids."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from drd.arrays import Array

# Okabe and Ito (2008): distinguishable by colour-blind readers, and in grey by lightness.
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
MAP: Final = LinearSegmentedColormap.from_list("mismatch", (BLUE, "#E4E4E4", VERMILION))

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
    """Apply the project's style to figures that are made and saved inside."""
    with mpl.rc_context(STYLE):
        yield


def make_figure(width_in: float = 10.0, height_in: float = 4.5) -> Figure:
    """Make an empty figure with automatic layout. Call it, and save, inside `styled()`."""
    return Figure(figsize=(width_in, height_in), dpi=DPI, facecolor="white", layout="constrained")


@contextmanager
def picture(file: Path, width_in: float = 10.0, height_in: float = 4.5) -> Iterator[Any]:
    """Provide a figure to draw on, saved as a PNG at the end. Raises OSError."""
    with styled():
        figure = make_figure(width_in, height_in)
        yield figure
        save(figure, file)


def save(figure: Figure, file: Path) -> None:
    """Write a PNG. Raises OSError. `savefig` would draw everything twice, with the same result."""
    canvas: Any = FigureCanvasAgg(figure)
    canvas.print_png(file)


def tidy(axes: Any, title: str, ticks: int = 8, *, x: str = "", y: str = "") -> None:
    """Set title, axis labels, grid, two spines and round ticks."""
    axes.set_title(title)
    if x:
        axes.set_xlabel(x)
    if y:
        axes.set_ylabel(y)
    axes.grid(color=GRID, linewidth=0.8)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    for axis in (axes.xaxis, axes.yaxis):
        if axis.get_scale() == "linear":
            axis.set_major_locator(MaxNLocator(ticks, steps=[1, 2, 5, 10]))


def tidy_map(axes: Any, title: str, ticks: int = 8) -> None:
    """Do the same for paths seen from above, with equal scales of x and y."""
    axes.set_aspect("equal", adjustable="datalim")
    tidy(axes, title, ticks, x="x / m", y="y / m")


def draw_path(axes: Any, x_m: Array, y_m: Array, title: str) -> None:
    """Draw a path seen from above, with its two ends; the view is a metre wide if the robot stays on the spot."""
    axes.plot(x_m, y_m, color=BLUE, linewidth=1.4)
    ring: Any = {"color": "none", "markeredgecolor": INK, "markeredgewidth": 1.6, "markersize": 13}
    axes.plot(x_m[0], y_m[0], "o", label="start", zorder=5, **ring)
    axes.plot(x_m[-1], y_m[-1], "o", color=INK, markersize=7, label="end", zorder=6)
    is_on_the_spot = max(np.ptp(x_m), np.ptp(y_m)) < 0.5
    axes.set_aspect("equal", adjustable="box" if is_on_the_spot else "datalim")
    axes.margins(0.08)
    if is_on_the_spot:
        axes.set_xlim(x_m.mean() - 0.5, x_m.mean() + 0.5)
        axes.set_ylim(y_m.mean() - 0.5, y_m.mean() + 0.5)
    axes.legend(loc="upper left", ncols=2, bbox_to_anchor=(0.0, -0.1))
    tidy(axes, title, x="x / m", y="y / m")


def legend_below(figure: Any, axes: Any, ncols: int) -> None:
    """Add one legend for all panels, taken from `axes`."""
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=ncols)


def short(name: str, letters: int = 44) -> str:
    """Shorten a name for a picture, keeping its end, which distinguishes runs."""
    return name if len(name) <= letters else "..." + name[3 - letters :]
