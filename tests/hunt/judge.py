"""A genome's drive through the daemon's pipeline, and what is wrong with the poses."""

import math
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
import numpy.typing as npt
from msgspec import Struct
from msgspec.structs import replace as changed

from drd.arrays import Array
from drd.pipeline import Pipeline
from drd.ports.clock import TICK_S
from drd.samples import Pose, Validity
from drd.units import NS_PER_S, RAD_PER_DEG
from hunt.genome import Event, Genome
from hunt.kinds import KINDS
from hunt.world import EPOCH_NS, GYRO_DELAY_S, World, monotonic_ns

# Half-width of the 99 % interval of a Gaussian heading in its standard deviations: no bound of it is published.
HEADING_SIGMAS: Final = 2.5758293035489004
# Smaller errors, and jumps, are no lie that matters to a robot: some wheel counts, and a packet's rounding.
LEAST_M, LEAST_RAD = 0.01, 0.2 * RAD_PER_DEG
# A pose that goes so long without a successor, while time passes and nothing is wrong, is stale.
STALE_S: Final = 1.5
# A silence must be told after so long; a pose set in a drive is as exact as this part of its standard deviation.
TOLD_S: Final = 1.5
# These come along with a sensor's bytes or frames, and not while the sensor is away.
HIDDEN: Final = {
    "garbage on the line": ("gyro silent", "gyro port lost"),
    "foreign frames": ("both counters silent", "bus lost"),
}
CERTAIN: Final = 10.0  # so many hits are expected that there is one
RETRIES: Final = 2


class Found(Struct, frozen=True):
    """`position`, `heading`: largest error over bound in valid rows; `score` the larger, the median of three seeds
    where it is above 1. `rows` valid ones, of which `beyond` are beyond a bound. `jump`: largest step of the error
    between two valid poses, over the bound before. `wrong`: NaN, crashes, silences. `seen`: reasons and counters.
    """

    position: float = 0.0
    heading: float = 0.0
    score: float = 0.0
    at_s: float = 0.0
    rows: int = 0
    beyond: int = 0
    jump: float = 0.0
    wrong: tuple[str, ...] = ()
    seen: tuple[str, ...] = ()


class _Run:
    """Feeds a pipeline and keeps what it gives, with the frame in which the truth is to be seen."""

    def __init__(self, genome: Genome):
        self.world = World(genome)
        self.pipeline = Pipeline(self.world.config, Path(), self._on_pose)
        self.poses: list[Pose] = []
        self.seen: dict[str, float] = {}
        self.frames: list[tuple[int, Array]] = [(0, np.zeros(3))]  # from which pose on, and its origin
        self._random = np.random.default_rng([genome.seed, 20])
        self._stalls = [e for e in genome.events if e.kind == "host stands still"]
        self._split = genome.gene("split")

    def _on_pose(self, pose: Pose, _: int) -> None:
        self.poses.append(pose)

    def run(self) -> None:
        ports = self._port_states()
        due_s = 0.0
        for t_s, content in [*self.world.items, (self.world.seconds, None)]:
            while due_s <= t_s:
                while ports and ports[0][0] <= due_s:
                    self.pipeline.port_state(ports[0][1], ports[0][2], monotonic_ns(due_s))
                    ports.pop(0)
                if not any(self.world.at_s(e) <= due_s < self.world.at_s(e) + e.seconds for e in self._stalls):
                    self.pipeline.tick(monotonic_ns(due_s))
                    for reason in self.pipeline.reasons.active():
                        self.seen.setdefault(reason.source, due_s)
                due_s += TICK_S
            if content is not None:
                self._give(t_s, content)
        health = self.pipeline.health(monotonic_ns(self.world.seconds))
        msgspec.json.encode(health)
        for part, counters in health["counters"].items():
            self.seen.update({f"{part}.{name}": 0.0 for name, count in counters.items() if count})

    def _port_states(self) -> list[tuple[float, str, str | None]]:
        found: list[tuple[float, str, str | None]] = []
        for e in self.world.genome.events:
            if e.kind in {"bus lost", "gyro port lost"}:
                source = "encoders.port" if e.kind == "bus lost" else "fog.port"
                begin_s = self.world.at_s(e)
                found += [(begin_s, source, "lost: a test"), (begin_s + e.seconds, source, None)]
        return sorted(found, key=lambda row: row[0])

    def _give(self, t_s: float, content: Any) -> None:
        now_ns = monotonic_ns(t_s)
        if isinstance(content, list):
            self.pipeline.on_frames(content)
        elif isinstance(content, Event):
            self._command(content, now_ns)
        elif self._split and len(content) > 1:
            cut = len(content) // 2
            self.pipeline.on_fog_bytes(content[:cut], now_ns)
            self.pipeline.on_fog_bytes(content[cut:], now_ns + 1_000_000)
        else:
            self.pipeline.on_fog_bytes(content, now_ns)

    def _command(self, event: Event, now_ns: int) -> None:
        """A pose that is set is the newest one's, which is what the daemon takes it for."""
        if event.kind == "calibrate_bias":
            self.pipeline.calibrate_bias(now_ns)
            return
        if not self.poses:
            return
        here = self.world_pose(np.array([self.poses[-1].t_ns]))[0]
        if event.kind == "reset":
            self.pipeline.reset(now_ns)
            self.frames.append((len(self.poses), here))
        else:
            sigmas = np.array([event.size, event.size, 0.1 * event.size])
            set_to = seen_from(here[None], self.frames[-1][1])[0] + sigmas * self._random.standard_normal(3)
            x, y, heading = set_to.tolist()
            self.pipeline.set_pose(now_ns, x, y, heading, event.size, 0.1 * event.size)
            self.frames.append((len(self.poses), self.frames[-1][1]))

    def world_pose(self, t_ns: Array) -> Array:
        """Truth at these times, shape (n, 3)."""
        t_s = (t_ns - EPOCH_NS) / NS_PER_S
        return np.column_stack([np.interp(t_s, self.world.time_s, row) for row in self.world.truth.T])

    def errors(self) -> tuple[Array, Array]:
        """Vectors of the position error, shape (n, 2), and those of the heading, (n,)."""
        true = self.world_pose(np.array([pose.t_ns for pose in self.poses]))
        for (begin, origin), end in zip(self.frames, [b for b, _ in self.frames[1:]] + [len(true)], strict=True):
            true[begin:end] = seen_from(true[begin:end], origin)
        own = np.array([(pose.x_m, pose.y_m, pose.heading_rad) for pose in self.poses])
        turned = own[:, 2] - true[:, 2]
        return own[:, :2] - true[:, :2], turned - 2.0 * math.pi * np.round(turned / (2.0 * math.pi))

    def unseen(self) -> npt.NDArray[np.bool_]:
        """Poses of the time between an event's begin and the arrival of the first sample of the gyro that is all after
        it: no sensor could know.
        """
        t_s = np.array([(pose.t_ns - EPOCH_NS) / NS_PER_S for pose in self.poses])
        arrivals = np.array([at_s for at_s, content in self.world.items if isinstance(content, bytes)])
        late_s = 1.0 / self.world.config.fog.rate_hz + GYRO_DELAY_S - min(self.world.genome.gene("wheel_lag_s"), 0.0)
        found = np.zeros(len(t_s), bool)
        for e in self.world.genome.events:
            if KINDS[e.kind].unseen:
                begin_s = self.world.at_s(e)
                whole = arrivals[arrivals > begin_s + late_s]
                found |= (t_s > begin_s) & (t_s < whole.min(initial=self.world.seconds))
        return found


def seen_from(poses: Array, origin: Array) -> Array:
    """Poses, shape (n, 3), as they look from another one."""
    c, s, d = math.cos(origin[2]), math.sin(origin[2]), poses - origin
    return np.column_stack([c * d[:, 0] + s * d[:, 1], -s * d[:, 0] + c * d[:, 1], d[:, 2]])


def once(genome: Genome) -> Found:
    """Drive it with its own seed."""
    run = _Run(genome)
    try:
        run.run()
    except Exception as error:  # whatever it is, the daemon would have ended
        return Found(wrong=(f"crash: {type(error).__name__}: {error}",))
    if not run.poses:
        return Found(wrong=("no pose",), seen=tuple(sorted(run.seen)))
    numbers = np.array(
        [(p.x_m, p.y_m, p.heading_rad, p.speed_m_s, p.rate_rad_s, p.speed_sigma_m_s, p.rate_sigma_rad_s, *p.covariance,
          p.position_bound_m) for p in run.poses])  # fmt: skip
    if not np.isfinite(numbers).all():
        return Found(wrong=("not finite",), seen=tuple(sorted(run.seen)))
    return _judged(run, numbers)


def _judged(run: _Run, numbers: Array) -> Found:
    position, heading = run.errors()
    error_m, error_rad = np.hypot(*position.T), abs(heading)
    bound_m, bound_rad = numbers[:, -1], HEADING_SIGMAS * np.sqrt(np.maximum(numbers[:, -2], 0.0))
    valid = np.array([pose.validity is Validity.VALID for pose in run.poses]) & ~run.unseen()
    # Errors that are too small to matter are none; a bound of 0 is taken for the least.
    ratio_m = np.where(valid & (error_m > LEAST_M), error_m / np.maximum(bound_m, 1e-3), 0.0)
    ratio_rad = np.where(valid & (error_rad > LEAST_RAD), error_rad / np.maximum(bound_rad, 1e-4), 0.0)
    both = np.maximum(ratio_m, ratio_rad)
    commanded = np.zeros(len(valid), bool)
    commanded[[i for i, _ in run.frames if i < len(valid)]] = True
    quiet = valid[1:] & valid[:-1] & ~commanded[1:]
    step_m = np.hypot(*np.diff(position, axis=0).T)
    step_rad = abs(np.diff(heading))
    jumps = np.maximum(step_m / (bound_m[:-1] + LEAST_M), step_rad / (bound_rad[:-1] + LEAST_RAD)) * quiet
    worst = int(both.argmax())
    return Found(
        position=float(ratio_m.max()),
        heading=float(ratio_rad.max()),
        score=float(both.max()),
        at_s=float((run.poses[worst].t_ns - EPOCH_NS) / NS_PER_S - run.world.at_s(Event("", 0.0, 0.0))),
        rows=int(valid.sum()),
        beyond=int((both > 1.0).sum()),
        jump=float(jumps.max(initial=0.0)),
        wrong=tuple(_silences(run, numbers)),
        seen=tuple(sorted(run.seen)),
    )


def _silences(run: _Run, numbers: Array) -> list[str]:
    found = []
    if any(pose.validity is not Validity.VALID and not pose.reasons for pose in run.poses):
        found.append("degraded without a reason")
    if (numbers[:, -1] < 0.0).any() or (numbers[:, [7, 10, 12]] < 0.0).any():
        found.append("negative variance")
    times = np.array([pose.t_ns for pose in run.poses])
    if (np.diff(times) < 0).any():
        found.append("time runs backward")
    stalls = [e for e in run.world.genome.events if e.kind == "host stands still"]
    patience_s = STALE_S + max(run.world.config.fog.silent_after_s, run.world.config.encoders.silent_after_s)
    if not stalls and np.diff(times).max(initial=0) > patience_s * NS_PER_S:
        found.append("no pose for long")
    if not stalls:
        for e in run.world.genome.events:
            traces = KINDS[e.kind].traces
            lasting_s = min(e.seconds, run.world.seconds - run.world.at_s(e))
            lasts = lasting_s > TOLD_S + _patience_s(run, traces)
            if KINDS[e.kind].unit == "of them":
                lasts &= e.size * lasting_s * run.world.config.fog.rate_hz > CERTAIN
            is_one = e.kind == "one counter silent" and run.world.genome.gene("encoders.layout") == "agilex"
            is_hidden = any(other.kind in HIDDEN.get(e.kind, ()) for other in run.world.genome.events)
            if traces and lasts and not is_one and not is_hidden and not any(trace in run.seen for trace in traces):
                found.append(f"nothing tells of: {e.kind}")
    return found


def _patience_s(run: _Run, traces: tuple[str, ...]) -> float:
    """How long a silence is as usual."""
    config = run.world.config
    return max(config.fog.silent_after_s if "fog" in traces else 0.0, config.encoders.silent_after_s)


def judge(genome: Genome) -> Found:
    """As `once`; a score above 1 is checked with other noise and another robot of the same kind, for it may be luck."""
    found = once(genome)
    if found.score <= 1.0:
        return found
    others = [once(changed(genome, seed=genome.seed + 1 + i)).score for i in range(RETRIES)]
    return changed(found, score=float(np.median([found.score, *others])))
