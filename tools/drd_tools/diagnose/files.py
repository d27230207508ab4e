"""diagnosis.json and series.json: the only place that converts between results and JSON."""

import json
import math
from pathlib import Path
from typing import Any, Final, TypeVar

import msgspec
import numpy as np

from drd.config.schema import ConfigError
from drd_tools.diagnose.results import Result, Status, Verdict
from drd_tools.diagnose.series import Series
from drd_tools.report.json_file import converted, read_json

T = TypeVar("T")

DIAGNOSIS: Final = "diagnosis.json"
SERIES: Final = "series.json"
WORDS: Final = {"verdict": ", ".join(Verdict), "status": ", ".join(Status), "speaks": "for, against, neither"}


def plain(value: object) -> Any:
    """Convert for JSON and YAML: choices among the parameters, null for non-finite numbers, no empty keys."""
    return _finite(msgspec.to_builtins(value, enc_hook=_built))


def _built(value: Any) -> Any:
    return value.tolist() if isinstance(value, (np.ndarray, np.generic)) else dict(value)


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        if "choices" in value:  # of an effect: files have all parameters in one section
            value = {**value, "parameters": {**value["choices"], **value["parameters"]}}
            empty = ("probabilities", "provenance") if "status" in value else ("seen", "provenance")
            value = {k: v for k, v in value.items() if k != "choices" and (v or k not in empty)}
        return {k: _finite(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def save(folder: Path, result: Result, series: Series) -> None:
    """Write both files. Raises OSError."""
    for name, content in ((DIAGNOSIS, result), (SERIES, series)):
        (folder / name).write_text(json.dumps(plain(content), indent=1, allow_nan=False), encoding="utf-8")


def load(folder: Path) -> tuple[Result, Series]:
    """Read both files. Raises ConfigError."""
    result, series = _read(folder / DIAGNOSIS, Result), _read(folder / SERIES, Series)
    found, drawn = ([f.effect for f in findings] for findings in (result.findings, series.findings))
    if found != drawn:
        expected = f"the findings of diagnosis.json ({', '.join(found) or 'none'})"
        raise ConfigError(str(folder / SERIES), "findings", expected, ", ".join(drawn) or "none")
    if not series.recordings:
        raise ConfigError(str(folder / SERIES), "recordings", "at least one", "none")
    return result, series


def _read(file: Path, form: type[T]) -> T:
    return converted(file, parted(read_json(file)), form, _array, WORDS)


def parted(value: Any) -> Any:
    """Separate an effect's choices from its numbers; null becomes NaN, unknown."""
    if isinstance(value, list):
        return [parted(v) for v in value]
    if not isinstance(value, dict):
        return value
    value = {k: parted(v) for k, v in value.items()}
    parameters = value.get("parameters")
    if isinstance(parameters, dict):
        value["choices"] = {k: v for k, v in parameters.items() if isinstance(v, str)}
        numbers = {k: v for k, v in parameters.items() if not isinstance(v, str) and v is not None}
        value["parameters"] = {
            k: {n: math.nan if x is None else x for n, x in v.items()} if isinstance(v, dict) else v
            for k, v in numbers.items()
        }
    return value


def _array(_: type, value: Any) -> Any:
    """Convert a list of numbers; null becomes NaN. Raises ValueError."""
    known = isinstance(value, list) and all(
        v is None or (isinstance(v, int | float) and not isinstance(v, bool)) for v in value
    )
    if not known:
        raise ValueError("a list of numbers and nulls")
    return np.array([math.nan if v is None else v for v in value], np.float64)
