"""Forms that the contact of wheels and ground may have, judged by how they predict drives that they have not seen.

`python -m contact_forms RECORDING ...` (in tests/): recordings of one robot with a dense reference. Beside radii,
tread, the wheels' delay and the reference's lever arm, and each drive's own gyro bias and heading offset, each form is
fitted to all drives but one. Printed is what it gains in that one, in nats of 1 s increments (Student's t), and the rms
of the dead-reckoned position, by gyro and wheels and by wheels alone.
"""

import argparse
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from scipy.signal import lfilter

from drd.arrays import Array
from drd_tools.calibrate.wheels.lag import find_lag, reference_lag
from drd_tools.recordings.folder import Recording, read_recording

STEP_S: Final = 0.05
BLOCK: Final = 20  # steps of an increment of 1 s
FREEDOM: Final = 4.0  # of Student's t, since a lidar's poses jump
ROUNDS: Final = 30
SMOOTH: Final = 4  # steps on either side of a covariate
STANDING_M: Final = 0.1  # of travel, over which the reference gives the start of the drive
DELAYS_S: Final = np.arange(-0.12, 0.301, 0.02)
LAGS_S: Final = (0.0, 0.02, 0.05, 0.1, 0.15, 0.2, 0.25)
CHANNELS: Final = ("turn", "way", "side", "gyro")


@dataclass(frozen=True)
class Drive:
    """Steps of a drive, (n,) each, on one grid; speed `v`, rate `w`, acceleration `a` are the wheels' and gyro's."""

    name: str
    left_m: Array
    right_m: Array
    gyro_rad: Array | None
    turn_rad: Array
    distance_m: Array
    side_m: Array
    heading_rad: Array
    xy_m: Array
    tread_m: float
    v: Array
    w: Array
    a: Array
    beside: "tuple[Form, ...]" = ()

    @property
    def h(self) -> Array:
        """Heading in the middle of each step."""
        return 0.5 * (self.heading_rad[1:] + self.heading_rad[:-1])

    @property
    def true_turn_rad(self) -> Array:
        """The turn with which the wheels' turn is compared."""
        return self.turn_rad if self.gyro_rad is None else self.gyro_rad

    def targets(self) -> tuple[Array, ...]:
        """Target of each channel; the gyro's is reference minus gyro."""
        known = (self.true_turn_rad, self.distance_m, self.side_m)
        return known if self.gyro_rad is None else (*known, self.turn_rad - self.gyro_rad)

    def base(self, channel: int) -> list[Array]:
        """Columns of the robot's constants (radii, tread, lever arm) and of the forms `beside`."""
        turn = self.w * STEP_S
        wheels = [-self.left_m / self.tread_m, self.right_m / self.tread_m]
        constants = [wheels, [0.5 * (self.left_m + self.right_m), turn], [turn], []][channel]
        return constants + [c for of_channel, columns in self.beside if of_channel == channel for c in columns(self)]

    def own(self, channel: int) -> list[Array]:
        """Columns of the drive's own parameters: gyro bias, heading offset of the reference."""
        still = np.full_like(self.left_m, STEP_S)
        return [[] if self.gyro_rad is None else [still], [], [self.distance_m], [still]][channel]


Form = tuple[int, Callable[[Drive], list[Array]]]


def of(channel: str, rates: Callable[[Drive], Array | list[Array]]) -> Form:
    """Make a form: columns of quantities that change at these rates."""

    def columns(d: Drive) -> list[Array]:
        found = rates(d)
        return [c * STEP_S for c in (found if isinstance(found, list) else [found])]

    return CHANNELS.index(channel), columns


FORMS: Final[dict[str, Form]] = {
    "lateral slip, v w": of("side", lambda d: d.v * d.w),
    "lateral slip near the limit, v w |v w|": of("side", lambda d: d.v * d.w * np.abs(d.v * d.w)),
    "lateral slip, v^2 w": of("side", lambda d: d.v * d.v * d.w),
    "centre ahead moves with the rate, w |w|": of("side", lambda d: d.w * np.abs(d.w)),
    "centre ahead, left and right turns, |w|": of("side", lambda d: np.abs(d.w)),
    "centre ahead moves with acceleration, a w": of("side", lambda d: d.a * d.w),
    "slope, sideways": of("side", lambda d: [np.abs(d.v) * np.cos(d.h), np.abs(d.v) * np.sin(d.h)]),
    "tread grows as the turn tightens": of("turn", lambda d: d.w * np.abs(d.w) / (np.abs(d.v) + np.abs(d.w) + 1e-6)),
    "tread with speed, w |v|": of("turn", lambda d: d.w * np.abs(d.v)),
    "tread with speed, w v^2": of("turn", lambda d: d.w * d.v * d.v),
    "tread with lateral acceleration, w |v w|": of("turn", lambda d: d.w * np.abs(d.v * d.w)),
    "tread with the rate, w |w|": of("turn", lambda d: d.w * np.abs(d.w)),
    "tread of left and right turns, |w|": of("turn", lambda d: np.abs(d.w)),
    "tread with acceleration, a w": of("turn", lambda d: d.a * d.w),
    "way lost in turns, v w^2": of("way", lambda d: d.v * d.w * d.w),
    "way lost in turns, v |w|": of("way", lambda d: d.v * np.abs(d.w)),
    "centres unlike, moving with speed, v w": of("way", lambda d: d.v * d.w),
    "slip with acceleration, a |v|": of("way", lambda d: d.a * np.abs(d.v)),
    "slope, ahead": of("way", lambda d: [np.abs(d.v) * np.cos(d.h), np.abs(d.v) * np.sin(d.h)]),
    "gyro tilted on a slope, w cos 2h": of("gyro", lambda d: [d.w * np.cos(2 * d.h), d.w * np.sin(2 * d.h)]),
    "gyro's bias by heading, cos h": of("gyro", lambda d: [np.cos(d.h), np.sin(d.h)]),
    "gyro's bias by acceleration, v w": of("gyro", lambda d: d.v * d.w),
}


def blocks(values: Array) -> Array:
    """Sums over increments of 1 s."""
    count = len(values) // BLOCK
    return np.asarray(values[: count * BLOCK].reshape(count, BLOCK).sum(axis=1))


def smoothed(values: Array, half: int = SMOOTH) -> Array:
    """Running means."""
    return np.convolve(np.pad(values, half, mode="edge"), np.full(2 * half + 1, 1.0 / (2 * half + 1)), "valid")


def columns(values: Sequence[Array], rows: int) -> Array:
    """Columns of increments, (rows, k)."""
    return np.column_stack([np.zeros((rows, 0)), *map(blocks, values)])


def read_drive(recording: Recording, wheels_late_s: float) -> Drive:
    """Resample all on one grid. The reference's lag behind the gyro is the drive's own."""
    late = reference_lag(recording) if recording.fog is not None else None
    reference, log, nominal = recording.reference, recording.encoders, recording.nominal
    assert reference is not None
    reference_s, wheel_s = reference.time_s - (late.lag_s if late else 0.0), log.time_s - wheels_late_s
    times = [reference_s, wheel_s, *([recording.fog.time_s] if recording.fog else [])]
    grid = np.arange(max(t[0] for t in times), min(t[-1] for t in times), STEP_S)
    left, right = (np.diff(np.interp(grid, wheel_s, nominal.wheel_radius_m * a)) for a in recording.wheel_angles_rad())
    gyro = None
    if recording.fog is not None:
        fog = recording.fog
        gyro = np.diff(
            np.interp(grid, fog.time_s, np.cumsum(fog.rate_rad_s * np.diff(fog.time_s, prepend=fog.time_s[0])))
        )
    heading = np.interp(grid, reference_s, reference.heading_rad)
    x, y = np.interp(grid, reference_s, reference.x_m), np.interp(grid, reference_s, reference.y_m)
    c, s = np.cos(middle := 0.5 * (heading[1:] + heading[:-1])), np.sin(middle)
    turned = (right - left) / nominal.tread_m if gyro is None else gyro
    speed = smoothed(0.5 * (left + right) / STEP_S)
    return Drive(
        recording.name, left, right, gyro, np.diff(heading), np.diff(x) * c + np.diff(y) * s,
        np.diff(y) * c - np.diff(x) * s, heading, np.stack([x, y]), nominal.tread_m, speed,
        smoothed(turned / STEP_S), np.gradient(smoothed(speed), STEP_S),
    )  # fmt: skip


def student(X: Array, y: Array) -> tuple[Array, float]:
    """Fit with Student's t errors: coefficients (k,) and scale."""
    x, scale = np.linalg.lstsq(X, y, rcond=None)[0], 1.0
    for k in range(ROUNDS):
        e = y - X @ x
        scale = scale if k else 1.4826 * float(np.median(np.abs(e))) + 1e-12
        w = (FREEDOM + 1.0) / (FREEDOM + (e / scale) ** 2)
        x = np.linalg.lstsq((X * w[:, None]).T @ X, (X * w[:, None]).T @ y, rcond=None)[0]
        scale = math.sqrt(float(np.mean(w * (y - X @ x) ** 2))) + 1e-12
    return np.asarray(x, float), scale


def log_likelihood(e: Array, scale: float) -> float:
    """Log likelihood of residuals (n,), up to a constant."""
    return float(-(0.5 * (FREEDOM + 1.0) * np.log1p((e / scale) ** 2 / FREEDOM) + math.log(scale)).sum())


def fitted(drives: Sequence[Drive], channel: int, form: Form | None) -> Array:
    """The robot's coefficients in a channel, fitted jointly with the drives' own."""
    parts, targets = [], []
    counts = [len(d.own(channel)) for d in drives]
    for k, d in enumerate(drives):
        y = blocks(d.targets()[channel])
        shared, own = columns(_shared(d, channel, form), len(y)), columns(d.own(channel), len(y))
        scale = student(columns([*d.base(channel), *d.own(channel)], len(y)), y)[1]
        before, after = np.zeros((len(y), sum(counts[:k]))), np.zeros((len(y), sum(counts[k + 1 :])))
        parts.append(np.hstack([shared, before, own, after]) / scale)
        targets.append(y / scale)
    return student(np.vstack(parts), np.concatenate(targets))[0][: len(_shared(drives[0], channel, form))]


def _shared(d: Drive, channel: int, form: Form | None) -> list[Array]:
    return d.base(channel) + (form[1](d) if form is not None and form[0] == channel else [])


def predicted(d: Drive, channel: int, form: Form | None, x: Array) -> float:
    """Log likelihood of a drive with the robot's coefficients from other drives."""
    y = blocks(d.targets()[channel])
    own = columns(d.own(channel), len(y))
    scale = student(columns([*d.base(channel), *d.own(channel)], len(y)), y)[1]
    rest = y - columns(_shared(d, channel, form), len(y)) @ x
    return log_likelihood(rest - own @ student(own, rest)[0], scale)


def position_rms(d: Drive, form: Form | None, x: Sequence[Array], by_gyro: bool) -> float:
    """Position rms of the dead-reckoned path, which starts on the reference, m."""
    turn, way, side = (sum(c * k for c, k in zip(_shared(d, i, form), x[i], strict=True)) for i in range(3))
    if by_gyro:
        assert d.gyro_rad is not None
        still = np.abs(d.v) + np.abs(d.left_m - d.right_m) < 1e-3
        turn = d.gyro_rad - (np.median(d.gyro_rad[still]) if still.sum() > 2 * BLOCK else 0.0)
    first = slice(0, max(2, int(np.searchsorted(np.cumsum(np.abs(d.left_m + d.right_m)) / 2, STANDING_M))))
    heading = np.concatenate([[0.0], np.cumsum(turn)])
    heading += np.mean((d.heading_rad - heading)[first])
    middle = 0.5 * (heading[1:] + heading[:-1])
    step = np.stack([way * np.cos(middle) - side * np.sin(middle), way * np.sin(middle) + side * np.cos(middle)])
    e = np.concatenate([np.zeros((2, 1)), np.cumsum(step, axis=1)], axis=1) - d.xy_m
    return math.sqrt(float(np.mean(((e - e[:, first].mean(axis=1, keepdims=True)) ** 2).sum(axis=0))))


def judged(drives: Sequence[Drive], form: Form | None) -> tuple[list[float], list[float], list[float]]:
    """For each drive, from a fit to the others: gain in nats, position rms by gyro and wheels, and by wheels."""
    gains, gyro_m, wheels_m = [], [], []
    for d in drives:
        others = [o for o in drives if o is not d]
        x = [fitted(others, i, form) for i in range(3)]
        if form is not None:
            i = form[0]
            gains.append(
                predicted(d, i, form, fitted(others, i, form)) - predicted(d, i, None, fitted(others, i, None))
            )
        gyro_m += [position_rms(d, form, x, True)] if d.gyro_rad is not None else []
        wheels_m.append(position_rms(d, form, x, False))
    return gains, gyro_m, wheels_m


def late(drives: Sequence[Drive], channel: int) -> dict[str, list[float]]:
    """Gain of the wheels' readings in each drive with a lag, or both, in place of a delay; fitted to the others."""
    grid = np.array([[[_late(d, channel, delay, tau) for tau in LAGS_S] for delay in DELAYS_S] for d in drives])
    zero = int(np.argmin(np.abs(DELAYS_S)))
    choices = {"delay": grid[:, :, :1], "lag": grid[:, zero : zero + 1], "delay and lag": grid}
    flat = {name: found.reshape(len(drives), -1) for name, found in choices.items()}
    held = {
        name: np.array([g[i, np.argmax(g.sum(axis=0) - g[i])] for i in range(len(drives))]) for name, g in flat.items()
    }
    return {name: list(held[name] - held["delay"]) for name in ("lag", "delay and lag")}


def _late(d: Drive, channel: int, delay_s: float, tau_s: float) -> float:
    """Log likelihood of the wheels' turn or travel, given the true one behind a delay and a first-order lag."""

    def behind(values: Array) -> Array:
        if tau_s:
            kept = math.exp(-STEP_S / tau_s)
            values = lfilter([1.0 - kept], [1.0, -kept], values, zi=[values[0] * kept])[0]
        at = np.arange(len(values)) - delay_s / STEP_S
        return np.asarray(np.interp(at, np.arange(len(values)), values))

    read = ((d.right_m - d.left_m) / d.tread_m, 0.5 * (d.left_m + d.right_m))
    true = [blocks(behind(t)) for t in (d.true_turn_rad, smoothed(d.distance_m))]
    X, y = np.column_stack([*true, np.full_like(true[0], STEP_S)]), blocks(read[channel])
    x, scale = student(X, y)
    return log_likelihood(y - X @ x, scale)


def told(name: str, gains: Sequence[float], gyro_m: Sequence[float], wheels_m: Sequence[float]) -> str:
    """A line of the table."""
    won = f"{np.mean(gains):8.1f} {sum(g > 0.0 for g in gains):3d}/{len(gains)}" if gains else ""
    rms = [f"{np.median(m):.3f}" if m else "-" for m in (gyro_m, wheels_m)]
    return f"{name:42} {won:16} {rms[0]:>8} {rms[1]:>8}"


def main() -> None:
    """Print the table of one robot."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recordings", nargs="+", type=Path)
    parser.add_argument("--beside", nargs="*", choices=FORMS, default=[], metavar="FORM", help="in each fit")
    chosen = parser.parse_args()
    recordings = [read_recording(folder) for folder in chosen.recordings]
    lag = find_lag(recordings)
    delay_s = lag.lag_s if lag is not None and lag.determined else 0.0
    beside = tuple(FORMS[name] for name in chosen.beside)
    drives = [replace(read_drive(recording, delay_s), beside=beside) for recording in recordings]
    print(
        f"{len(drives)} drives, wheels {delay_s:.3f} s late; mean gain in a held-out drive, drives that gain, rms in m:"
    )
    print(told("radii, tread, delay, lever arm", *judged(drives, None)))
    for name, form in FORMS.items():
        if name not in chosen.beside and form[0] < len(drives[0].targets()):
            print(told(name, *judged(drives, form)), flush=True)
    undelayed = [read_drive(recording, 0.0) for recording in recordings]
    for channel in (0, 1):
        for name, gains in late(undelayed, channel).items():
            print(told(f"{name} of the wheels for a delay: {CHANNELS[channel]}", gains, [], []))


if __name__ == "__main__":
    main()
