"""Findings of the monitor, for those who read them."""

from typing import Final

from msgspec import Struct

from drd.effects.effect import Effect

Z_90: Final = 1.6448536269514722  # two-sided 90 %


class Size(Struct, frozen=True):
    """A parameter in the catalogue's unit, with the 90 % interval."""

    value: float
    std: float
    low: float
    high: float
    unit: str


class Finding(Struct, frozen=True, kw_only=True):
    """An effect that the monitor names.

    `effect`: its name in the catalogue, or `unknown`. `text`: a sentence for people. `also_fits`: names that the drive
    so far cannot distinguish from it. Probabilities are of the names; the rest to 1 is that of no effect or of others.
    `since_m`: distance until the onset. `since_std_s`: deviation of the onset. `until_ns`: its end, None: it lasts.
    `ruled_out`: names that would have shown. `settle`: the drive that would decide.
    """

    effect: str
    text: str
    parameters: dict[str, Size | str]
    probability: float
    also_fits: tuple[tuple[str, float], ...]
    since_ns: int
    since_std_s: float
    since_m: float
    until_ns: int | None
    named_ns: int
    ruled_out: tuple[str, ...]
    settle: str


class Suspicion(Struct, frozen=True, kw_only=True):
    """An effect that is more likely than not, while no name is certain enough for a finding.

    `text`: a sentence for people. `probability`: that there is any effect. `names`: with their probabilities, the
    likeliest first; the rest is that of other names. `since_ns` and `settle`: as in Finding.
    """

    text: str
    probability: float
    names: tuple[tuple[str, float], ...]
    since_ns: int
    since_std_s: float
    since_m: float
    settle: str


class NotObservable(Struct, frozen=True):
    """An effect that gyro and wheels alone do not show, and why."""

    effect: str
    because: str


def size(value: float, std: float, si: float, unit: str) -> Size:
    """Convert a value and its deviation from SI to another unit."""
    value, std = value / si, std / abs(si)
    return Size(value, std, value - Z_90 * std, value + Z_90 * std, unit)


def settling(effect: Effect | None, channels: set[str]) -> str:
    """Name the manoeuvre that tells more about an effect."""
    if len(channels) > 1:
        return "stand still for a minute: a gyro's error goes on, one of the wheels does not"
    return effect.manoeuvre if effect is not None else "the same drive again"
