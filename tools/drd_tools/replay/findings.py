"""The monitor's findings on a replay, compared with those of the live run."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import msgspec

from drd.config.keys import Config
from drd.estimation.calibration import Calibration
from drd.monitor.constants import Constants
from drd.monitor.findings import Finding, Size, Suspicion
from drd.monitor.monitor import Monitor
from drd.monitor.wear import is_wear
from drd.samples import GyroSample, WheelSample
from drd.units import S_PER_NS
from drd.wiring.samples import Samples

TOPIC = "/findings"
FIXES = ("set_pose", "reset")  # events after which the pose has changed without motion
NOT_WATCHED = "monitor: it needs samples of gyro and wheels, and no model"


class Fix(NamedTuple):
    """A pose set from outside, or a reset, with `sigma_m` = inf; see Monitor.fix."""

    t_ns: int
    x_m: float
    y_m: float
    sigma_m: float


class Kept(Samples):
    """Collector of all inputs of a monitor."""

    def __init__(self) -> None:
        super().__init__()
        self.fixes: list[Fix] = []

    def event(self, name: str, now_ns: int, **values: Any) -> None:
        """Take a call of the pipeline other than a sample."""
        if name in FIXES:
            pose = {"x_m": 0.0, "y_m": 0.0, "sigma_m": math.inf} | values
            self.fixes.append(Fix(now_ns, pose["x_m"], pose["y_m"], pose["sigma_m"]))


@dataclass
class Live:
    """The live monitor in a recording: its first sample, its constants, and each list of findings that it reported.

    `starts`: number of monitors; a replay can only agree if there was exactly one.
    """

    began_ns: int | None = None
    known: Constants | None = None
    told: list[bytes] = field(default_factory=list)
    starts: int = 0

    def take(self, value: dict[str, Any]) -> None:
        """Process a message of TOPIC. Raises KeyError, TypeError or ValueError for a payload that drd did not write."""
        if value.get("began_ns") is None:
            return
        if value["began_ns"] != self.began_ns:
            self.starts += 1
            self.began_ns, self.told = int(value["began_ns"]), []
            known = value.get("known")
            self.known = None if known is None else msgspec.convert(known, Constants, strict=False)
        told = bits(msgspec.convert(value["findings"], list[Finding]))
        if not self.told or self.told[-1] != told:
            self.told.append(told)


def bits(findings: Sequence[Finding]) -> bytes:
    """Encode findings so that two lists are equal only if they agree in every bit, leaving out those on wear."""
    return msgspec.json.encode([f for f in findings if not is_wear(f)])


@dataclass(frozen=True)
class Reported:
    """Findings and suspicion at the end, and all lists of findings during the run."""

    findings: list[Finding]
    suspected: Suspicion | None
    lists: frozenset[bytes]

    def comparison(self, live: Live) -> str:
        """Sentence on whether the live monitor reported the same."""
        if live.starts != 1:
            return "" if not live.starts else f"the live monitor began {live.starts} times: findings are not compared"
        missing = sum(told not in self.lists for told in live.told)
        if missing:
            return f"{missing} of the live monitor's {len(live.told)} lists of findings are not those of the replay"
        return f"the live monitor's {len(live.told)} lists of findings are repeated to the bit"


def monitored(
    gyro: Sequence[GyroSample],
    wheels: Sequence[WheelSample],
    config: Config,
    calibration: Calibration | None,
    live: Live | None = None,
    fixes: Sequence[Fix] = (),
) -> Reported:
    """Pass samples, each sensor's in order of time, and poses set from outside to a monitor, as the daemon does."""
    live = live or Live()
    monitor, lists, now_s = Monitor(config, live.known), set[bytes](), 0.0
    corrected = [sample if calibration is None else calibration.correct(sample) for sample in gyro]
    samples: list[Any] = sorted([*fixes, *corrected, *wheels], key=lambda s: s.t_ns)
    first = 0
    if live.began_ns is not None:  # the daemon had samples before its monitor started
        first = next((i for i, s in enumerate(samples) if s.t_ns == live.began_ns), 0)
        # An earlier sample of the other sensor may arrive later.
    for sample in samples[first:]:
        if isinstance(sample, GyroSample):
            monitor.gyro(sample)
        elif isinstance(sample, Fix):
            monitor.fix(*sample)
        else:
            monitor.wheels(sample)
        if monitor.now_s != now_s:
            now_s = monitor.now_s
            lists.add(bits(monitor.findings()))
    return Reported(monitor.findings(), monitor.suspected(), frozenset({*lists, bits([])}))


def sentences(told: Reported, zero_ns: int) -> list[str]:
    """One sentence for each finding, and one for a suspicion; at least one in total."""
    found = [] if told.findings else ["monitor: nothing is found"]
    for f in told.findings:
        sizes = [f"{n} {_text(v)}" for n, v in f.parameters.items()]
        others = f", or {', '.join(name for name, _ in f.also_fits)}" if f.also_fits else ""
        until = "" if f.until_ns is None else f" until {(f.until_ns - zero_ns) * S_PER_NS:.1f} s"
        found.append(
            f"monitor: {f.effect} with probability {f.probability:.2f}{others}; since "
            f"{max(f.since_ns - zero_ns, 0) * S_PER_NS:.1f} s (sigma {f.since_std_s:.1f}){until}, named at "
            f"{(f.named_ns - zero_ns) * S_PER_NS:.1f} s{''.join(f'; {size}' for size in sizes)}. {f.text}"
        )
    if (s := told.suspected) is not None:
        since_s = max(s.since_ns - zero_ns, 0) * S_PER_NS
        found.append(
            f"monitor: suspects something, with probability {s.probability:.2f}, since {since_s:.1f} s. {s.text}"
        )
    return found


def _text(value: Size | str) -> str:
    return (
        value
        if isinstance(value, str)
        else f"{value.value:.3g} [{value.low:.3g}, {value.high:.3g}] {value.unit}".removesuffix(" 1")
    )
