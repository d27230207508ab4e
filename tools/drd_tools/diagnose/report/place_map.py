"""The map of a mismatch that depends on the place."""

import math
from typing import Any, Final

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize

from drd_tools.diagnose.series import Line, Mismatch
from drd_tools.report.style import GREY, INK, MAP, tidy

FULL_SIGMAS: Final = 2.0  # beyond which a colour has full strength
LEAST_M: Final = 0.01  # side of a cell if a drive has no width


def place_map(figure: Any, axes: Any, curve: Mismatch, path: Line | None, label: str) -> None:
    """Draw the values at the knots of a square grid, with the model's bilinear interpolation, and the path on top."""
    side = math.isqrt(len(curve.x))
    value, sigma = (v.reshape(side, side).T for v in (curve.mismatch, curve.sigma))
    value, sigma = np.nan_to_num(value), np.maximum(np.nan_to_num(sigma), 1e-12)
    strength = np.minimum(np.abs(value) / (FULL_SIGMAS * sigma), 1.0)
    largest = float(np.max(np.abs(value)[strength == 1.0], initial=0.0)) or 1.0
    norm = Normalize(-largest, largest)
    colors = 1.0 - strength[..., np.newaxis] * (1.0 - MAP(norm(value))[..., :3])
    edges = []
    for v in (curve.x, curve.y):
        half = 0.5 * max(float(np.ptp(v)) / (side - 1), LEAST_M)
        edges += [float(v.min()) - half, float(v.max()) + half]
    axes.imshow(colors, origin="lower", extent=edges, interpolation="bilinear", aspect="auto")
    if path is not None:
        axes.plot(path.x_m, path.y_m, color=GREY, linewidth=1.2)
    for x, y, v, s in zip(curve.x, curve.y, curve.mismatch, curve.sigma, strict=True):
        text = f"{v:+.2g}\n± {s:.2g}".replace("-", "\N{MINUS SIGN}")
        axes.text(x, y, text, fontsize=7.5, ha="center", va="center", color=INK)
    axes.set_xlabel("x / m")
    axes.set_ylabel("y / m")
    tidy(axes, f"{curve.channel.capitalize()}: mismatch by place", 6)
    axes.grid(visible=False)
    bar = figure.colorbar(ScalarMappable(norm, MAP), ax=axes, label=label)
    bar.outline.set_visible(False)
