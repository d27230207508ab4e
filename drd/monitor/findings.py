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

    `effect`: its name in the catalogue, or `unknown`. `text`: what it is, for people. `also_fits`: names that the drive
    so far cannot tell from it. Probabilities are of the names; what is left to 1 is nothing's, or other names'.
    `since_m`: the distance until then. `since_std_s`: how well its begin is known. `until_ns`: its end, None: it lasts.
    `ruled_out`: names that would have shown. `settle`: the drive that would tell more.
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
    """That something is more likely there than not, while no name is sure enough for a finding.

    `text`: that, for people. `probability`: that anything is. `names`: with theirs, the likeliest first; the rest of it
    is other names'. `since_ns` and `settle`: as in Finding.
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
    """A value and its deviation in SI, in another unit."""
    value, std = value / si, std / abs(si)
    return Size(value, std, value - Z_90 * std, value + Z_90 * std, unit)


def settling(effect: Effect | None, channels: set[str]) -> str:
    """The manoeuvre that tells more of an effect, in words."""
    if len(channels) > 1:
        return "stand still for a minute: a gyro's error goes on, one of the wheels does not"
    return effect.manoeuvre if effect is not None else "the same drive again"
