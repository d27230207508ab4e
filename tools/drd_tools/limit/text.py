"""The bound as sentences and table rows, for the terminal and the page."""

from collections.abc import Iterator
from typing import Final

from drd_tools.limit.limit import Limit

SHARES_HEADER: Final = ("cause", "rms / m", "rms / deg", "end / m", "end / deg", "drift / %")
CHANGES_HEADER: Final = ("if there were", "rms / m", "rms / deg", "drift / %")
CAPTION: Final = "Smallest error that any estimator could have here, by cause (1 sigma)"
CHANGES_CAPTION: Final = "The same bound if one thing were otherwise"


def sentences(limit: Limit) -> Iterator[str]:
    """The bound, and what would lower it most."""
    yield (
        f"Limit (smallest error that any estimator could have on the whole recording, 1 sigma; {limit.basis}): "
        f"{limit.position_rms_m:.2g} m and {limit.heading_rms_deg:.2g} deg rms, {limit.end_m:.2g} m and "
        f"{limit.end_deg:.2g} deg at the end, drift {limit.drift_percent:.2g} %."
    )
    yield limit.advice


def share_rows(limit: Limit) -> list[list[str]]:
    """Of SHARES_HEADER, largest first, then the whole."""
    rows = [
        (s.group, s.position_rms_m, s.heading_rms_deg, s.end_m, s.end_deg, s.drift_percent)
        for s in sorted(limit.by_cause, key=lambda s: -s.position_rms_m)
    ]
    whole = limit.position_rms_m, limit.heading_rms_deg, limit.end_m, limit.end_deg, limit.drift_percent
    return [[str(name), *(f"{v:.3g}" for v in figures)] for name, *figures in (*rows, ("all", *whole))]


def change_rows(limit: Limit) -> list[list[str]]:
    """Of CHANGES_HEADER, the best first."""
    return [
        [c.what, f"{c.position_rms_m:.3g}", f"{c.heading_rms_deg:.3g}", f"{c.drift_percent:.3g}"] for c in limit.changes
    ]
