"""Combine the results of several recordings, each diagnosed separately, into one."""

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations
from typing import Final, NamedTuple

from msgspec import UNSET
from msgspec.structs import replace

from drd.effects.catalogue import catalogue
from drd_tools.diagnose.combine.joint import Common, together, united
from drd_tools.diagnose.combine.means import contradict, mean_of, sigmas
from drd_tools.diagnose.combine.statistics import SufficientStatistics
from drd_tools.diagnose.conclude.cause import rounded
from drd_tools.diagnose.conclude.confirm import LARGEST_NATS
from drd_tools.diagnose.conclude.outcome import names_of
from drd_tools.diagnose.conclude.reference import CLEARLY
from drd_tools.diagnose.results import (
    Amount,
    Because,
    Figures,
    Finding,
    Fit,
    Result,
    Smallest,
    Status,
    Support,
    Term,
    Train,
    Unexplained,
    Verdict,
)

SURER: Final = list(Status)
STRONG_ODDS: Final = 20.0  # to 1 (Kass and Raftery 1995)
LEAST: Final = 1e-300  # of an e-value, whose logarithm is taken


class _Said(NamedTuple):
    """A finding, and the recording in which it was found."""

    recording: str
    finding: Finding


def combined(results: Sequence[Result], statistics: Sequence[SufficientStatistics]) -> Result:
    """Combine several results. Parameters of lasting effects are random-effects means over recordings; those of effects
    of one run stay unchanged. Effects that only all recordings together show are added (`joint`).
    """
    of_all = together(statistics, _of_most(results))
    common = [_with_share(f, results) for f in of_all.findings]
    findings: list[Finding] = []
    for name, said in _grouped(_beside(results, of_all)).items():
        if name in catalogue() and catalogue()[name].lasting:
            findings.append(_borne_out(_one_of(said, len(results)), said, results, statistics))
        else:
            findings += [_in_one_recording(f, recording, len(results)) for recording, f in said]
    findings = _with_one_surrogate_each(findings)
    findings = sorted([*findings, *common], key=lambda f: (-(f.explains or 0.0), -f.gain_nats))
    found, detectable = names_of(findings), _most_sensitive(results)
    before = _side_by_side(results, [r.fit.train.before for r in results])
    after = _side_by_side(results, [r.fit.train.after for r in results])
    return Result(
        recording=", ".join(r.recording for r in results),
        verdict=_verdict(results, findings, bool(common)),
        findings=tuple(findings),
        unexplained=Unexplained(
            largest(r.unexplained.share_of_residual for r in results),
            largest(r.unexplained.end_error_m for r in results),
        ),
        ruled_out=_ruled_out(results, found),
        detectable=detectable,
        not_observable=_unobservable(results, {*found, *detectable}),
        classes=[c for c in results[0].classes if all(c in other.classes for other in results)],
        fit=Fit(Train(before, after), results[0].fit.held_out),
        scatter=tuple(replace(n, sentence=f"{r.recording}: {n.sentence}") for r in results for n in r.scatter),
        next_drive=next((r.next_drive for r in results if r.next_drive), None),
        reference=_reference_of_all(results) or UNSET,
        notes=tuple(f"{r.recording}: {note}" for r in results for note in r.notes or ()) or UNSET,
    )


def _reference_of_all(results: Sequence[Result]) -> dict[str, Amount]:
    """Errors of the reference that most recordings show: their random-effects means; the total number of jumps."""
    said: dict[str, list[Amount]] = {}
    for result in results:
        for name, fault in (result.reference or {}).items():
            said.setdefault(name, []).append(fault)
    found = {
        name: mean_of(faults)
        if all(f.std > 0.0 for f in faults)
        else Amount(sum(f.value for f in faults), 0.0, faults[0].unit)
        for name, faults in said.items()
        if 2 * len(faults) > len(results)
    }
    return {name: fault for name, fault in found.items() if abs(fault.value) > CLEARLY * fault.std}


def _grouped(results: Sequence[Result]) -> dict[str, list[_Said]]:
    groups: dict[str, list[_Said]] = {}
    for result in results:
        for finding in result.findings:
            groups.setdefault(finding.effect, []).append(_Said(result.recording, finding))
    return groups


def _of_most(results: Sequence[Result]) -> set[str]:
    """Lasting effects that most recordings show alone: their values may differ from drive to drive."""
    count = Counter(name for r in results for name in names_of(r.findings) if name in catalogue())
    return {name for name, n in count.items() if n > 0.5 * len(results) and catalogue()[name].lasting}


def _beside(results: Sequence[Result], of_all: Common) -> list[Result]:
    """The results without the findings common to all, and without those that may stand for them."""
    common = names_of(of_all.findings)
    kept = [
        tuple(f for f in r.findings if f.effect not in common and (f.effect in own or not _stands_for(f, common)))
        for r, own in zip(results, of_all.own, strict=True)
    ]
    return [replace(r, findings=findings) for r, findings in zip(results, kept, strict=True)]


def _stands_for(finding: Finding, effects: set[str]) -> bool:
    """Whether one of the effects is a recording's finding or an alternative to it."""
    return not effects.isdisjoint({finding.effect, *finding.also_fits})


def _with_share(finding: Finding, results: Sequence[Result]) -> Finding:
    """Add to a common finding the share that single recordings attribute to it, or to alternatives to it."""
    shown = [[f for f in r.findings if _stands_for(f, {finding.effect})] for r in results]
    count = sum(map(bool, shown))
    if not count:
        text = f"{finding.sentence} No single recording shows it, but all {len(results)} together do."
        return replace(finding, sentence=text)
    explains = sum(f.explains or 0.0 for own in shown for f in own) / len(results)
    text = f"{finding.sentence} Individually, {count} of {len(results)} recordings show it or an alternative to it."
    return replace(finding, explains=explains, sentence=text)


def _in_one_recording(finding: Finding, recording: str, count: int) -> Finding:
    """A finding of one of `count` recordings, with its share of the mismatch in all."""
    explains = None if finding.explains is None else finding.explains / count
    return replace(finding, explains=explains, sentence=f"{recording}: {finding.sentence}", recording=recording)


def _one_of(said: Sequence[_Said], count: int) -> Finding:
    """Combine the findings of a lasting effect in some of `count` recordings into one."""
    all_found = [f for _, f in said]
    # A value with a prior from the others would count these twice.
    found = [f for f in all_found if f.evidence.prior_odds is UNSET]
    best = max(found, key=lambda f: f.gain_nats)
    ps = [p for f in found if (p := f.evidence.family_wise_p) is not None]
    log_e = sum(math.log(max(f.evidence.e_value or 0.0, LEAST)) for f in found)
    where = ", ".join(r for r, _ in said)
    parameters, beside = _mean([f.parameters for f in found]), _mean_term([f.beside for f in found if f.beside])
    text = f"{best.sentence} Found in {len(said)} of {count} recordings ({where}).{_of_all(parameters, beside, said)}"
    return replace(
        best,
        status=max((f.status for f in found), key=SURER.index),
        also_fits=tuple(sorted(set.intersection(*(set(f.also_fits) for f in found)))),
        parameters=parameters,
        beside=beside or UNSET,
        seen=united([f.seen for f in all_found]),
        evidence=Support(
            sum(f.gain_nats for f in all_found),
            min(1.0, min(ps) * count) if ps else None,
            math.exp(min(LARGEST_NATS, log_e)),
        ),
        explains=sum(f.explains or 0.0 for f in all_found) / count,
        sentence=text + _apart(said),
    )


def _of_all(parameters: Mapping[str, Amount], beside: Term | None, said: Sequence[_Said]) -> str:
    """Sentence with the combined values; the text before it gives those of the recording that shows it best."""
    shown = _values(parameters)
    if beside is not None:
        shown += [f"{beside.effect} {value}" for value in _values(beside.parameters)]
    return f" Combined: {', '.join(shown)}." if len(said) > 1 and shown else ""


def _values(parameters: Mapping[str, Amount]) -> list[str]:
    return [f"{name} = {_value(amount)}" for name, amount in parameters.items() if amount.std > 0.0]


def _value(amount: Amount) -> str:
    return f"{rounded(amount.value, amount.std)} {amount.unit}".removesuffix(" 1")


def _apart(said: Sequence[_Said]) -> str:
    """Sentence on contradicting values, by parameter: the two that contradict each other most, and where."""
    told = []
    for name in said[0].finding.parameters:
        values = [(f.parameters[name], recording) for recording, f in said if name in f.parameters]
        if contradict([amount for amount, _ in values]):
            pair = max(combinations(values, 2), key=lambda two: sigmas(two[0][0], two[1][0]))
            shown = [f"{_value(amount)} in {where}" for amount, where in pair]
            told.append(f"{name} is {shown[0]} and {shown[1]}")
    return f" They contradict each other: {'; '.join(told)}." if told else ""


def _borne_out(
    finding: Finding, said: Sequence[_Said], results: Sequence[Result], statistics: Sequence[SufficientStatistics]
) -> Finding:
    """Reduce a finding to a suspicion if more recordings contradict it than show it. (89)"""
    shown_in = {recording for recording, _ in said}
    others = [(r, own) for r, own in zip(results, statistics, strict=True) if r.recording not in shown_in]
    found = (own.log_bayes_factor(finding.effect, _prior(finding)) for _, own in others)
    if nats := [n for n in found if n is not None]:
        against = sum(n < 0.0 for n in nats) if sum(nats) < -math.log(STRONG_ODDS) else 0
    else:
        against = sum(would_show(r, finding) for r, _ in others)
    if against <= len(said):  # a single one may be wrong
        return finding
    text = f"{finding.sentence} {against} others should show it but do not, so it is withdrawn."
    return replace(finding, status=Status.SUSPECTED, sentence=text, contradicted_by=against)


def _prior(finding: Finding) -> dict[str, tuple[float, float]]:
    """Value and standard deviation, SI, of each parameter that has one."""
    units = {q.name: q.si for q in catalogue()[finding.effect].parameters}
    return {n: (a.value * units[n], a.std * units[n]) for n, a in finding.parameters.items() if a.std > 0.0}


def would_show(result: Result, finding: Finding) -> bool:
    """Whether a recording would show an effect half as large, but reports neither its name nor one of its class."""
    if any({f.effect, *f.also_fits} & {finding.effect, *finding.also_fits} for f in result.findings):
        return False
    least = result.detectable.get(finding.effect)
    if least is None or least.smallest is None:
        return False
    size = max((abs(a.value) for a in finding.parameters.values() if a.unit == least.unit), default=0.0)
    return least.smallest < 0.5 * size


def _mean(parameters: Sequence[Mapping[str, Amount]]) -> dict[str, Amount]:
    """Random-effects means over recordings."""
    found = dict(parameters[0])
    for name in parameters[0]:
        amounts = [p[name] for p in parameters if name in p]
        if all(a.std > 0.0 for a in amounts):
            found[name] = mean_of(amounts)
    return found


def _with_one_surrogate_each(findings: Sequence[Finding]) -> list[Finding]:
    """Keep each surrogate once, with means over the recordings that need it, and not beside a finding of its name."""
    named = names_of(findings)
    groups: dict[str, list[Term]] = {}
    for near in (f.surrogate for f in findings):
        if near is not None and near.effect not in named:
            groups.setdefault(near.effect, []).append(near)
    made = []
    for finding in findings:
        terms = groups.pop(finding.surrogate.effect, None) if finding.surrogate is not None else None
        made.append(replace(finding, surrogate=_mean_term(terms or [])))
    return made


def _mean_term(terms: Sequence[Term]) -> Term | None:
    """The term of the same effect in several recordings, with random-effects means; None if there is none."""
    if not terms:
        return None
    return replace(terms[0], parameters=_mean([t.parameters for t in terms]), seen=united([t.seen for t in terms]))


def _verdict(results: Sequence[Result], findings: Sequence[Finding], is_more_together: bool) -> Verdict:
    verdicts = {r.verdict for r in results} | ({Verdict.EXPLAINED} if is_more_together else set())
    if len(verdicts) == 1:
        return verdicts.pop()
    if not any(f.is_named for f in findings):
        return Verdict.UNKNOWN
    return Verdict.PARTLY if verdicts - {Verdict.NOTHING, Verdict.EXPLAINED} else Verdict.EXPLAINED


def largest(values: Iterable[float | None]) -> float | None:
    """The largest known value; None if there is none."""
    return max((v for v in values if v is not None), default=None)


def _ruled_out(results: Sequence[Result], found: set[str]) -> list[Because]:
    """Effects that no recording shows, in the words of the most sensitive one.

    An effect of one run is ruled out only if all recordings rule it out.
    """
    said: dict[str, list[tuple[float, str]]] = {}
    for result in results:
        for row in result.ruled_out:
            size = _size(result.detectable.get(row.effect))
            said.setdefault(row.effect, []).append((size, f"{result.recording}: {row.because}"))
    return [
        Because(name, min(texts, key=lambda t: t[0])[1])
        for name, texts in sorted(said.items())
        if name not in found and (catalogue()[name].lasting or len(texts) == len(results))
    ]


def _unobservable(results: Sequence[Result], seen: set[str]) -> list[Because]:
    """Effects that none of the recordings can show."""
    names = set.intersection(*({row.effect for row in r.unobservable} for r in results)) - seen
    return [row for row in results[0].unobservable if row.effect in names]


def _side_by_side(results: Sequence[Result], figures: Sequence[Figures]) -> Figures:
    return {f"{r.recording}: {q}": v for r, own in zip(results, figures, strict=True) for q, v in own.items()}


def _most_sensitive(results: Sequence[Result]) -> dict[str, Smallest]:
    found: dict[str, Smallest] = {}
    for result in results:
        for name, size in result.detectable.items():
            if name not in found or _size(size) < _size(found[name]):
                found[name] = size
    return found


def _size(found: Smallest | None) -> float:
    return math.inf if found is None or found.smallest is None else found.smallest
