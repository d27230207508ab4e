"""Tables and sentences of a diagnosis, from diagnosis.json and series.json, with formatted numbers."""

import math
from collections.abc import Iterable
from typing import Final

from msgspec import UnsetType

from drd.arrays import Array
from drd.effects.catalogue import catalogue
from drd_tools.diagnose.results import Finding, HeldOut, NextDrive, Result
from drd_tools.diagnose.series import Bar, Gain, Mismatch, Series

WHAT_HEADER: Final = ("finding", "description", "parameters (± 1 sigma)")
EVIDENCE_HEADER: Final = (
    "finding",
    "acts on",
    "when",
    "status",
    "gain / nats",
    "p",
    "e-value",
    "explains",
    "alternatives",
)
EVIDENCE_TEXT: Final = (1, 2, 3, 8)
LEGEND: Final = (
    "Gain: log-likelihood ratio of the data, with over without the effect, all other effects refitted. p: probability "
    "that a recording in which nothing is missing yields a finding this strong, for any effect (family-wise). e-value: "
    "likelihood ratio, with over without the effect, on data that the search did not use. Explains: share of the "
    "mismatch, by squared detectability. Alternatives: effects that fit equally well, with their probability. "
    "Suspected: may be due to chance, or is contradicted by held-out recordings; supported: unlikely to be due to "
    "chance; confirmed: also borne out by data that were not used in the fit."
)
SPEAKS: Final = {
    "for": "The held-out recordings support it",
    "against": "The held-out recordings contradict it, so it is not in the model",
    "neither": "The held-out recordings are inconclusive about it",
}
RULED_OUT_HEADER: Final = ("effect", "acts on", "why")
DETECTABLE_HEADER: Final = ("effect", "acts on", "smallest detectable", "unit", "plausible range", "note")
FIT_HEADER: Final = ("quantity", "unit", "before", "after")
HELD_OUT_HEADER: Final = ("recording", *FIT_HEADER)
MOST: Final = 1e100  # a larger e-value is shown as more than this
UNITS: Final = ("m", "deg", "percent", "s")
CHANNELS: Final = {
    "slip": "wheels",
    "gyro": "gyro at rest",
    "position": "reference positions",
    "heading": "reference headings",
}
FAULTS: Final = {
    "lag": "the reference lags by {} (corrected)",
    "drift": "the clocks of the reference and of the wheels drift apart by {} (which of the two drifts is unknown)",
    "ahead": "the reference is mounted {} ahead of the robot's centre",
    "left": "the reference is mounted {} to the left of the robot's centre",
    "heading": "the reference heading is offset from the robot's by {}",
    "smoothing": "the reference is smoothed: weight {} on a moving average of 0.6 s",
    "held": "the reference was lost (one pose repeated, or poses out of the robot's reach) for {} s in all (left out)",
    "jumps": "jumps in the reference position: {}",
    "delay": "the wheels lag the reference by {} (which of the two is off is unknown)",
}
SEGMENT_HEADER: Final = ("manoeuvre", "repetitions", "minutes")
SETTLED_HEADER: Final = ("question", "probability of an answer", "expected evidence / nats")
FIXED: Final = "(not\N{NO-BREAK SPACE}fitted)"
WHOLE: Final = 0.95  # of the recording: a longer window counts as the whole


def what_rows(findings: Iterable[Finding]) -> list[tuple[str, ...]]:
    """Rows under WHAT_HEADER."""
    return [(f.effect, what_it_is(f), ", ".join(parameters(f)) or "-") for f in findings]


def evidence_rows(findings: Iterable[Finding], duration_s: float) -> list[tuple[str, ...]]:
    """Rows under EVIDENCE_HEADER."""
    rows: list[tuple[str, ...]] = []
    for f in findings:
        evidence = f.evidence
        e_value = evidence.e_value
        rows.append((
            f.effect,
            channel(f),
            when(f, duration_s),
            f.status,
            "-" if evidence.gain_nats is None else f"{evidence.gain_nats:.1f}",
            "-" if evidence.family_wise_p is None else f"{evidence.family_wise_p:.2g}",
            "-" if e_value is None else power(e_value),
            "-" if f.explains is None else percent(f.explains),
            ", ".join(_likely(f, name) for name in f.also_fits) or "none",
        ))  # fmt: skip
    return rows


def _likely(f: Finding, name: str) -> str:
    """A name that fits as well, and its probability."""
    return f"{name} ({p:.2f})" if (p := f.probabilities.get(name)) is not None else name


def what_it_is(f: Finding) -> str:
    """The catalogue's sentence."""
    effect = catalogue().get(f.effect)
    return effect.sentence if effect else "None of the effects in the catalogue."


def channel(f: Finding) -> str:
    """The place where a finding acts, in words."""
    return {"timing": "time stamps", "readout": "read-out"}.get(f.acts_on, f.acts_on)


def windows(f: Finding, duration_s: float) -> list[tuple[float, float]]:
    """Windows of a finding that are not the whole recording."""
    return [(a, b) for a, b in f.windows if b - a < WHOLE * duration_s]


def when(f: Finding, duration_s: float) -> str:
    """Windows of a finding in words."""
    parts = windows(f, duration_s)
    return listed(f"{a:.0f} to {b:.0f} s" for a, b in parts) if parts else "throughout"


def parameters(f: Finding) -> list[str]:
    """Parameters of a finding with their uncertainty and unit."""
    values = {**f.choices, **{name: with_sigma(p.value, p.std, p.unit) for name, p in f.parameters.items()}}
    return [f"{name} = {value}".replace(" ", "\N{NO-BREAK SPACE}") for name, value in values.items()]


def with_sigma(value: float, std: float, unit: str) -> str:
    """A value with as many digits as the uncertainty warrants: two of it."""
    shown = "" if unit in {"", "1"} else f" {pretty(unit)}"
    if math.isnan(value):
        return "not known"
    if std == 0.0:
        return f"{value:.4g}{shown} {FIXED}"
    if not math.isfinite(std):
        return f"{value:.4g}{shown}"
    exponent = math.floor(math.log10(max(abs(value), std)))
    scale = exponent if not -4 <= exponent <= 5 else 0
    digits = max(1 - math.floor(math.log10(std)) + scale, 0)
    pair = f"{value / 10.0**scale:.{digits}f} ± {std / 10.0**scale:.{digits}f}"
    return f"({pair}) \N{MULTIPLICATION SIGN} 10{_raised(scale)}{shown}" if scale else f"{pair}{shown}"


def ruled_out_rows(d: Result) -> list[tuple[str, str, str]]:
    """Rows of the effects that were ruled out: first those that act where a finding acts, then by the catalogue."""
    hit = {_acts_on(f.effect) for f in d.findings} | {f.acts_on for f in d.findings}
    rows = [(r.effect, _acts_on(r.effect), r.because.replace("+-", "±")) for r in d.ruled_out]
    return sorted(rows, key=lambda row: (row[1] not in hit, _place(row[0])))


def detectable_rows(d: Result) -> list[tuple[str, ...]]:
    """Rows of smallest detectable sizes, in the catalogue's order, with its plausible sizes."""
    rows: list[tuple[str, ...]] = []
    for effect, found in sorted(d.detectable.items(), key=lambda item: _place(item[0])):
        unit, size = found.unit, found.smallest
        known = catalogue().get(effect)
        fitting = [p for p in known.parameters if p.unit == unit and p.high > 0.0] if known else []
        low, high = (fitting[0].low, fitting[0].high) if fitting else (0.0, math.inf)
        is_undetectable = size is None or size > high
        note = "not detectable here" if is_undetectable else ""
        span = f"{short_number(low)} to {short_number(high)}" if fitting else "-"
        smallest = "-" if size is None else short_number(size)
        rows.append((effect, _acts_on(effect), smallest, "relative" if unit == "1" else pretty(unit), span, note))
    return rows


def in_words(finding: Finding) -> str:
    """Sentences on a finding."""
    text, near = finding.sentence, finding.surrogate
    if isinstance(said := finding.held_out, HeldOut):
        text += f" {SPEAKS[said.speaks]} ({said.nats:+.1f} nats)."
    if near:
        text += f" The model uses {near.effect} in its place, which improves every held-out recording."
    return text


def noise_sentence(s: Series) -> str:
    """Sentence on how the noise compares with its datasheet."""
    parts = [f"{name.replace('_', ' ')} {size:.2f}" for name, size in s.noise.items() if size is not None]
    return f"Fitted noise, relative to its datasheet: {', '.join(parts)}." if parts else ""


def scatter_sentences(d: Result) -> list[str]:
    """Sentences on noise that is much larger than stated."""
    return [f"{n.sentence[0].upper()}{n.sentence[1:]}." for n in d.scatter]


def reference_faults(d: Result) -> list[str]:
    """Words for the reference's own errors, and for effects attributed to it."""
    if isinstance(d.reference, UnsetType):
        return []
    # Without a deviation: counted, not fitted.
    shown = {n: with_sigma(f.value, f.std, f.unit) if f.std else f"{f.value:.3g}" for n, f in d.reference.items()}
    return [FAULTS[name].format(size) for name, size in shown.items() if name in FAULTS]


def next_drive_sentences(d: Result) -> list[str]:
    """Sentences on the next drive and its purpose."""
    drive = d.next_drive
    if drive is None:
        return ["There is no open question that another drive would answer."]
    if drive.sentence:
        return [drive.sentence]
    pairs = listed(listed(group, "from") for group in drive.separates)
    tells = f", to distinguish {pairs}" if pairs else ""
    manoeuvre = drive.manoeuvre
    return [f"{manoeuvre[0].upper()}{manoeuvre[1:]}, for {drive.minutes:.3g} minutes{tells}."]


def segment_rows(drive: NextDrive) -> list[tuple[str, str, str]]:
    """Rows under SEGMENT_HEADER: the standstill, and each manoeuvre."""
    stand = [("standing still", "-", f"{drive.stand_s / 60.0:.1f}")] if drive.stand_s else []
    return [*stand, *((s.manoeuvre, str(s.laps), f"{s.minutes:.1f}") for s in drive.segments)]


def settled_rows(drive: NextDrive) -> list[tuple[str, str, str]]:
    """Rows under SETTLED_HEADER: each open question, and all that the drive is for."""
    rows = [(listed(q.names, "or"), f"{q.probability:.2f}", f"{q.nats:.1f}") for q in drive.questions]
    if len(drive.separates) > 1 and drive.probability is not None:
        rows.append((f"all {len(drive.separates)} together", f"{drive.probability:.2f}", "-"))
    return rows


def picture_caption(curve: Mismatch | None, evidence: Gain, is_shaded: bool) -> str:
    """Caption of a finding's picture."""
    parts = []
    if curve is not None and curve.y.size:
        parts.append("Mismatch with the nominal model, by place. Paler is less certain; the path is grey.")
    elif curve is not None:
        fitted = ", with the fitted effect" if curve.fit_x.size else ", as a smooth curve"
        parts.append(f"Mismatch with the nominal model against its covariate{fitted}.")
    if evidence.time_s.size:
        parts.append(
            "Cumulative evidence, with all other effects held fixed: where it rises, the data support the effect."
        )
    if is_shaded:
        parts.append("Shaded: when the effect acts.")
    return " ".join(parts)


def fit_rows(d: Result) -> list[tuple[str, ...]]:
    """Rows under FIT_HEADER: each figure of the fitted data that is a number, before and after."""
    before, after = d.fit.train.before, d.fit.train.after
    rows: list[tuple[str, ...]] = []
    for key, value in before.items():
        name, _, unit = key.rpartition("_")
        unit = unit if unit in UNITS else ""
        rows.append((*named_quantity(name if unit else key, unit), *_numbers(value, after.get(key))))
    return rows


def held_out_rows(bars: Iterable[Bar]) -> list[tuple[str, ...]]:
    """Rows under HELD_OUT_HEADER."""
    return [(b.name, *named_quantity(b.quantity, b.unit), *_numbers(b.before, b.after)) for b in bars]


def _numbers(*values: float | None) -> list[str]:
    return ["-" if v is None else f"{v:.3g}" for v in values]


def named_quantity(name: str, unit: str) -> tuple[str, str]:
    """Name and unit of a figure as humans write them; the name may end in the unit."""
    words = name.removesuffix(f"_{unit}").replace("_", " ")
    return words, "" if unit == "1" else pretty({"percent": "%"}.get(unit, unit))


def short_number(value: float) -> str:
    """A number with two digits, or all before the point."""
    return f"{value:.0f}" if 100.0 <= abs(value) < 1e6 else f"{value:.2g}"


def rms(values: Array) -> float | None:
    """Root mean square of the finite values; None if there is none."""
    known = [float(v) ** 2 for v in values if math.isfinite(v)]
    return math.sqrt(sum(known) / len(known)) if known else None


def listed(words: Iterable[str], last: str = "and") -> str:
    """Join words: one, two and three."""
    all_words = list(words)
    return f" {last} ".join([", ".join(all_words[:-1]), all_words[-1]] if len(all_words) > 1 else all_words)


def percent(share: float) -> str:
    """A share in per cent, with two digits below ten."""
    return f"{100.0 * share:.2g} %" if abs(share) < 0.0995 else f"{100.0 * share:.0f} %"


def length(metres: float) -> str:
    """A length, in cm if it is small."""
    return f"{metres:.2g} m" if abs(metres) >= 0.995 else f"{100.0 * metres:.2g} cm"


def power(value: float) -> str:
    """A number, large ones as powers of ten."""
    if value >= MOST:
        return f"over 10{_raised(100)}"
    return f"{value:.3g}" if value < 1e4 else f"10{_raised(math.floor(math.log10(value)))}"


def pretty(unit: str) -> str:
    """A unit as humans write it."""
    return unit.replace("degC", "°C").replace("^-2", "⁻²").replace("^2", "²")


def _raised(exponent: int) -> str:
    return str(exponent).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def _acts_on(effect: str) -> str:
    known = catalogue().get(effect)
    return known.channel if known else "-"


def _place(effect: str) -> int:
    names = list(catalogue())
    return names.index(effect) if effect in names else len(names)
