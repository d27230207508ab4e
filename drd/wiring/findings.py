"""The results of a wiring check, and what the user says that the robot did."""

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
    """Said by the user: drove 1 forward, -1 backward; turned 1 left, -1 right; 0: not said. Distance straight, m."""

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
    """A check that the data cannot decide; the remedy says what manoeuvre would."""
    return Finding(check, Outcome.UNKNOWN, text, remedy)


def faults(findings: Iterable[Finding]) -> list[Finding]:
    """The findings that are faults."""
    return [finding for finding in findings if finding.outcome is Outcome.FAULT]
