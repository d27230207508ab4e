"""Results of `drd explain`: computed once, saved as JSON, then reported and drawn any number of times."""

from dataclasses import dataclass
from typing import ClassVar

from drd_tools.limit.limit import Limit
from drd_tools.report.saved import Saved


@dataclass(frozen=True)
class Line:
    """Standard deviations at the end due to one cause, in the robot's axes there, and its shares of the variance.

    `position_m` is the root of the sum of both variances. `part` is empty for a whole group.
    """

    group: str
    part: str
    along_m: float
    across_m: float
    position_m: float
    heading_deg: float
    position_share: float
    heading_share: float


@dataclass(frozen=True)
class Delay:
    """Error that a gyro late by `delay_s` would cause, to first order: at the end, and the largest on the way."""

    delay_s: float
    along_m: float
    across_m: float
    heading_deg: float
    largest_m: float
    largest_deg: float


@dataclass(frozen=True)
class Part:
    """Most likely part of one group in the actual error at the end, with its standard deviation.

    `position_m` is the component along the position error; these sum to its length, and the heading's to its error.
    """

    group: str
    position_m: float
    position_sigma_m: float
    heading_deg: float
    heading_sigma_deg: float


@dataclass(frozen=True)
class Actual:
    """Actual error at the end against a reference, and its probability by the budget.

    `sigma_m` and `sigma_deg`: standard deviations by the budget and the reference's own noise, as in `Line`. `p`:
    probability of an error as large by the budget; `course_p`: the same for the errors at `poses` times on the way.
    `lag_taken_s`, `lag_left_s`: as in `evaluate.results.Run`.
    """

    reference: str
    reference_sha256: str
    reference_sigma_m: float
    reference_sigma_deg: float
    along_m: float
    across_m: float
    heading_deg: float
    sigma_m: float
    sigma_deg: float
    p: float
    poses: int
    course_p: float
    parts: list[Part]
    inseparable: list[list[str]]
    time_s: list[float]
    error_m: list[float]
    error_deg: list[float]
    lag_taken_s: float = 0.0
    lag_left_s: float | None = 0.0


@dataclass(frozen=True)
class Explanation(Saved):
    """Error budget over an interval. Series are variances, a row for each drawn time and a column for each group."""

    FORMAT: ClassVar = "drd-explanation/1"
    COMMAND: ClassVar = "drd explain"

    recording: str
    sha256: dict[str, str]
    digest: str
    counts_from: str
    from_s: float
    to_s: float
    way_m: float
    groups: list[Line]
    causes: list[Line]
    total: Line
    delay: Delay | None
    actual: Actual | None
    notes: list[str]
    time_s: list[float]
    way_series_m: list[float]
    position_m2: list[list[float]]
    heading_deg2: list[list[float]]
    limit: Limit | None = None  # of the whole recording

    def __post_init__(self) -> None:
        shape = {len(row) for rows in (self.position_m2, self.heading_deg2) for row in rows}
        if shape != {len(self.groups)} or not len(self.position_m2) == len(self.heading_deg2) == len(self.time_s):
            raise ValueError("series of other lengths")
