"""Results of `drd compare`: computed once, saved as JSON, then reported and drawn any number of times."""

from dataclasses import dataclass
from typing import Any, ClassVar

from msgspec import Struct, field

from drd_tools.report.saved import Saved


@dataclass(frozen=True)
class CovariateResult:
    """Dependence of a channel's mismatch on a covariate.

    `share`, `p`, `left` and `as_good` as in `shares.Share`. `knots` and the curve's values there (deg/s or m/s), their
    sigmas by the scatter and by noise alone; knots of the place are [x_m, y_m].
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
    """One channel: block means in deg/s or m/s, sums in deg or m, each with its sigma by noise alone.

    `rms` of the block means and its `expected` value; `ratio`: their rms in sigmas, allowing for correlation.
    `independent`: effective number of independent blocks for the size of the noise. `verdict`: nothing, driver (then
    `named` has the best covariates, the best one first) or more (than noise, and no covariate predicts it).
    `reference`: errors of the reference fitted to this channel and subtracted, as name, value, sigma and unit.
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
        """Result for one covariate."""
        return next(d for d in self.covariates if d.name == name)


@dataclass(frozen=True)
class Comparison(Saved):
    """All channels, the one that most exceeds noise first. Blocks have a middle time, a duration and a place."""

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
