"""What `drd compare` keeps: computed once, saved as JSON, reported and drawn as often as wanted."""

from dataclasses import dataclass
from typing import Any, ClassVar

from msgspec import Struct, field

from drd_tools.report.saved import Saved


@dataclass(frozen=True)
class CovariateResult:
    """How a channel's mismatch goes with a covariate.

    `share`, `p`, `left` and `as_good` as in `shares.Share`. `knots` and the curve's values there (deg/s or m/s), their
    sigmas by the scatter and by noise alone; of the place the knots are [x_m, y_m].
    """

    name: str
    unit: str
    share: float
    p: float
    left: float
    as_good: bool
    knots: list[Any]
    value: list[float]
    sigma: list[float]
    noise_sigma: list[float]


class ChannelResult(Struct, frozen=True):
    """One channel: block means in deg/s or m/s, sums in deg or m, each with what noise alone would make of it.

    `rms` of the block means and what is expected of it; `ratio`: their rms in sigmas, correlation accounted for.
    `independent`: as many independent blocks would tell as much of the noise's size. `verdict`: nothing, driver (then
    `named` holds the best covariates, the first one the best) or more (than noise, and no covariate predicts it).
    `reference`: errors of the reference that were fitted to this channel and taken off, as name, value, sigma and unit.
    """

    id: str
    title: str
    text: str
    unit: str
    rms: float
    expected: float
    ratio: float
    independent: float
    mean: float
    mean_sigma: float
    end: float
    end_sigma: float
    verdict: str
    named: list[str]
    reference: list[list[Any]]
    covariates: list[CovariateResult] = field(name="drivers")
    block_mean: list[float]
    block_sigma: list[float]
    sum: list[float]
    sum_sigma: list[float]

    def covariate(self, name: str) -> CovariateResult:
        """One of its covariates."""
        return next(d for d in self.covariates if d.name == name)


@dataclass(frozen=True)
class Comparison(Saved):
    """All channels, the one furthest beyond noise first. Blocks have a middle time, a duration and a place."""

    FORMAT: ClassVar = "drd-comparison/1"
    COMMAND: ClassVar = "drd compare"

    recording: str
    sha256: dict[str, str]
    path: str
    bias: str
    noise: list[list[str]]
    notes: list[str]
    duration_s: float
    way_m: float
    turn_deg: float
    block_s: float
    time_s: list[float]
    length_s: list[float]
    x_m: list[float]
    y_m: list[float]
    channels: list[ChannelResult]

    def __post_init__(self) -> None:
        series = [self.length_s, self.x_m, self.y_m]
        series += [s for c in self.channels for s in (c.block_mean, c.block_sigma, c.sum, c.sum_sigma)]
        if {len(s) for s in series} != {len(self.time_s)}:
            raise ValueError("series of other lengths")
