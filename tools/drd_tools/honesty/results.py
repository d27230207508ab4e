"""Results of `make honesty`: the figures of each drive, as JSON."""

import dataclasses
from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np

from drd_tools.honesty.figures import Figures
from drd_tools.report.saved import Saved


@dataclasses.dataclass(frozen=True)
class Judged:
    """One drive: `world` is "real" or "simulated", `group` the row of the table to which it belongs.

    `figures` by configuration or baseline; `nees` of the pose at the end, by configuration.
    """

    world: str
    group: str
    drive: str
    figures: dict[str, Figures]
    nees: dict[str, float] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True)
class Results(Saved):
    """All drives of a run. `seeds`: number per scenario; `notes`: what is missing, and why."""

    FORMAT: ClassVar = "drd-honesty/1"
    COMMAND: ClassVar = "make honesty"

    seeds: int
    judged: list[Judged]
    notes: list[str] = dataclasses.field(default_factory=list)

    def groups(self, world: str) -> dict[str, list[Judged]]:
        """Drives of a world by group, in order of their appearance."""
        found: dict[str, list[Judged]] = {}
        for one in self.judged:
            if one.world == world:
                found.setdefault(one.group, []).append(one)
        return found


def together(figures: Sequence[Figures], world: str) -> Figures:
    """Combine several drives to one row of the table.

    Simulated: root mean squares over the seeds, since in a single one luck decides between nearly equal estimators.
    Real: medians, since one faulty drive would hide all others. Shares are means over the drives.
    """
    middle = np.median if world == "real" else _rms

    def over(name: str, mean: Any) -> float | None:
        values = [value for one in figures if (value := getattr(one, name)) is not None]
        return float(mean(values)) if values else None

    position_m, heading_deg = over("position_rms_m", middle), over("heading_rms_deg", middle)
    assert position_m is not None
    assert heading_deg is not None
    return Figures(
        position_m,
        heading_deg,
        over("drift_percent", np.median),
        over("inside", np.mean),
        over("bound_m", np.median),
        over("bound_ratio", np.median),
        over("valid", np.mean),
        over("lag_s", np.median) or 0.0,
    )


def _rms(values: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
