"""Which constants the estimator may take from the monitor: confirmed ones, until something contradicts them. (109)"""

from typing import Final

from drd.estimation.applied import BIAS, BOTH, LAG, LARGEST, RADII, TURN, Constant
from drd.monitor.constants import CHANGE_S
from drd.monitor.findings import Finding, Size
from drd.monitor.library import CHANGE, TRAVEL
from drd.monitor.library import TURN as TURN_COLUMN
from drd.monitor.monitor import Monitor
from drd.units import NS_PER_S, RAD_PER_DEG

# Effects that show each constant. A side that slips all the time rolls less far, as a smaller tyre does.
SHOWN_BY: Final = {
    RADII: frozenset({"wheel_radius_error", "tyre_deflation", "surface_slip"}),
    TURN: frozenset({"tread_error", "gyro_scale_error", "terrain_tread"}),
    BIAS: frozenset({"gyro_bias_step"}),
    LAG: frozenset({"encoder_latency", "encoder_lag", "gyro_latency", "gyro_lag"}),
}
COLUMN: Final = {RADII: TRAVEL, TURN: TURN_COLUMN, LAG: CHANGE}
SI: Final = {RADII: 1.0, TURN: 1.0, LAG: CHANGE_S}  # value of a column's unit
CONFIRMED_S: Final = 60.0  # after its naming: by then most wrong names have been retracted
SURE: Final = 0.95  # total probability of its names
DOUBTFUL: Final = 0.5  # below which it is restored: even odds
ANEW_SIGMAS: Final = 3.0  # a change beyond this is adopted again
STARTED_M: Final = 1.0  # travel after which a change came while driving: a tyre loses air or is loaded; none grows


class Applying:
    """Chooses constants from findings; `wanted`: constants by name, None: to be restored, absent: undecided.

    A constant that was restored once is not wanted again.
    """

    def __init__(self) -> None:
        self.wanted: dict[str, Constant | None] = {}

    def look(self, monitor: Monitor, findings: list[Finding]) -> None:
        """Update `wanted` after the monitor has advanced."""
        now_ns = (monitor.zero_ns or 0) + round(monitor.now_s * NS_PER_S)
        for name, effects in SHOWN_BY.items():
            shown = [f for f in findings if f.effect in effects and f.until_ns is None]
            sure = max((probability(f, effects) for f in shown), default=0.0)
            taken = self.wanted.get(name)
            if sure < DOUBTFUL:
                if taken is not None:
                    self.wanted[name] = None
                continue
            found = [f for f in shown if is_confirmed(f, effects, now_ns)]
            if name in self.wanted and taken is None:
                continue  # contradicted once: it is no constant
            if not found or (constant := measured(monitor, name, found[0])) is None:
                continue
            if taken is None or abs(constant.value - taken.value) > ANEW_SIGMAS * (taken.sigma + constant.sigma):
                self.wanted[name] = constant


def probability(finding: Finding, effects: frozenset[str]) -> float:
    """Total probability of all names that show the same constant."""
    return finding.probability + sum(p for name, p in finding.also_fits if name in effects)


def is_confirmed(finding: Finding, effects: frozenset[str], now_ns: int) -> bool:
    """Whether it has stood for some time, and hardly anything else can be the cause."""
    return probability(finding, effects) > SURE and now_ns - finding.named_ns > CONFIRMED_S * NS_PER_S


def measured(monitor: Monitor, name: str, finding: Finding) -> Constant | None:
    """The constant since the finding's onset; None if it is unknown or too large."""
    if name == BIAS:
        step = finding.parameters.get("b")
        if not isinstance(step, Size) or finding.effect not in SHOWN_BY[BIAS]:
            return None
        value, sigma = monitor.bias_rad_s + step.value * RAD_PER_DEG, step.std * RAD_PER_DEG
        return Constant(name, value, sigma) if abs(value) <= LARGEST[name] else None
    column, si = COLUMN[name], SI[name]
    known = monitor.constants(changed=column)
    if known is None:
        return None
    value, sigma = si * known.means[column], si * known.sigmas[column]
    began_with, left = si * monitor.began_with(column), BOTH
    if name == RADII and finding.since_m > STARTED_M:
        left = 1.0 if value < began_with else 0.0
    return Constant(name, value, sigma, left) if max(abs(value), sigma) <= LARGEST[name] else None
