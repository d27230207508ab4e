"""Laps of each manoeuvre, simulated once without noise: their information adds up over the laps of a drive. (92)"""

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Final

import numpy as np

from drd.arrays import Array
from drd.config.robot import Robot
from drd_tools.diagnose.advise.manoeuvres import MANOEUVRES, Part, drive, lap_s
from drd_tools.diagnose.advise.separation import Layout, Named, columns_of
from drd_tools.diagnose.error_model.path import Path
from drd_tools.diagnose.observe.evidence import Evidence, Noise, gather
from drd_tools.diagnose.regression.problem import Problem
from drd_tools.diagnose.select.search import Found
from drd_tools.diagnose.select.splines import CHANNELS
from drd_tools.diagnose.selected import Selected
from drd_tools.simulate.conditions import PERFECT, Reference
from drd_tools.simulate.robot import DEFAULT
from drd_tools.simulate.simulator import simulate

LONGEST_S: Final = 360.0  # of a drive that somebody will make, besides its standstill
MOST_PARTS: Final = 3  # manoeuvres in a drive that somebody will remember
SHARES_OF_ENDS: Final = (1 / 3, 2 / 3, 1.0)  # of the longest; each is simulated separately, since the last fix moves
LONGEST_STAND_S: Final = 30.0  # of the standstill at the start, otherwise as in the recording
# Higher rates add no information on slower effects; noise is scaled to keep the information per second.
FIX_S: Final = 0.5
GYRO_HZ: Final = 10.0
SLOW_GYRO_HZ: Final = 2.0  # if all effects in question are slow
SLOW: Final = ("temperature", "temperature_rate", "time")  # covariates that no manoeuvre changes
RAREST_FIX_S: Final = 60.0  # a sparser reference is treated as one at the ends only


class Laps:
    """Products of the columns of each manoeuvre, for each number of laps, and of the standstill before them.

    `parts` (k,): manoeuvres and laps; `products` (k, p, p); `standing` (p, p). `add_up`: whether parts may be combined.
    """

    def __init__(self, found: Found, nominal: Robot, asked: Sequence[Named]):
        e = found.problem.evidence
        self.others = [c for c in found.fit.selection if c.begin_s is None]
        self._causes = list({id(c): c for c in (*asked, *self.others)}.values())
        slow = [_is_slow(c) for c in asked]
        self._robot = _robot(e, nominal, SLOW_GYRO_HZ if all(slow) else GYRO_HZ)
        self._noise, self._reference = _thinned(found.problem.noise, kind_of_reference(e))
        self._recorded = found.problem
        is_of_ends = self._reference.period_s is None and bool(len(e.fix))
        # Effects that depend on the time, or drives with fixes only at the ends, do not add up.
        self.add_up = not is_of_ends and not any(_is_timed(c) for c in asked)
        self.layout = Layout(range(0), {})
        self.parts: list[Part] = []
        products: list[Array] = []
        for name in (n for n, m in MANOEUVRES.items() if any(slow) or not m.cold):
            most = max(1, int(LONGEST_S / lap_s(name)))
            if is_of_ends:
                counts = sorted({max(1, round(share * most)) for share in SHARES_OF_ENDS})
                made = [self._of_laps(Part(name, count))[-1] for count in counts]
            else:
                counts, made = list(range(1, most + 1)), self._of_laps(Part(name, most))
            self.parts += [Part(name, count) for count in counts]
            products += made
        self.products: Array = np.array(products)

    @property
    def stand_s(self) -> float:
        """Duration of the standstill before a drive."""
        return self._robot.standstill_at_start_s

    def drives(self) -> Iterator[tuple[Part, ...]]:
        """Each manoeuvre alone, and, if they add up, sequences of several, up to LONGEST_S."""
        names = list(dict.fromkeys(part.manoeuvre for part in self.parts))
        for count in range(1, MOST_PARTS + 1 if self.add_up else 2):
            for chosen in itertools.combinations(names, count):
                for parts in itertools.product(*([p for p in self.parts if p.manoeuvre == name] for name in chosen)):
                    if count == 1 or sum(p.laps * lap_s(p.manoeuvre) for p in parts) <= LONGEST_S:
                        yield parts

    def _of_laps(self, part: Part) -> list[Array]:
        """Products after each lap of a manoeuvre; those of the standstill are stored separately."""
        recorded = self._recorded
        knows_temperature = bool(np.isfinite(recorded.evidence.temperature_c).any())
        has_wheels = recorded.evidence.has_wheels
        evidence, path = driven((part,), self._robot, self._reference, knows_temperature, has_wheels)
        problem = Problem(evidence, path, self._noise, inflation=recorded.inflation.of_another_drive())
        columns, self.layout = columns_of(problem, self._causes)
        lap = np.ceil((problem.row_time_s - self.stand_s) / lap_s(part.manoeuvre))
        rows = [columns[np.clip(lap, 0, part.laps) == i] for i in range(part.laps + 1)]
        self.standing, *of_laps = (r.T @ r for r in rows)
        return list(np.cumsum(of_laps, axis=0))


@lru_cache(maxsize=64)
def driven(
    parts: tuple[Part, ...], nominal: Robot, reference: Reference, knows_temperature: bool, has_wheels: bool
) -> tuple[Evidence, Path]:
    """Simulate a drive with perfect sensors: their evidence, and the true path."""
    truth = drive(parts, nominal.standstill_at_start_s)
    recording = simulate(truth, nominal, (), replace(PERFECT, reference=reference)).recording
    e = gather(recording if has_wheels else replace(recording, wheels=None))
    if not knows_temperature:
        e = replace(e, temperature_c=np.full(len(e.time_s), np.nan))
    edges_s = e.edges_s
    pose = [np.interp(edges_s, truth.time_s, a) for a in (truth.x_m, truth.y_m, truth.heading_rad)]
    return e, Path(np.column_stack(pose))


def kind_of_reference(e: Evidence) -> Reference:
    """The recording's kind of reference."""
    if not len(e.fix):
        return Reference(is_there=False)
    period_s = round(float(np.median(np.diff(e.fix_time_s))), 2) if len(e.fix) > 2 else math.inf
    return Reference(period_s=period_s if period_s <= RAREST_FIX_S else None)


def _robot(e: Evidence, nominal: Robot, rate_hz: float) -> Robot:
    """The simulated robot: with the recording's sensors, at sufficient rates."""
    rate_hz = min(nominal.gyro_rate_hz or GYRO_HZ, rate_hz)
    nominal = replace(nominal, standstill_at_start_s=min(nominal.standstill_at_start_s, LONGEST_STAND_S))
    nominal = nominal.without_gyro() if e.gyro_rad is None else replace(nominal, gyro_rate_hz=rate_hz)
    if e.has_wheels:
        return nominal
    radius_m, counts = DEFAULT.wheel_radius_m, DEFAULT.counts_per_revolution  # arbitrary
    return replace(nominal, wheel_radius_m=radius_m, counts_per_revolution=counts, tread_m=DEFAULT.tread_m)


def _thinned(noise: Noise, reference: Reference) -> tuple[Noise, Reference]:
    """Thin out fixes to FIX_S, with correspondingly less noise."""
    if reference.period_s is None or reference.period_s >= FIX_S:
        return noise, reference
    share = math.sqrt(FIX_S / reference.period_s)
    noise = replace(noise, position_m=noise.position_m / share, heading_rad=noise.heading_rad / share)
    return noise, replace(reference, period_s=FIX_S)


def _is_slow(cause: Named) -> bool:
    """Whether it is an error of the gyro whose covariate no manoeuvre changes."""
    acts_on = cause.effect.channel if isinstance(cause, Selected) else CHANNELS[cause.channel].acts_on
    return acts_on == "gyro" and _covariate(cause) in SLOW


def _is_timed(cause: Named) -> bool:
    """Whether its effect depends on the time of a manoeuvre within the drive."""
    return _covariate(cause) in SLOW or (isinstance(cause, Selected) and cause.begin_s is not None)


def _covariate(cause: Named) -> str:
    return cause.effect.covariate if isinstance(cause, Selected) else cause.covariate
