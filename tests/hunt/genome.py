"""A drive as a genome: the robot, its configuration, what it does and what befalls it; all else comes from the seed."""

import math
from dataclasses import replace
from random import Random
from typing import Any, Final

from msgspec import Struct
from msgspec.structs import replace as changed

from drd.config import keys
from drd.config.keys import Config
from drd.units import RAD_PER_DEG
from hunt.kinds import (
    AWAY,
    GYRO,
    JUMPS,
    KINDS,
    MOMENTS,
    NO_GYRO,
    SIDEWAYS,
    SLIP_BOTH,
    TURNS_LATE,
    UNCOMPARED,
    UNCONTRADICTED,
    UNLEARNED,
)

# Each gene's values, the usual one first. With a dot: a key of the configuration; without: of the true robot.
MENU: Final[dict[str, tuple[Any, ...]]] = {
    "skids": (False, True),
    "noise": (0.5, 0.0, 1.0),  # of what the configuration states
    "wheel_lag_s": (0.0, 0.05, 0.15, 0.3, -0.03),  # negative: the gyro is late
    "split": (False, True),  # the gyro's packets come in two parts
    "robot.drive": ("auto", "differential", "skid"),
    "fog.protocol": ("ecore", "dsp3000", "dsp17xx", "none"),
    "fog.rate_hz": (10.0, 5.0, 20.0, 50.0),
    "fog.full_scale_deg_s": (100.0, 40.0),  # less than some drives turn
    "fog.silent_after_s": (0.5, 2.0),
    "encoders.layout": ("cia406", "agilex", "odrive", "vesc"),
    "encoders.rate_hz": (10.0, 5.0, 20.0),
    "encoders.counts_per_revolution": (20000.0, 2000.0, 200.0),
    "encoders.gap_s": (0.5, 0.25, 2.0),
    "encoders.silent_after_s": (0.3, 1.0),
    "output.publish_on": ("wheels", "gyro"),
    "estimation.heading": ("filter", "gyro"),
    "estimation.gate_sigma": (5.0, 3.0, 6.0),
    "estimation.rejections_before_release": (3, 1, 10),
    "estimation.reorder_s": (0.25, 0.05, 1.0),
    "estimation.static_bias.duration_s": (6.0, 2.0, 0.0),
}
SPEEDS_M_S: Final = (-0.6, 1.5)
RATE_RAD_S: Final = 0.9
LEG_S: Final = (2.0, 10.0)
LONGEST_S: Final = 36.0  # a drive: longer ones cost more than they find
MOST_EVENTS: Final = 4
AROUND_S: Final = 2.0  # legs run into each other, and what an event has done is seen a little later
TEACHING_RAD: Final = 1.0  # of turning: then the tread is known to some per cent
CURVE_S: Final = 2.0  # of it teach what it shows of tread and radii
DRIFTING: Final = 0.05  # of a gyro's interval: a delay drifts that changes by less from one delivery to the next
TEACHES_TREAD: Final = ("one wheel slips", "turned by hand")  # a wrong one, in a curve
RARE: Final = 0.2  # of the draws of a kind whose class is named already are kept


class Leg(Struct, frozen=True):
    """So many seconds at that speed and yaw rate."""

    seconds: float
    speed_m_s: float
    rate_rad_s: float


class Event(Struct, frozen=True):
    """Something of KINDS from `at_s` on, for `seconds`; `side` 0 is left."""

    kind: str
    at_s: float
    seconds: float
    size: float = 1.0
    side: int = 0


def drift(intervals: float) -> float:
    """Change of the newest packet's delay from one bunch of so many intervals to the next, in intervals."""
    per_one, part = (intervals, 1.0) if intervals >= 1.0 else (1.0 / intervals, intervals)
    return abs(per_one - round(per_one)) * part


class Genome(Struct, frozen=True):
    """`genes`: what is not as usual in MENU."""

    seed: int
    genes: dict[str, Any]
    legs: tuple[Leg, ...]
    events: tuple[Event, ...] = ()

    def gene(self, name: str) -> Any:
        return self.genes.get(name, MENU[name][0])

    @property
    def seconds(self) -> float:
        return sum(leg.seconds for leg in self.legs)

    @property
    def named(self) -> frozenset[str]:
        """Classes of what no sensor could know."""
        kinds = {event.kind for event in self.events}
        alone = any(event.kind in UNCONTRADICTED and self._without_gyro(event) for event in self.events)
        jumps = "node restarts" in kinds and self.gene("encoders.layout") != "cia406"  # which alone tells of it
        slips = self.gene("estimation.heading") == "gyro" and "one wheel slips" in kinds
        early = any(event.kind in TEACHES_TREAD and self._without_tread(event) for event in self.events)
        # Without numbers of its packets a gyro that has begun anew looks like one whose delay drifts by an interval.
        numbered, rate_hz = self.gene("fog.protocol") == "dsp17xx", self.gene("fog.rate_hz")
        drifts = any(e.kind == "gyro in bunches" and drift(e.size * rate_hz) < DRIFTING for e in self.events)
        lost, stalls = (
            [e for e in self.events if e.kind == kind] for kind in ("gyro packets lost", "host stands still")
        )
        # Where in the wait a packet is missing, and that one is, the beat alone tells, once it goes on.
        drifts |= any(max(a.at_s, b.at_s) < min(a.at_s + a.seconds, b.at_s + b.seconds) for a in lost for b in stalls)
        others = [TURNS_LATE] * (drifts and not numbered)
        others += [NO_GYRO] * alone + [JUMPS] * jumps + [UNCOMPARED] * slips + [UNLEARNED] * early
        return frozenset([KINDS[kind].named for kind in kinds] + others) - {""}

    def _without_tread(self, event: Event) -> bool:
        """Whether any tread explains the event: the robot turns in it, and has hardly turned with a gyro before.
        Or it has turned without one, and with one driven one curve only, which tread and radii explain together.
        """
        if self.gene("robot.drive") == "differential":
            return False
        turned_rad, unseen_rad, at_s, turns, curves = 0.0, 0.0, 0.0, False, set[float]()
        away = [(e.at_s, e.at_s + e.seconds) for e in self.events if e.kind in AWAY]
        full_rad_s = self.gene("fog.full_scale_deg_s") * RAD_PER_DEG
        for leg in self.legs:
            until_s = min(at_s + leg.seconds, event.at_s)
            unseen_s = sum(max(min(end_s, until_s) - max(begin_s, at_s), 0.0) for begin_s, end_s in away)
            seen_s = max(until_s - at_s - unseen_s, 0.0)
            if abs(leg.rate_rad_s) > full_rad_s:
                unseen_s, seen_s = unseen_s + seen_s, 0.0
            turned_rad += abs(leg.rate_rad_s) * seen_s
            unseen_rad += abs(leg.rate_rad_s) * unseen_s
            if seen_s > CURVE_S:
                curves.add(math.atan2(leg.rate_rad_s, leg.speed_m_s))
            turns |= leg.rate_rad_s != 0.0 and at_s < event.at_s + event.seconds and event.at_s < at_s + leg.seconds
            at_s += leg.seconds
        return (turns and turned_rad < TEACHING_RAD) or (unseen_rad > TEACHING_RAD and len(curves) < 2)

    def _without_gyro(self, event: Event) -> bool:
        """Whether there may be no gyro while the event lasts: none at all, none that is heard, or beyond its range."""
        if self.gene("fog.protocol") == "none":
            return True
        begin_s, end_s = event.at_s - AROUND_S, event.at_s + event.seconds + AROUND_S
        if any(e.kind in AWAY and e.at_s < end_s and begin_s < e.at_s + e.seconds for e in self.events):
            return True
        by_hand_rad_s, at_s = event.size * RAD_PER_DEG if event.kind == "turned by hand" else 0.0, 0.0
        full_rad_s = self.gene("fog.full_scale_deg_s") * RAD_PER_DEG
        for leg in self.legs:
            if (
                at_s < end_s
                and begin_s < at_s + leg.seconds
                and max(abs(leg.rate_rad_s + by_hand_rad_s), abs(leg.rate_rad_s)) > 0.95 * full_rad_s
            ):
                return True
            at_s += leg.seconds
        return False

    def config(self) -> Config:
        """What the robot's engineer has written."""
        parts: dict[str, dict[str, Any]] = {}
        for path in MENU:
            if "." in path:
                part, _, key = path.rpartition(".")
                parts.setdefault(part, {})[key] = self.gene(path)
        bias = keys.StaticBias(minimum_s=1.0, **parts["estimation.static_bias"])
        robot = keys.Robot(wheel_radius_m=0.11, tread_m=0.6, **parts["robot"])
        return Config(
            robot=robot,
            fog=keys.Fog(latency_s=0.009, **parts["fog"]),
            encoders=keys.Encoders(modulus_counts=65536 if self.gene("encoders.layout") == "cia406" else None,
                pair_window_s=0.04, **parts["encoders"]),
            estimation=replace(keys.Estimation(static_bias=bias), **parts["estimation"]),
            output=keys.Output(**parts["output"]),
        )  # fmt: skip

    def text(self) -> str:
        """One line for people."""
        events = [
            f"{e.kind}{f' {e.size:.3g} {KINDS[e.kind].unit}'.rstrip() if KINDS[e.kind].unit or e.size != 1.0 else ''}"
            f"{(' left', ' right')[e.side] if KINDS[e.kind].sided else ''} at {e.at_s:.1f} s"
            f"{'' if e.kind in MOMENTS else f' for {e.seconds:.1f} s'}"
            for e in self.events
        ]
        legs = " ".join(f"{leg.seconds:.0f}s@{leg.speed_m_s:.1f},{leg.rate_rad_s:+.2f}" for leg in self.legs)
        genes = ", ".join(f"{name}={value}" for name, value in self.genes.items())
        return f"{'; '.join(events) or 'no event'} | {legs} | {genes or 'as usual'} | seed {self.seed}"


def _settled(genome: Genome) -> Genome:
    """Without contradictions: a robot that is not as its configuration says is no case, and usual genes go."""
    genes, legs = dict(genome.genes), []
    has_gyro = genes.get("fog.protocol") != "none"
    if genes.get("skids") and (not has_gyro or genes.get("robot.drive") == "differential"):
        genes["robot.drive"] = "skid"  # nothing could find it out
    if not has_gyro:  # nothing tells the lag: it has to be stated
        genes["wheel_lag_s"] = 0.0
        genes.pop("estimation.heading", None)
    left_s = LONGEST_S
    for leg in genome.legs:
        if left_s > 1.0:
            legs.append(changed(leg, seconds=min(leg.seconds, left_s)))
            left_s -= leg.seconds
    seconds = sum(leg.seconds for leg in legs)
    never = set() if has_gyro else set(GYRO)
    if genes.get("robot.drive") == "differential":
        never.add("other ground")  # that its tread is always the same is what this says
    if genes.get("fog.protocol") != "dsp17xx":
        never.add("gyro packets doubled")  # without a counter twice the same is no fault
    events = [e for e in genome.events if e.at_s < seconds - 0.5 and e.kind not in never]
    genes = {name: genes[name] for name in MENU if name in genes and genes[name] != MENU[name][0]}
    return Genome(genome.seed, genes, tuple(legs), tuple(sorted(events, key=lambda e: e.at_s)[:MOST_EVENTS]))


def _leg(random: Random) -> Leg:
    kind = random.random()
    speed = 0.0 if kind < 0.15 else random.uniform(*SPEEDS_M_S) if kind < 0.4 else random.uniform(0.3, SPEEDS_M_S[1])
    rate = 0.0 if kind < 0.1 or kind > 0.75 else random.uniform(-RATE_RAD_S, RATE_RAD_S)
    return Leg(round(random.uniform(*LEG_S), 1), round(speed, 2), round(rate, 2))


def _event(random: Random, seconds: float) -> Event:
    name = random.choice([name for name in KINDS if name not in {SLIP_BOTH, SIDEWAYS} or random.random() < RARE])
    kind = KINDS[name]
    size = math.exp(random.uniform(math.log(kind.low), math.log(kind.high)))
    size *= random.choice((-1.0, 1.0)) if kind.signed else 1.0
    lasting_s = 0.0 if name in MOMENTS else round(random.uniform(0.2, kind.longest_s), 1)
    return Event(name, round(random.uniform(0.5, seconds), 1), lasting_s, float(f"{size:.3g}"), random.randrange(2))


def drawn(random: Random) -> Genome:
    """A genome at random."""
    genes = {name: random.choice(values) for name, values in MENU.items() if random.random() < 0.25}
    legs = tuple(_leg(random) for _ in range(random.randint(3, 7)))
    seconds = min(LONGEST_S, sum(leg.seconds for leg in legs))
    events = tuple(_event(random, seconds) for _ in range(random.choice((0, 1, 1, 1, 2, 2, 3))))
    return _settled(Genome(random.getrandbits(32), genes, legs, events))


def bred(mother: Genome, father: Genome, random: Random) -> Genome:
    """A child: of both where they are two, and changed in one to three places. Its noise is new."""
    genes, legs, events = dict(mother.genes), list(mother.legs), list(mother.events)
    if father is not mother:
        genes = {n: (mother if random.random() < 0.5 else father).gene(n) for n in MENU}
        legs = list((mother if random.random() < 0.7 else father).legs)
        events = [e for e in (*mother.events, *father.events) if random.random() < 0.6]
    for _ in range(random.randint(1, 3)):
        place = random.random()
        if place < 0.2:
            name = random.choice(list(MENU))
            genes[name] = random.choice(MENU[name])
        elif place < 0.45 and legs:
            legs[random.randrange(len(legs))] = _leg(random)
        elif place < 0.55:
            legs.insert(random.randint(0, len(legs)), _leg(random))
        elif place < 0.65 and len(legs) > 2:
            legs.pop(random.randrange(len(legs)))
        elif place < 0.75 or not events:
            events.append(_event(random, min(LONGEST_S, sum(leg.seconds for leg in legs))))
        elif place < 0.8:
            events.pop(random.randrange(len(events)))
        else:
            i = random.randrange(len(events))
            events[i] = _nudged(events[i], random)
    return _settled(Genome(random.getrandbits(32), genes, tuple(legs), tuple(events)))


def _nudged(event: Event, random: Random) -> Event:
    """The same event at about the same time, size and duration."""
    kind = KINDS[event.kind]
    size = min(max(abs(event.size) * math.exp(random.gauss(0.0, 0.4)), kind.low), kind.high)
    seconds = min(event.seconds * math.exp(random.gauss(0.0, 0.4)), kind.longest_s)
    at_s = max(0.5, event.at_s + random.gauss(0.0, 1.5))
    return changed(event, at_s=round(at_s, 1), seconds=round(seconds, 1),
        size=float(f"{math.copysign(size, event.size):.3g}"))  # fmt: skip
