"""The two files that the report is drawn from, read and checked: diagnosis.json and series.json."""

import json
from dataclasses import dataclass
from pathlib import Path
from types import NoneType
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from drd.schema import ConfigError

Array = npt.NDArray[np.float64]

VERDICTS: Final = ("nothing_missing", "explained", "partly_explained", "unknown")
STATUSES: Final = ("suspected", "supported", "confirmed")

# A form is a type, a tuple of the values allowed, a list of one form (any length), or a dictionary of forms: all its
# keys are required, others may stand beside them; the key "*" stands for any. `Maybe`: or null.
Form = Any


@dataclass(frozen=True)
class Maybe:
    """The form, or null, or what `plain` says."""

    form: Form
    plain: type = NoneType


class Window:
    """Two numbers."""


class Numbers:
    """A list of numbers; null is not-a-number. `read` makes it an array."""


SOME: Final = Maybe(float)
PATH: Final = {"time_s": Numbers, "x_m": Numbers, "y_m": Numbers}
BEFORE_AFTER: Final[Form] = {"before": {}, "after": {}}
FINDING: Final = {
    "effect": str,
    "status": STATUSES,
    "also_fits": [str],
    "acts_on": str,
    "parameters": {"*": Maybe({"value": Maybe(float), "std": Maybe(float), "unit": str}, str)},
    "windows": [Window],
    "driver": Maybe(str),
    "evidence": {"gain_nats": SOME, "family_wise_p": SOME, "e_value": SOME},
    "explains": SOME,
    "sentence": str,
}
DIAGNOSIS: Final = {
    "schema": (1,),
    "recording": object,
    "verdict": VERDICTS,
    "findings": [FINDING],
    "unexplained": {"share_of_residual": SOME, "end_error_m": SOME},
    "ruled_out": [{"effect": str, "because": str}],
    "detectable": {"*": {"smallest": SOME, "unit": str}},
    "classes": [[str]],
    "fit": {"train": BEFORE_AFTER, "held_out": BEFORE_AFTER},
    "next_drive": Maybe({"manoeuvre": str, "minutes": float, "separates": [[str]], "nats": SOME}),
}
CURVE: Final = {
    **dict.fromkeys(("driver", "driver_unit", "error_unit", "channel"), str),
    **dict.fromkeys(("x", "mismatch", "sigma", "fit_x", "fit", "low", "high"), Numbers),
}
SERIES: Final = {
    "format": ("drd-diagnosis-series/1",),
    "recordings": [
        {
            "name": str,
            "duration_s": float,
            "path_m": float,
            "path": {"reference": Maybe(PATH), "nominal": PATH, "corrected": Maybe(PATH)},
        }
    ],
    "findings": [{"effect": str, "curve": Maybe(CURVE), "evidence": {"time_s": Numbers, "nats": Numbers}}],
    "residual": {"time_s": Numbers, "before": Numbers, "after": Numbers},
    "held_out": [{"name": str, "quantity": str, "unit": str, "before": SOME, "after": SOME}],
    "noise": {"*": SOME},
}
WORDS: Final[dict[Any, str]] = {
    str: "a text",
    float: "a number",
    Numbers: "a list of numbers and nulls",
    Window: "two numbers",
    object: "a value",
}
# Lists that are drawn against each other.
TOGETHER: Final = (
    ("time_s", "x_m", "y_m"),
    ("x", "mismatch", "sigma"),
    ("fit_x", "fit", "low", "high"),
    ("time_s", "nats"),
    ("time_s", "before", "after"),
)


def read(folder: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """The diagnosis and its series, whose lists of numbers are arrays. Raises ConfigError."""
    diagnosis: dict[str, Any] = _read(folder / "diagnosis.json", DIAGNOSIS)
    series: dict[str, Any] = _read(folder / "series.json", SERIES)
    found = [finding["effect"] for finding in diagnosis["findings"]]
    drawn = [finding["effect"] for finding in series["findings"]]
    if found != drawn:
        expected = f"the findings of diagnosis.json ({', '.join(found) or 'none'})"
        raise ConfigError(str(folder / "series.json"), "findings", expected, ", ".join(drawn) or "none")
    if not series["recordings"]:
        raise ConfigError(str(folder / "series.json"), "recordings", "at least one", "none")
    return diagnosis, series


def _read(file: Path, form: Form) -> Any:
    try:
        value = json.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(str(file), "", "a readable file", str(error.strerror)) from error
    except (ValueError, RecursionError) as error:  # not UTF-8, or not JSON
        raise ConfigError(str(file), "", "JSON", f"an error: {error}") from error
    return _checked(value, form, "", str(file))


def _checked(value: Any, form: Form, path: str, file: str) -> Any:
    """The value, with arrays for lists of numbers."""
    if isinstance(form, Maybe):
        return value if isinstance(value, form.plain) else _checked(value, form.form, path, file)
    if isinstance(form, dict):
        return _checked_section(value, form, path, file)
    if isinstance(form, list) and isinstance(value, list):
        return [_checked(item, form[0], f"{path}[{k}]", file) for k, item in enumerate(value)]
    if form is Numbers and isinstance(value, list) and all(item is None or _is_number(item) for item in value):
        return np.array([np.nan if item is None else item for item in value], dtype=np.float64)
    if form is Window and isinstance(value, list) and len(value) == 2 and all(map(_is_number, value)):
        return value
    fits = (
        _is_number(value)
        if form is float
        else isinstance(value, form)
        if isinstance(form, type)
        else isinstance(form, tuple) and value in form
    )
    if fits:
        return value
    expected = "a list" if isinstance(form, list) else WORDS.get(form) or f"one of {', '.join(map(str, form))}"
    raise ConfigError(file, path, expected, _shown(value))


def _checked_section(value: Any, form: dict[str, Form], path: str, file: str) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise ConfigError(file, path, "a section of keys", _shown(value))
    forms = dict.fromkeys(value, form["*"]) if "*" in form else form
    for key in forms:
        if key not in value:
            raise ConfigError(file, _join(path, key), "a value (the key is required)", "nothing")
    made = value | {key: _checked(value[key], f, _join(path, key), file) for key, f in forms.items()}
    for names in TOGETHER:
        lists = [made.get(name) for name in names]
        sizes = [item.size for item in lists if isinstance(item, np.ndarray)]
        if len(sizes) == len(names) and len(set(sizes)) > 1:
            raise ConfigError(file, path, f"{', '.join(names)} of one length", ", ".join(map(str, sizes)))
    return made


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _shown(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 80 else text[:77] + "..."


def _join(path: str, key: str) -> str:
    return f"{path}.{key}" if path else key
