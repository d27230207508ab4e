"""The content of series.json, as classes: the series that the report draws."""

import math
from typing import Final, Literal

import numpy as np
from msgspec import Struct, field

from drd.arrays import Array
from drd_tools.diagnose.results import Figures


def _alike(series: Struct, *names: str) -> None:
    """Check that series drawn against each other have the same length. Raises ValueError."""
    sizes = [len(getattr(series, name)) for name in names]
    if len(set(sizes)) > 1:
        raise ValueError(f"{', '.join(names)} of one length; {', '.join(map(str, sizes))}")


class Line(Struct, frozen=True, eq=False):
    """A path's poses, thinned."""

    time_s: Array
    x_m: Array
    y_m: Array

    def __post_init__(self) -> None:
        _alike(self, "time_s", "x_m", "y_m")


class Paths(Struct, frozen=True):
    """Paths to be drawn; None if there is none."""

    reference: Line | None
    nominal: Line
    corrected: Line | None


class Drive(Struct, frozen=True):
    """Path and length of one recording."""

    name: str
    duration_s: float
    path_m: float
    path: Paths


class Mismatch(Struct, frozen=True, eq=False):
    """The error of a channel against its covariate, with sigmas, and the fitted effect with its 95 % band.

    If the covariate is the place: `x` and `y` (m) of the knots of a square grid, column by column.
    """

    covariate: str = field(name="driver")
    covariate_unit: str = field(name="driver_unit")
    error_unit: str
    channel: str
    x: Array
    mismatch: Array
    sigma: Array
    fit_x: Array
    fit: Array
    low: Array
    high: Array
    y: Array = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        _alike(self, "x", "mismatch", "sigma", *(("y",) if len(self.y) else ()))
        if len(self.y) and (len(self.y) < 4 or math.isqrt(len(self.y)) ** 2 != len(self.y)):
            raise ValueError(f"y of a square grid; {len(self.y)} values")
        _alike(self, "fit_x", "fit", "low", "high")


class Gain(Struct, frozen=True, eq=False):
    """Cumulative evidence for a finding over time."""

    time_s: Array
    nats: Array

    def __post_init__(self) -> None:
        _alike(self, "time_s", "nats")


NO_GAIN: Final = Gain(np.zeros(0), np.zeros(0))


class Course(Struct, frozen=True):
    """Series to be drawn for a finding."""

    effect: str
    curve: Mismatch | None = None
    evidence: Gain = NO_GAIN


class Residual(Struct, frozen=True, eq=False):
    """Rms of the whitened data per block, without and with the effects."""

    time_s: Array
    before: Array
    after: Array

    def __post_init__(self) -> None:
        _alike(self, "time_s", "before", "after")


class Bar(Struct, frozen=True):
    """A figure of held-out data, without and with the model."""

    name: str
    quantity: str
    unit: str
    before: float | None
    after: float | None


class Spread(Struct, frozen=True, eq=False):
    """Size of a channel's noise relative to the stated one, block by block."""

    channel: str
    time_s: Array
    ratio: Array

    def __post_init__(self) -> None:
        _alike(self, "time_s", "ratio")


class Series(Struct, frozen=True, kw_only=True):
    """The content of series.json."""

    format: Literal["drd-diagnosis-series/1"] = "drd-diagnosis-series/1"
    recordings: list[Drive]
    findings: list[Course]
    residual: Residual
    held_out: list[Bar]
    noise: Figures
    scatter: list[Spread] = []
