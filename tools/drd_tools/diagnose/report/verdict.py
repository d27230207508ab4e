"""The verdict of a diagnosis, in three sentences."""

from collections.abc import Sequence
from typing import Final

from drd_tools.diagnose.conclude.scatter import ROBOT
from drd_tools.diagnose.report.text import (
    FIXED,
    channel,
    length,
    listed,
    named_quantity,
    parameters,
    percent,
    reference_faults,
    rms,
)
from drd_tools.diagnose.results import Finding, Result, Verdict
from drd_tools.diagnose.series import Series
from drd_tools.diagnose.validate.trajectory import OUTSIDE, is_predicted

MOST_IN_WORDS: Final = 5  # findings; the table has the rest
ALL: Final = 0.005  # a smaller share counts as nothing left

TITLES: Final = {
    Verdict.NOTHING: "nothing is missing",
    Verdict.EXPLAINED: "explained",
    Verdict.PARTLY: "partly explained",
    Verdict.UNKNOWN: "a cause outside the catalogue",
}


def title(d: Result, names: Sequence[str]) -> str:
    """Title of the page."""
    shown = names[0] if len(names) == 1 else f"{names[0]} and {len(names) - 1} more"
    return f"Diagnosis of {shown}: {TITLES[d.verdict]}"


def lead(d: Result, s: Series) -> list[str]:
    """Summary in at most three sentences: findings, their certainty, what they explain and what remains."""
    if not d.findings:
        return _nothing(d, s)
    return [_what(d.findings), _how_sure(d.findings), _what_is_left(d, s)]


def _nothing(d: Result, s: Series) -> list[str]:
    length_s = sum(r.duration_s for r in s.recordings)
    metres = sum(r.path_m for r in s.recordings)
    drive = f"{length_s / 60.0:.3g} minutes and {metres:.4g} m"
    if d.verdict is Verdict.NOTHING:
        first = f"Over {drive} the recording agrees with the nominal model: no effect stands out from the noise."
    else:
        first = f"Over {drive} the mismatch exceeds the noise, but no cause could be identified."
    size = rms(s.residual.before)
    second = "" if size is None else f"Its residual is {size:.3g} times that of noise alone."
    if noise := "; ".join(_noise(d) + reference_faults(d)):
        second = f"{noise[0].upper()}{noise[1:]}."
    if all(r.path.reference is None for r in s.recordings):
        third = (
            "Without a reference, the sensors could only be compared with each other: a path error common to gyro and "
            "wheels cannot be excluded."
        )
    else:
        third = "The smallest error that would have been detected is listed below for each effect."
    return [sentence for sentence in (first, second, third) if sentence]


def _what(findings: Sequence[Finding]) -> str:
    findings, more = findings[:MOST_IN_WORDS], len(findings) - MOST_IN_WORDS
    named, unknown = [f for f in findings if f.is_named], [f for f in findings if not f.is_named]
    parts = []
    if named:
        count = "one effect" if len(named) == 1 else f"{len(named)} effects"
        parts.append(f"the nominal model leaves out {count}: {listed(_named(f, len(findings) == 1) for f in named)}")
    if unknown:
        channels = listed(dict.fromkeys(channel(f) for f in unknown))
        covariates = listed(dict.fromkeys(f.covariate.replace("_", " ") for f in unknown if f.covariate))
        goes_with = f"depends on {covariates}" if covariates else "depends on none of the variables tried"
        parts.append(f"something outside the catalogue acts on the {channels} and {goes_with}")
    if more > 0:
        parts.append(f"the table lists {more} more")
    text = "; in addition, ".join(parts)
    return f"{text[0].upper()}{text[1:]}."


def _named(f: Finding, with_values: bool) -> str:
    values = [value for value in parameters(f) if FIXED not in value] if with_values else []
    shown = f" ({', '.join(values)})" if values else ""
    rivals = f" (or {listed(f.also_fits, 'or')}, which fits equally well)" if f.also_fits else ""
    return f"{f.effect}{shown}{rivals}"


def _how_sure(findings: Sequence[Finding]) -> str:
    worst = max((f.evidence.family_wise_p for f in findings if f.evidence.family_wise_p is not None), default=None)  # fmt: skip  # noqa: E501
    chance = "" if worst is None else (
        "; if nothing were missing, such a finding would occur in "
        f"{'at most ' if len(findings) > 1 else ''}{percent(worst)} of recordings"
    )  # fmt: skip
    if len({f.status for f in findings}) == 1:
        who = "This is" if len(findings) == 1 else "Both are" if len(findings) == 2 else "All of them are"
        return f"{who} {findings[0].status}{chance}."
    parts = []
    for status in dict.fromkeys(f.status for f in findings):
        group = [f for f in findings if f.status == status]
        parts.append(f"{_counted(group)} {'is' if len(group) == 1 else 'are'} {status}")
    shown = listed(parts)
    return f"Of these, {shown}{chance}."


def _what_is_left(d: Result, s: Series) -> str:
    parts = [_share(d)] if _share(d) else []
    end_m = d.unexplained.end_error_m
    if end_m is not None:
        parts.append(f"the path {'still ' if any(f.is_named for f in d.findings) else ''}ends {length(end_m)} off")
    parts += _outside(d)
    for row in s.held_out:
        if row.before is None or row.after is None:
            continue
        name, unit = named_quantity(row.quantity, row.unit)
        goes = "falls" if row.after < row.before else "does not fall: it goes"
        parts.append(f"on unseen data the {name} {goes} from {row.before:.3g} to {row.after:.3g} {unit}".rstrip())
        break
    parts += _noise(d) + reference_faults(d)
    text = "; ".join(parts) or "how much of the mismatch this explains is not known"
    return f"{text[0].upper()}{text[1:]}."


def _outside(d: Result) -> list[str]:
    """Words for poses outside their own bound, in the recordings of the fit and in others."""
    own = {
        q.removesuffix(OUTSIDE).rstrip(": "): {OUTSIDE: v} for q, v in d.fit.train.after.items() if q.endswith(OUTSIDE)
    }
    others = {name: figures for name, figures in d.fit.held_out.after.items() if isinstance(figures, dict)}
    found = []
    for name, figures in [*own.items(), *others.items()]:
        if not is_predicted(figures):
            share = percent(0.01 * (figures[OUTSIDE] or 0.0))
            found.append(f"{share} of the poses{f' of {name}' if name else ''} lie outside their own 99 % bound")
    return found[:MOST_IN_WORDS]


def _noise(d: Result) -> list[str]:
    """Words for sensor noise much larger than stated, which may be physics."""
    return [f"{noise.sentence} (taken for noise, may be physics)" for noise in d.scatter if noise.channel in ROBOT]


def _share(d: Result) -> str:
    """Words for the share explained; with unnamed causes, the shares one by one."""
    findings, shares = d.findings, [f.explains for f in d.findings if f.explains is not None]
    if all(f.is_named for f in findings) and shares:
        who, ending = ("It explains", "s") if len(findings) == 1 else ("Together they explain", "")
        left = max(0.0, 1.0 - sum(shares))
        if left < ALL:
            return f"{who} all of the mismatch beyond the noise"
        return f"{who} {percent(1.0 - left)} of the mismatch and leave{ending} {percent(left)}"
    findings = findings[:MOST_IN_WORDS]
    known = [(f, percent(f.explains)) for f in findings if f.explains is not None]
    if len(findings) == 1:
        return f"it accounts for {known[0][1]} of the mismatch" if known else ""
    return f"shares of the mismatch: {listed([f'{_name(f)} {share}' for f, share in known])}" if known else ""


def _counted(findings: Sequence[Finding]) -> str:
    """Names, with unnamed causes combined."""
    names, unknown = [f.effect for f in findings if f.is_named], sum(not f.is_named for f in findings)
    if unknown:
        names.append("the unknown one" if unknown == 1 else f"{unknown} unknown ones")
    return listed(names)


def _name(f: Finding) -> str:
    return f.effect if f.is_named else "the unknown one"
