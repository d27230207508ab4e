"""What `drd explain` keeps: computed once, saved as JSON, reported and drawn as often as wanted."""

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from drd_tools.limit.limit import Change, Limit, Share
from drd_tools.report.saved import load, save

FORMAT: Final = "drd-explanation/1"


@dataclass(frozen=True)
class Line:
    """Standard deviations at the end that one cause brings, in the robot's axes there, and its shares of the variance.

    `position_m` is the root of both variances' sum. `part` is empty for a whole group.
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
    """What a gyro that is late by `delay_s` would do, to first order: at the end, and at most on the way."""

    delay_s: float
    along_m: float
    across_m: float
    heading_deg: float
    largest_m: float
    largest_deg: float


@dataclass(frozen=True)
class Part:
    """Most likely part of one group in the actual error at the end, with its standard deviation.

    `position_m` counts in the direction of the position's error; the parts add up to its length, and those of the
    heading to its error.
    """

    group: str
    position_m: float
    position_sigma_m: float
    heading_deg: float
    heading_sigma_deg: float


@dataclass(frozen=True)
class Actual:
    """The actual error at the end against a reference, and what the budget says to it.

    `sigma_m` and `sigma_deg` are what the budget and the reference's own noise claim together, as in `Line`. `p`: how
    likely an error as large is by the budget; `course_p` the same for the errors at `poses` times on the way.
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


@dataclass(frozen=True)
class Explanation:
    """An error budget over a stretch. Series have a row for each drawn time and a column for each group, variances."""

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

    def save(self, folder: Path) -> None:
        """Write results.json. Raises OSError."""
        save(folder, FORMAT, dataclasses.asdict(self))

    @staticmethod
    def load(folder: Path) -> "Explanation":
        """Read results.json. Raises ConfigError."""
        return load(folder, FORMAT, "drd explain", _revived)


def _revived(content: dict[str, Any]) -> Explanation:
    for name in ("groups", "causes"):
        content[name] = [Line(**line) for line in content[name]]
    content["total"] = Line(**content["total"])
    content["delay"] = None if content["delay"] is None else Delay(**content["delay"])
    if (actual := content["actual"]) is not None:
        actual["parts"] = [Part(**part) for part in actual["parts"]]
        content["actual"] = Actual(**actual)
    if (limit := content.get("limit")) is not None:
        limit["by_cause"] = [Share(**share) for share in limit["by_cause"]]
        limit["changes"] = [Change(**change) for change in limit["changes"]]
        content["limit"] = Limit(**limit)
    explanation = Explanation(**content)
    shape = {len(row) for rows in (explanation.position_m2, explanation.heading_deg2) for row in rows}
    lengths = {len(explanation.position_m2), len(explanation.heading_deg2), len(explanation.time_s)}
    if shape != {len(explanation.groups)} or len(lengths) != 1:
        raise ValueError("series of other lengths")
    return explanation
