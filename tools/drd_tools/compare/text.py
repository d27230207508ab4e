"""A comparison in sentences and tables."""

from collections.abc import Iterator
from pathlib import Path
from typing import Final

from drd_tools.compare.results import ChannelResult, Comparison, CovariateResult

HEADER: Final = ("channel", "rms", "by noise", "in sigmas", "mean", "sum at the end", "depends on", "share")
NOISE_HEADER: Final = ("noise", "1 sigma", "from")
TEXT_COLUMNS: Final = (6,)
SMALL: Final = 1.2  # sigmas rms
WORTH_A_WORD: Final = 0.1


def rate(channel: ChannelResult) -> tuple[float, str]:
    """Factor and unit in which a channel's rates are shown."""
    return (1.0, "deg/s") if channel.unit == "deg" else (1000.0, "mm/s")


def _per(channel: ChannelResult, value: float) -> str:
    factor, unit = rate(channel)
    return f"{factor * value:.2g} {unit}" if abs(factor * value) < 100 else f"{factor * value:.0f} {unit}"


def _pair(value: float, sigma: float, unit: str) -> str:
    """Value and sigma with as many digits as the sigma justifies."""
    digits = 0
    while digits < 6 and 0.0 < abs(sigma) * 10**digits < 2.0:
        digits += 1
    return f"{round(value, digits) + 0.0:+.{digits}f} ± {sigma:.{digits}f} {unit}"


def rows(c: Comparison) -> list[tuple[str, ...]]:
    """Rows of HEADER, one per channel."""
    return [
        (
            ch.title,
            _per(ch, ch.rms),
            _per(ch, ch.expected),
            f"{ch.ratio:.1f}",
            _pair(rate(ch)[0] * ch.mean, rate(ch)[0] * ch.mean_sigma, rate(ch)[1]),
            _pair(ch.end, ch.end_sigma, ch.unit),
            {"nothing": "nothing beyond noise", "more": "more than noise"}.get(ch.verdict, " or ".join(ch.named)),
            f"{ch.covariate(ch.named[0]).share:.2f}" if ch.named else "",
        )
        for ch in c.channels
    ]


def lead(c: Comparison) -> Iterator[str]:
    """Sentences on the data compared, and a summary of the result."""
    turned = f" and {c.turn_deg:.0f} deg of turning" if c.turn_deg >= 1.0 else ""
    yield (
        f"{Path(c.recording).name}: {c.duration_s:.0f} s, {c.way_m:.1f} m{turned}. The nominal model was simulated "
        f"along the best path by {c.path}; the mismatch is recorded minus simulated, in {len(c.time_s)} blocks of "
        f"{c.block_s:.3g} s."
    )
    beyond = [ch for ch in c.channels if ch.verdict != "nothing"]
    if not beyond:
        where = "the only channel" if len(c.channels) == 1 else f"all {len(c.channels)} channels"
        yield f"Nothing beyond noise in {where}: the nominal model explains what was recorded."
        return
    named, unnamed = ([ch for ch in beyond if bool(ch.named) is is_named] for is_named in (True, False))
    for begin, group in (
        ("Beyond noise", [ch for ch in named if not is_small(ch)]),
        ("No larger than noise, but not random", [ch for ch in named if is_small(ch)]),
        ("Beyond noise, but no covariate explains it significantly", [ch for ch in unnamed if ch.covariates]),
        ("Beyond noise, in too few blocks to identify a covariate", [ch for ch in unnamed if not ch.covariates]),
    ):
        if group:
            told = (ch.title + (f" (with {' or '.join(ch.named)})" if ch.named else "") for ch in group)
            yield f"{begin}: {', '.join(told)}."
    rest = [ch.title for ch in c.channels if ch.verdict == "nothing"]
    if rest:
        yield f"Nothing beyond noise: {', '.join(rest)}."


def is_small(ch: ChannelResult) -> bool:
    """Whether a covariate predicts part of the mismatch, which yet is no larger than the stated noise."""
    return ch.verdict == "driver" and ch.ratio < SMALL


def sentence(ch: ChannelResult) -> str:
    """Describe one channel in a sentence, without a cause."""
    begin = ch.title[0].upper() + ch.title[1:]
    end = f"Its sum at the end is {_pair(ch.end, ch.end_sigma, ch.unit)} (sigma of noise alone)."
    if ch.verdict == "nothing":
        return f"{begin}: nothing beyond noise ({ch.ratio:.1f} sigmas rms). {end}"
    mean = f" Its mean is {_pair(rate(ch)[0] * ch.mean, rate(ch)[0] * ch.mean_sigma, rate(ch)[1])}."
    if ch.verdict == "more":
        nearest = ch.covariates[0] if ch.covariates else None
        what = "."
        if nearest is not None and nearest.share > WORTH_A_WORD:
            what = f"; best, but not significant: {nearest.name} (share {nearest.share:.2f}, p {nearest.p:.2g})."
        return f"{begin}: {ch.ratio:.1f} sigmas rms, more than noise{what}{mean} {end}"
    best = ch.covariate(ch.named[0])
    others = "".join(f", or equally on {name} ({ch.covariate(name).share:.2f})" for name in ch.named[1:])
    left = f"The curve leaves {best.left:.1f} of {ch.ratio:.1f} sigmas rms."
    size = "no larger than noise, but " if is_small(ch) else ""
    return (
        f"{begin}: {size}the mismatch depends on {best.name} (cross-validated share {best.share:.2f}){others}. "
        f"{_range(ch, best)}{left} {end}"
    )


def _range(ch: ChannelResult, d: CovariateResult) -> str:
    """Describe where a curve is lowest and highest."""
    factor, unit = rate(ch)
    low, high = (d.value.index(f(d.value)) for f in (min, max))

    def at(k: int) -> str:
        where = f"({d.knots[k][0]:.3g}, {d.knots[k][1]:.3g})" if d.name == "place" else f"{d.knots[k]:.3g}"
        return f"{_pair(factor * d.value[k], factor * d.sigma[k], unit)} at {where} {d.unit}"

    return f"It runs from {at(low)} to {at(high)}. "


def reference_rows(c: Comparison) -> list[list[str]]:
    """Rows of the reference's errors as estimated from each channel."""
    return [[ch.title, name, _pair(v, s, unit)] for ch in c.channels for name, v, s, unit in ch.reference]


def share_rows(c: Comparison) -> tuple[list[str], list[list[str]]]:
    """Header and rows: the share of each covariate in each channel; * marks significant ones."""
    names = list(dict.fromkeys(d.name for ch in c.channels for d in ch.covariates))
    order = [n for n in COVARIATES if n in names]
    body = [
        [
            ch.title,
            *(f"{max(ch.covariate(n).share, 0.0):.2f}{'*' if ch.covariate(n).p <= P_SHOWN else ' '}" for n in order),
        ]
        for ch in c.channels
    ]
    return ["channel", *order], body


COVARIATES: Final = ("time", "yaw rate", "yaw acceleration", "speed", "acceleration", "temperature", "heading", "place")
P_SHOWN: Final = 0.01
SHARES: Final = (
    "Share of the squared mismatch (in sigmas, about its mean) that a curve of one covariate alone predicts in blocks "
    "it was not fitted to. * p <= 0.01 over all channels and covariates together, by sign flips. The covariates of a "
    "drive are correlated: two stars in a row need not be two causes."
)
METHOD: Final = (
    "Noise alone: nominal recordings with the noise below were simulated along the same path and processed in the "
    "same way, so that it includes the noise of the reference and the smoothing of the path. The residual gyro bias "
    "after the standstill and the bias random walk are added. A reference may be late (10 ms), rotated (2 deg) or "
    "displaced to the left (5 cm; 1 sigma each): this is fitted to each channel and corrected. A channel is beyond "
    "noise if a covariate predicts it, if it is significantly above 1.5 sigmas rms (datasheets may be 30 % wrong), or "
    "if its mean is above 4 sigmas. A longitudinal displacement of the reference looks like a robot that turns about "
    "another point: both show as a lateral mismatch that depends on the yaw rate."
)
