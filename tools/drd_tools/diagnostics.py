"""The daemon's health as ROS's diagnostics: a table of parts, each with a level, a sentence and its values."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

from drd.output.cdr import Diagnostic
from drd.samples import Validity

GOOD, WARNING, ERROR = 0, 1, 2
LEVELS: Final = {Validity.VALID.value: GOOD, Validity.INVALID.value: ERROR}  # the others: WARNING
# What a part of the health is nested in, at most.
DEPTH: Final = 4


def diagnostics(health: Mapping[str, Any]) -> list[Diagnostic]:
    """The pose first, then each part of the counters, then what was learned. Whatever the health holds is shown."""
    robot = str(health.get("robot", ""))
    validity = str(health.get("validity", ""))
    reasons = [r for r in _list(health.get("reasons")) if isinstance(r, Mapping)]
    said = "; ".join(f"{r.get('source')}: {r.get('text')}" for r in reasons)
    plain = {key: _text(v) for key, v in health.items() if not isinstance(v, Mapping | list | None)}
    found = [
        Diagnostic(
            LEVELS.get(validity, WARNING), "drd: pose", f"{validity}: {said}" if said else validity, robot, plain
        )
    ]
    for part, values in _mapping(health.get("counters")).items():
        why = "; ".join(str(r.get("text")) for r in reasons if str(r.get("source")).partition(".")[0] == part)
        found.append(Diagnostic(WARNING if why else GOOD, f"drd: {part}", why, robot, dict(_flat(values, ""))))
    for part in ("learned", "recording", "state"):
        if values := dict(_flat(health.get(part), "")):
            is_bad = values.get("state") == "degraded"
            found.append(Diagnostic(WARNING if is_bad else GOOD, f"drd: {part}", "", robot, values))
    return found


def _flat(value: Any, path: str, depth: int = DEPTH) -> Iterator[tuple[str, str]]:
    """Values by their path, as in `noise.sigma`."""
    if isinstance(value, Mapping) and depth:
        for name, part in value.items():
            yield from _flat(part, f"{path}.{name}" if path else str(name), depth - 1)
    elif path:
        yield path, _text(value)


def _text(value: Any) -> str:
    return "" if value is None else f"{value:.6g}" if isinstance(value, float) else str(value)


def _mapping(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, Mapping) else {}


def _list(value: Any) -> Sequence[Any]:
    return value if isinstance(value, list) else []
