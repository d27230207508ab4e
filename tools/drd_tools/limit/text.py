"""Bound as sentences and table rows, for the terminal and the page."""

from collections.abc import Iterator, Sequence
from typing import Final

from drd_tools.limit.limit import Limit

_SHARES_HEADER: Final = ("cause", "rms / m", "rms / deg", "end / m", "end / deg", "drift / %")
_CHANGES_HEADER: Final = ("if there were", "rms / m", "rms / deg", "drift / %")


def sentences(limit: Limit) -> Iterator[str]:
    """Sentences on the bound, and on what would lower it most."""
    yield (
        f"Limit (smallest error that any estimator could achieve on the whole recording, 1 sigma; {limit.basis}): "
        f"{limit.position_rms_m:.2g} m and {limit.heading_rms_deg:.2g} deg rms, {limit.end_m:.2g} m and "
        f"{limit.end_deg:.2g} deg at the end, drift {limit.drift_percent:.2g} %."
    )
    yield limit.advice


def tables(limit: Limit) -> Iterator[tuple[Sequence[str], list[list[str]], str]]:
    """Yield header, rows and caption: the bound by cause, largest first, then the total; and after each change."""
    causes = sorted(limit.by_cause, key=lambda s: -s.position_rms_m)
    rows = [(s.group, s.position_rms_m, s.heading_rms_deg, s.end_m, s.end_deg, s.drift_percent) for s in causes]
    whole = limit.position_rms_m, limit.heading_rms_deg, limit.end_m, limit.end_deg, limit.drift_percent
    cells = [[str(name), *(f"{v:.3g}" for v in figures)] for name, *figures in (*rows, ("all", *whole))]
    yield _SHARES_HEADER, cells, "Smallest error that any estimator could achieve here, by cause (1 sigma)"
    changes = [(c.what, c.position_rms_m, c.heading_rms_deg, c.drift_percent) for c in limit.changes]
    cells = [[name, *(f"{v:.3g}" for v in figures)] for name, *figures in changes]
    yield _CHANGES_HEADER, cells, "The same bound with one change"
