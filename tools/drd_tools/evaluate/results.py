"""Results of `drd evaluate`: computed once, saved as JSON, then reported, compared and drawn any number of times."""

from dataclasses import dataclass
from typing import Annotated, ClassVar

from msgspec import Meta

from drd.arrays import Array
from drd_tools.evaluate.alignment import Alignment
from drd_tools.evaluate.consistency import Consistency
from drd_tools.evaluate.growth import Windows
from drd_tools.evaluate.heading import HeadingDrift
from drd_tools.evaluate.metrics import Absolute, Drift, EndError, Relative
from drd_tools.limit.limit import Limit
from drd_tools.report.saved import Saved


@dataclass(frozen=True)
class Series:
    """Series for the pictures, at most 2000 rows: `time_s` (n,), `estimate` (as aligned) and `reference` (n, 2), m.

    `error` (n, 3) along and across the reference's track, m, and of the heading, deg; `sigma` (n, 3): its claimed
    standard deviations, including the reference's own noise.
    """

    time_s: Array
    estimate_m: Array
    reference_m: Array
    error: Array
    sigma: Array | None


@dataclass(frozen=True)
class Run:
    """One estimate evaluated against one reference.

    `lag_taken_s`: by how much the reference's times were shifted earlier; `lag_left_s`: by how much it still clearly
    lags the poses; None if a lag was to be estimated and too few rows allowed it.
    """

    name: str
    reference: str
    poses_sha256: str
    reference_sha256: str
    position_sigma_m: float
    heading_sigma_deg: float
    alignment: Alignment
    rows: int
    outside: int
    in_gaps: int
    max_gap_s: float
    duration_s: float
    path_m: float
    is_dense: bool
    end: EndError
    absolute: Absolute
    drift: Drift | None
    by_length: list[Relative]
    by_time: list[Relative]
    heading: HeadingDrift
    consistency: Consistency
    windows: Windows
    series: Series
    limit: Limit | None = None  # of the recording, if known
    lag_taken_s: float = 0.0
    lag_left_s: float | None = 0.0


@dataclass(frozen=True)
class Evaluation(Saved):
    """All runs of one evaluation."""

    FORMAT: ClassVar = "drd-evaluation/1"
    COMMAND: ClassVar = "drd evaluate"

    runs: Annotated[list[Run], Meta(min_length=1)]
