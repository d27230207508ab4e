"""What `drd evaluate` keeps: computed once, saved as JSON, reported, compared and drawn as often as wanted."""

import dataclasses
import types
import typing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from drd_tools.evaluate.alignment import Alignment
from drd_tools.evaluate.consistency import Consistency
from drd_tools.evaluate.drivers import Windows
from drd_tools.evaluate.heading import HeadingDrift
from drd_tools.evaluate.metrics import Absolute, Drift, EndError, Relative
from drd_tools.limit.limit import Limit
from drd_tools.report.saved import load, save

Array = npt.NDArray[np.float64]

FORMAT: Final = "drd-evaluation/1"
SIGNIFICANT_DIGITS: Final = 7


@dataclass(frozen=True)
class Series:
    """For the pictures, at most 2000 rows: `time_s` (n,), `estimate` (as aligned) and `reference` (n, 2), m.

    `error` (n, 3) along and across the reference's track, m, and of the heading, deg; `sigma` (n, 3) what is claimed
    for it, the reference's own included.
    """

    time_s: Array
    estimate_m: Array
    reference_m: Array
    error: Array
    sigma: Array | None


@dataclass(frozen=True)
class Run:
    """One estimate judged against one reference."""

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
    limit: Limit | None = None  # of the recording, where it is known


@dataclass(frozen=True)
class Evaluation:
    """All runs of one evaluation."""

    runs: list[Run]

    def save(self, folder: Path) -> None:
        """Write results.json. Raises OSError."""
        save(folder, FORMAT, _plain(self))

    @staticmethod
    def load(folder: Path) -> "Evaluation":
        """Read results.json. Raises ConfigError."""
        return load(folder, FORMAT, "drd evaluate", _checked)


def _checked(content: dict[str, Any]) -> Evaluation:
    loaded: Evaluation = _revived(Evaluation, content)
    if not loaded.runs:
        raise ValueError("no run")
    return loaded


def _plain(value: Any) -> Any:
    if dataclasses.is_dataclass(value):
        return {field.name: _plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, np.ndarray):
        flat = [float(f"{v:.{SIGNIFICANT_DIGITS}g}") for v in value.ravel()]
        return flat if value.ndim == 1 else np.reshape(flat, value.shape).tolist()
    return [_plain(item) for item in value] if isinstance(value, list) else value


def _revived(kind: Any, value: Any) -> Any:
    """The inverse of `_plain`, by the dataclass's own type hints. Raises TypeError or ValueError."""
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if origin in (types.UnionType, typing.Union):
        return None if value is None else _revived(next(a for a in arguments if a is not type(None)), value)
    if origin is np.ndarray:
        return np.array(value, float)
    if origin is list:
        return [_revived(arguments[0], item) for item in value]
    if dataclasses.is_dataclass(kind):
        hints = typing.get_type_hints(kind)
        return typing.cast(Any, kind)(**{name: _revived(hints[name], item) for name, item in value.items()})
    if value is None or not isinstance(value, (kind, int) if kind is float else kind):
        raise TypeError(f"{value!r:.40} is not a {kind.__name__}")
    return kind(value)
