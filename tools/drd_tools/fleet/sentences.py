"""Statistics of a fleet as sentences, with what to inspect first."""

from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from itertools import groupby
from typing import Final, NamedTuple

from drd_tools.fleet.events import Event
from drd_tools.fleet.population import Step
from drd_tools.fleet.series import CONSTANTS, S_PER_DAY, Log
from drd_tools.fleet.statistics import Fitted, Offset, Statistics

BACK_SIGMAS: Final = 3.0  # from the first level, within which a constant is back
BACK_PART: Final = 0.25  # of the change, as well: a new tyre never equals the old one exactly
DECIMALS: Final = {"%": 1, "ms": 0, "deg/h/degC": 1}
# What to look at, and why it matters.
LOOK_AT: Final = {
    "radius_left": "pressure and wear of the left tyre; unequal wheels turn the path",
    "radius_right": "pressure and wear of the right tyre; unequal wheels turn the path",
    "tread": "tyres, load, and the ground it turns on; turns come out too large or too small",
    "lag_s": "the encoders' and the gyro's wiring and firmware; turns are seen late",
    "gyro_scale": "the gyro and its calibration; every turn is off by this part",
    "bias_per_c": "the gyro's calibration over temperature; the heading drifts as it warms up",
}


class Sentence(NamedTuple):
    """A sentence to report. `weight`: urgency; `robot`: "" for a place or batch; `is_over`: repaired."""

    text: str
    robot: str
    name: str
    weight: float
    is_over: bool = False

    @property
    def look_at(self) -> str:
        """Things to inspect."""
        return LOOK_AT[self.name]


def sentences(found: Statistics) -> list[Sentence]:
    """Sentences on all findings, the most urgent first."""
    events = sorted(found.found, key=lambda e: (e.robot, e.name, e.day))
    made = [_of_robot(list(chain)) for _, chain in groupby(events, key=lambda e: (e.robot, e.name))]
    made += [_of_group(f.log, step) for f in found.fitted.values() for step in f.population.steps]
    made += map(_apart, found.standing_out)
    return sorted(made, key=lambda s: -s.weight)


def _of_robot(chain: Sequence[Event]) -> Sentence:
    """Describe one robot's changes of one constant in a sentence."""
    first, last, constant = chain[0], chain[-1], CONSTANTS[chain[0].name]
    verb = "creeps by " if first.form == "creep" else ""
    text = f"{who(first.robot)}, {constant.label} {verb}{amount(first.name, first.size, first.sigma)} "
    text += f"since {date(first.day)} ({first.probability:.2f})"
    if first.maintenance is not None:
        text += f", {first.maintenance.what} {date(first.maintenance.day)}"
    if first.cause != "robot":
        text += f", rather of the {first.cause} ({first.causes[first.cause]:.2f}) than its own"
    elif first.others > 0:
        text += f", not in the other {first.others}"
    is_back = False
    for event in chain[1:]:
        when = date(event.day) if event.maintenance is None else date(event.maintenance.day)
        is_back = abs(event.level) < max(BACK_SIGMAS * event.level_sigma, BACK_PART * abs(event.size))
        done = "" if event.maintenance is None else f"{event.maintenance.what} "
        creeps = "creeping to " if event.form == "creep" else "back to " if is_back else "now at "
        text += f"; {done}{when}: {creeps}{figure(event.name, event.level)}"
        text += "" if is_back else f" {constant.unit}"
    size = abs(last.level) / constant.jump * last.causes.get("robot", 0.0)
    return Sentence(f"{text}.", first.robot, first.name, 0.1 * size if is_back else 1.0 + size, is_back)


def _of_group(log: Log, step: Step) -> Sentence:
    name = log.places[step.which] if step.kind == "place" else log.batches[step.which]
    seen = "seen there" if step.kind == "place" else "of it"
    text = f"{step.kind.capitalize()} {name}: {log.constant.label} {amount(log.name, step.size, step.sigma)} since "
    text += f"{date(step.day)} ({step.probability:.2f}), in all {step.robots} robots {seen}."
    return Sentence(text, "", log.name, 1.0 + abs(step.size) / log.constant.jump)


def _apart(offset: Offset) -> Sentence:
    constant = CONSTANTS[offset.name]
    subject = who(offset.who) if offset.kind == "robot" else f"{offset.kind.capitalize()} {offset.who}"
    others = {"robot": "robots", "place": "places", "batch": "batches"}[offset.kind]
    text = f"{subject}: {constant.label} {amount(offset.name, offset.size, offset.sigma)} off the other {others}, "
    text += f"from its first recordings on (p {offset.p:.1g})."
    weight = min(0.9, 0.3 * abs(offset.size) / constant.jump)
    return Sentence(text, offset.who if offset.kind == "robot" else "", offset.name, weight)


def who(robot: str) -> str:
    """Robot's name at the beginning of a sentence."""
    return f"Robot {robot}" if robot.isdigit() else robot


def amount(name: str, size: float, sigma: float) -> str:
    """Size and sigma in the constant's unit, with as many digits as the sigma justifies."""
    constant = CONSTANTS[name]
    digits = DECIMALS[constant.unit] + (constant.factor * sigma < 0.5 * 10.0 ** -DECIMALS[constant.unit])
    return f"{constant.factor * size:+.{digits}f} +- {constant.factor * sigma:.{digits}f} {constant.unit}"


def figure(name: str, size: float) -> str:
    """A size without its unit; 0.0 has no sign."""
    constant = CONSTANTS[name]
    text = f"{constant.factor * size:+.{DECIMALS[constant.unit]}f}"
    return text[1:] if not float(text) else text


def date(day: float) -> str:
    """A day since 1970, as in 12 March 2026."""
    when = datetime.fromtimestamp(day * S_PER_DAY, UTC)
    return f"{when.day} {when:%B %Y}"


def headline(found: Statistics, robots: int, recordings: int) -> list[str]:
    """Lines on the extent of the data, and of the findings."""
    changed = {e.robot for e in found.found}
    places = _steps(found.fitted.values(), "place")
    batches = _steps(found.fitted.values(), "batch")
    groups = [f"{n} of {what}" for n, what in ((places, "places"), (batches, "batches of gyros")) if n]
    return [
        f"{recordings} recordings of {robots} robots: {len(found.found)} changes of {len(changed)} robots"
        + (f", {' and '.join(groups)}." if groups else "."),
    ]


def _steps(fitted: Iterable[Fitted], kind: str) -> int:
    return sum(step.kind == kind for f in fitted for step in f.population.steps)
