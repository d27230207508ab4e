"""The next drive: the manoeuvre that settles the open questions in the fewest minutes, by simulation.

For each open question, "is it A or B", A as found is put into drives without noise, and B is fitted to what A does
there. Half the square of what B leaves, whitened, is by how much the next recording is expected to favour A, in nats.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final

import numpy as np

from drd.config.robot import Robot
from drd.effects.catalogue import catalogue
from drd.effects.effect import END, START
from drd_tools.diagnose.advise.distance import Rivals, fitted_to, half_square
from drd_tools.diagnose.advise.manoeuvres import MANOEUVRES, drive
from drd_tools.diagnose.conclude.cause import Cause
from drd_tools.diagnose.conclude.conclusion import Conclusion
from drd_tools.diagnose.error_model.linear import Sensitivity
from drd_tools.diagnose.error_model.path import Path
from drd_tools.diagnose.observe.evidence import Evidence, Noise, gather
from drd_tools.diagnose.regression.problem import Problem
from drd_tools.diagnose.results import NOTHING, Alternative, Array, NextDrive, Status
from drd_tools.diagnose.select.search import Found
from drd_tools.diagnose.select.splines import CHANNELS, COVARIATE_UNITS, PERIODIC, Curve, covariates, errors_along
from drd_tools.diagnose.selected import Selected
from drd_tools.simulate.conditions import PERFECT, Reference
from drd_tools.simulate.robot import DEFAULT
from drd_tools.simulate.simulator import simulate

SETTLED_NATS: Final = 5.0  # more than conclude.CLASS_NATS: the two are then no longer one class
MINUTES: Final = (1, 2, 3, 4, 5, 6)  # of a drive that somebody will make
MINUTES_OF_ENDS: Final = (2, 4, 6)  # each needs a drive of its own, since the last fix moves
LONGEST_STAND_S: Final = 30.0  # of a standstill at its start: the recording's own, at most so long
# Finer rates tell no more of what is slower; noise is scaled so that the information in a second stays.
FIX_S: Final = 0.5
GYRO_HZ: Final = 10.0
SLOW_GYRO_HZ: Final = 2.0  # where all that is asked for is slow
SLOW: Final = ("temperature", "temperature_rate", "time")  # covariates that no manoeuvre changes
# The ground of an interval of time is driven over again.
INTERVAL_FROM_S, INTERVAL_S = 45.0, 60.0

Question = tuple[Cause, str]


@dataclass(frozen=True)
class _Option:
    """A manoeuvre for some minutes, and the nats that it brings for each question."""

    manoeuvre: str
    minutes: int
    nats: tuple[float, ...]

    @property
    def rank(self) -> tuple[float, ...]:
        """Key of the order: questions settled, then fewer minutes, then nats; larger is better."""
        settled = sum(n >= SETTLED_NATS for n in self.nats)
        unsettled = sum(min(n, SETTLED_NATS) for n in self.nats)
        minutes = self.minutes if settled else 0
        return (settled, -minutes, unsettled, sum(self.nats))


def next_drive(conclusion: Conclusion, nominal: Robot) -> NextDrive | None:
    """The drive that settles the open questions of a diagnosis; None where none is open that a drive could settle.

    Open are findings that something else also fits, and suspected ones (against nothing). `nats` is the least of the
    pairs that it settles (where it settles none: the most that it brings); the alternatives are the other manoeuvres,
    best first. Deterministic.
    """
    questions = open_questions(conclusion.causes)
    if not questions:
        return None
    options = options_for(conclusion.found, nominal, questions)
    best_of = {o.manoeuvre: o for o in sorted(options, key=lambda o: o.rank)}
    best, *others = sorted(best_of.values(), key=lambda o: o.rank, reverse=True)
    pairs = [[finding.effect, rival] for finding, rival in questions]
    nats = _least(best)
    separates = [p for p, n in zip(pairs, best.nats, strict=True) if n >= SETTLED_NATS]
    unsettled = [p for p in pairs if p not in separates]
    alternatives = [Alternative(o.manoeuvre, float(o.minutes), o.rank[0], _least(o)) for o in others]
    said = _sentence(best, separates, unsettled, nats)
    return NextDrive(best.manoeuvre, float(best.minutes), separates, nats, unsettled, alternatives, said)


def open_questions(findings: Sequence[Cause]) -> list[Question]:
    """Pairs of a finding and an effect that may be there instead."""
    questions: list[Question] = []
    for finding in findings:
        if finding.selected is not None and not finding.selected.effect.recurs:
            continue
        rivals = finding.also_fits or ((NOTHING,) if finding.status is Status.SUSPECTED else ())
        questions += [(finding, rival) for rival in rivals]
    return questions


def options_for(found: Found, nominal: Robot, questions: Sequence[Question]) -> list[_Option]:
    """All manoeuvres and durations, with the nats that each brings for each question."""
    e, noise, reference = found.problem.evidence, found.problem.noise, _kind(found.problem.evidence)
    slow = [_is_slow(f) and (rival == NOTHING or _is_slow(rival)) for f, rival in questions]
    rate_hz = min(nominal.gyro_rate_hz or GYRO_HZ, SLOW_GYRO_HZ if all(slow) else GYRO_HZ)
    nominal = replace(nominal, standstill_at_start_s=min(nominal.standstill_at_start_s, LONGEST_STAND_S))
    nominal = nominal.without_gyro() if e.gyro_rad is None else replace(nominal, gyro_rate_hz=rate_hz)
    if not e.has_wheels:  # those of some robot
        radius_m, counts = DEFAULT.wheel_radius_m, DEFAULT.counts_per_revolution
        nominal = replace(nominal, wheel_radius_m=radius_m, counts_per_revolution=counts, tread_m=DEFAULT.tread_m)
    period_s = reference.period_s
    if period_s is not None and period_s < FIX_S:
        share = math.sqrt(FIX_S / period_s)
        noise = replace(noise, position_m=noise.position_m / share, heading_rad=noise.heading_rad / share)
        reference = replace(reference, period_s=FIX_S)
    knows_temperature = bool(np.isfinite(e.temperature_c).any())
    some_slow = any(_is_slow(of) for question in questions for of in question)
    others = [c for c in found.fit.selection if c.begin_s is None]
    options: list[_Option] = []
    for name, manoeuvre in MANOEUVRES.items():
        if manoeuvre.cold and not some_slow:
            continue
        runs = [(m, (m,)) for m in MINUTES_OF_ENDS] if period_s is None and len(e.fix) else [(MINUTES[-1], MINUTES)]
        for longest, lengths in runs:
            evidence, path = _driven(name, longest, nominal, reference, knows_temperature, e.has_wheels)
            nats = _nats(evidence, path, noise, questions, others, lengths)
            options += [_Option(name, m, n) for m, n in zip(lengths, nats, strict=True)]
    return options


def _is_slow(of: Cause | str) -> bool:
    """Whether it is an error of the gyro that no manoeuvre changes."""
    if isinstance(of, str):
        return of != NOTHING and catalogue()[of].channel == "gyro" and catalogue()[of].covariate in SLOW
    return of.acts_on == "gyro" and of.covariate in SLOW


@lru_cache(maxsize=64)
def _driven(
    name: str, minutes: int, nominal: Robot, reference: Reference, knows_temperature: bool, has_wheels: bool
) -> tuple[Evidence, Path]:
    """Simulate a manoeuvre with perfect sensors: their evidence, and the true path."""
    truth = drive(name, minutes, nominal.standstill_at_start_s)
    recording = simulate(truth, nominal, (), replace(PERFECT, reference=reference), name=name).recording
    e = gather(recording if has_wheels else replace(recording, wheels=None))
    if not knows_temperature:
        e = replace(e, temperature_c=np.full(len(e.time_s), np.nan))
    edges_s = e.edges_s
    pose = [np.interp(edges_s, truth.time_s, a) for a in (truth.x_m, truth.y_m, truth.heading_rad)]
    return e, Path(np.column_stack(pose))


def _kind(e: Evidence) -> Reference:
    """The kind of reference that a recording has."""
    if not len(e.fix):
        return Reference(is_there=False)
    at_s = e.time_s[e.fix_step] - e.fix_share * e.step_s[e.fix_step]
    period_s = round(float(np.median(np.diff(at_s))), 2) if len(at_s) > 2 else math.inf
    return Reference(period_s=period_s if period_s <= 60.0 * MINUTES[0] else None)


# ---- nats ----------------------------------------------------------------------------------------------------------


def _sensitivity(problem: Problem, finding: Cause) -> Sensitivity:
    if finding.selected is not None:
        return problem.sensitivity(finding.selected.effect, _again(finding.selected).values)
    assert finding.curve is not None
    return _curve_sensitivity(problem, finding.curve)


def _again(selected: Selected) -> Selected:
    """Shift an interval of time to where the drive passes its ground again; all else acts throughout."""
    if selected.begin_s is None:
        return selected
    times = {START.name: INTERVAL_FROM_S}
    if selected.end_s is not None:
        times[END.name] = INTERVAL_FROM_S + min(selected.end_s - selected.begin_s, INTERVAL_S)
    return replace(selected, values={**selected.values, **times})


def _curve_sensitivity(problem: Problem, curve: Curve) -> Sensitivity:
    """Sensitivity of a curve without a name; beyond its ends it stays as it is there."""
    m, known = problem.sensitivities.motion, covariates(problem)
    if curve.covariate not in known:
        return Sensitivity()
    period = 360.0 if curve.covariate in PERIODIC else None
    x = known[curve.covariate][0] * COVARIATE_UNITS[curve.covariate][1]
    value = np.interp(x, curve.knots, curve.value, period=period)
    errors = errors_along(m)[curve.channel](value / CHANNELS[curve.channel].public)
    return problem.sensitivities.of(errors)


def _nats(
    evidence: Evidence,
    path: Path,
    noise: Noise,
    questions: Sequence[Question],
    others: Sequence[Selected],
    minutes: Sequence[int],
) -> list[tuple[float, ...]]:
    """Nats that the drive brings for each question, for each duration."""
    problem = Problem(evidence, path, noise)
    findings = list({id(f): f for f, _ in questions}.values())
    names = sorted({rival for _, rival in questions if rival != NOTHING})
    rivals = Rivals(problem, names, [_sensitivity(problem, f) for f in findings])
    data = {id(f): rivals.others[:, k] for k, f in enumerate(findings)}
    best = [rivals.best(name, data[id(f)], problem.nuisance) if name != NOTHING else None for f, name in questions]
    fitted = [None if b is None else b[1] for b in best]
    others = [c for c in others if any(c is not f.selected for f, _ in questions)]
    used = [*others, *(c for c in fitted if c is not None)]
    problem.units(
        problem.wanted_rows(used) + problem.wanted_tangents(used) + [w for c in used for w in problem.wanted_shapes(c)]
    )
    left: list[tuple[float, list[tuple[Array, Array]]]] = []
    for (finding, _), rival in zip(questions, fitted, strict=True):
        beside = [c for c in others if c is not finding.selected]
        # A rival of no size is none: it never does worse.
        ways = [fitted_to(problem, data[id(finding)], beside, r) for r in ([None, rival] if rival else [None])]
        left.append((_price(problem, finding, rival), ways))
    kept = [problem.row_time_s <= 60.0 * limit for limit in minutes]
    return [tuple(min(half_square(r[k], held[k]) for r, held in ways) - price for price, ways in left) for k in kept]


def _price(problem: Problem, finding: Cause, rival: Selected | None) -> float:
    """Excess of the finding's penalty over its rival's: so much must the data bring before it is preferred."""
    mine = (
        problem.penalty([finding.selected])
        if finding.selected is not None
        else problem.per_parameter + problem.per_effect
    )
    return max(0.0, mine - (problem.penalty([rival]) if rival is not None else 0.0))


# ---- words ---------------------------------------------------------------------------------------------------------


def _least(option: _Option) -> float:
    settled = [n for n in option.nats if n >= SETTLED_NATS]
    return round(max(0.0, min(settled) if settled else max(option.nats)), 1)


def _sentence(best: _Option, separates: list[list[str]], unsettled: list[list[str]], nats: float) -> str:
    def paired(pairs: list[list[str]]) -> str:
        return "; ".join(f"{a} from {b}" for a, b in pairs)

    if not separates:
        return (
            f"None of the drives that were simulated, up to {MINUTES[-1]} minutes long, tells {paired(unsettled)}; "
            f"most, {nats:.2g} nats, come from {best.manoeuvre}."
        )
    minutes = "1 minute" if best.minutes == 1 else f"{best.minutes} minutes"
    text = f"{minutes} of {best.manoeuvre} would tell {paired(separates)}, by at least {nats:.3g} nats."
    names = {name for pair in separates for name in pair}
    advice = (effect.advice for effect in catalogue().values() if effect.id in names and effect.advice)
    text += "".join(f" {a.format(from_s=INTERVAL_FROM_S)}" for a in dict.fromkeys(advice))
    return text + (f" It does not tell {paired(unsettled)}." if unsettled else "")
