"""What the virtual machine found, for people."""

from typing import Any

import pytest
from vm.guest import CHECKS

VERDICTS = pytest.StashKey[dict[str, dict[str, Any]]]()
KERNEL = pytest.StashKey[str]()
LATE_S = pytest.StashKey[list[float]]()
SEEN_CHARACTERS = 100


def lines(verdicts: dict[str, dict[str, Any]]) -> list[str]:
    """A table with a line for each check; times in s, the limit of each behind it."""
    width = max(map(len, CHECKS))
    table = [
        f"{'':{width}}  {'noticed':>14} {'well again':>14}  seen",
        f"{'':{width}}  {'s (limit)':>14} {'s (limit)':>14}",
    ]
    for name, check in CHECKS.items():
        verdict = verdicts.get(name, {"ok": False, "evidence": "did not run", "noticed_s": None, "recovered_s": None})
        noticed = cell(verdict["noticed_s"], check.notice_s)
        well = cell(verdict["recovered_s"], check.recover_s)
        seen = verdict["evidence"] if verdict["ok"] else "FAILED"
        short = seen if len(seen) <= SEEN_CHARACTERS else seen[: SEEN_CHARACTERS - 3] + "..."
        table.append(f"{name.replace('_', ' '):{width}}  {noticed:>14} {well:>14}  {short}")
    return table


def cell(time_s: float | None, limit_s: float | None) -> str:
    """A time with its limit."""
    return "" if time_s is None or limit_s is None else f"{time_s:.2f} ({limit_s:g})"
