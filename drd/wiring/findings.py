"""The results of a wiring check, and the user's statement of the robot's motion."""

from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum


class Outcome(Enum):
    """A check's result."""

    GOOD = "good"
    FAULT = "FAULT"
    UNKNOWN = "not determined"


@dataclass(frozen=True)
class Finding:
    """One check: its name, its outcome, the evidence in numbers, and what to do (empty: nothing)."""

    check: str
    outcome: Outcome
    text: str
    remedy: str = ""


@dataclass(frozen=True)
class Statement:
    """Stated by the user: drove 1 forward, -1 backward; turned 1 left, -1 right; 0: unknown. Distance straight, m."""

    drove: int = 0
    turned: int = 0
    distance_m: float | None = None


def good(check: str, text: str, remedy: str = "") -> Finding:
    """A check that found nothing wrong."""
    return Finding(check, Outcome.GOOD, text, remedy)


def fault(check: str, text: str, remedy: str) -> Finding:
    """A check that found a fault."""
    return Finding(check, Outcome.FAULT, text, remedy)


def unknown(check: str, text: str, remedy: str = "") -> Finding:
    """A check that the data do not decide; the remedy names a manoeuvre that would."""
    return Finding(check, Outcome.UNKNOWN, text, remedy)


def faults(findings: Iterable[Finding]) -> list[Finding]:
    """The findings that are faults."""
    return [finding for finding in findings if finding.outcome is Outcome.FAULT]
