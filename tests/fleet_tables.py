"""Tables of a fleet's constants for tests: robots that drive once a day, and what happens to them."""

from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np

BEGIN = datetime(2026, 3, 1, 8, 0, tzinfo=UTC)
Happens = Callable[[int, int, str, str], float]  # robot, day, place, batch -> what it adds


def made_table(
    robots: int,
    days: int,
    seed: int,
    happens: Happens = lambda *_: 0.0,
    name: str = "radius_left",
    sigma: float = 4e-4,
    spread: float = 3e-3,
    places: int = 2,
    batches: int = 2,
) -> dict[str, list[Any]]:
    """A constant of robots "1", "2", ... that drive in all places in turn; robot r's batch is r modulo `batches`."""
    random = np.random.default_rng(seed)
    rows = []
    for robot in range(1, robots + 1):
        base, batch = spread * random.standard_normal(), f"b{robot % batches}"
        for day in range(days):
            place = f"p{(day + robot) % places}"
            value = base + happens(robot, day, place, batch) + sigma * random.standard_normal()
            start = BEGIN + timedelta(days=day)
            rows.append((f"{robot}_{day}", str(robot), place, batch, start, 120.0, name, value, sigma))
    columns = ("recording", "robot", "place", "batch", "start_utc", "duration_s", "name", "value", "sigma")
    return {c: [row[i] for row in rows] for i, c in enumerate(columns)}


def day(number: int) -> datetime:
    """The start of a day of the table."""
    return BEGIN.replace(hour=0) + timedelta(days=number)
