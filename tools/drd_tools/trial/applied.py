"""The gains and risks of `monitor.apply`: drives on which something begins, and recordings, with it and without.

`python -m drd_tools.trial.applied [--each N] [RECORDING ...]` prints the table of drd/monitor/README.md.
"""

import argparse
import math
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from drd.batch.run import latest, run
from drd.batch.samples import gyro_samples, resolution_m, wheel_samples, zero_of
from drd.commands import whole
from drd.effects.catalogue import catalogue
from drd.effects.effect import Values
from drd.estimation.applied import Constant
from drd.estimation.estimator import Estimator
from drd.monitor.applying import Applying
from drd.monitor.monitor import Monitor
from drd.samples import GyroSample, Pose
from drd.units import S_PER_NS
from drd_tools.evaluate.alignment import align
from drd_tools.evaluate.metrics import absolute_error, rms
from drd_tools.evaluate.trajectory import Poses, associate, reference_of
from drd_tools.recordings.folder import Recording, read_recording
from drd_tools.replay.nominal import configuration
from drd_tools.report.terminal import columns
from drd_tools.simulate.conditions import Conditions
from drd_tools.simulate.missions import make_drive
from drd_tools.simulate.robot import DEFAULT
from drd_tools.simulate.simulator import simulate
from drd_tools.simulate.truth import make_truth
from drd_tools.trial.live_cases import since
from drd_tools.trial.overlay import overlaid
from drd_tools.trial.workers import completed

SECONDS: Final = 600.0
BEGIN_S: Final = 150.0
MISSIONS: Final = ("warehouse", "field", "eights")
# Effects of the catalogue that begin at BEGIN_S and stay, with their values in SI.
CASES: Final[dict[str, dict[str, Values]]] = {
    "nothing": {},
    "left tyre 1 % smaller": {"wheel_radius_error": {"left": -0.01, "right": 0.0}},
    "left tyre 0.3 % smaller": {"wheel_radius_error": {"left": -0.003, "right": 0.0}},
    "left tyre 1 % larger": {"wheel_radius_error": {"left": 0.01, "right": 0.0}},
    "load: 1 % and 0.4 % smaller": {"wheel_radius_error": {"left": -0.01, "right": -0.004}},
    "other ground: tread + 4 %": {"tread_error": {"k": 0.04}},
    "wheels 30 ms late": {"encoder_latency": {"delay": 0.03}},
    "bias jumps by 0.02 deg/s": {"gyro_bias_step": {"t0": BEGIN_S, "b": 3.5e-4}},
}


class Change(NamedTuple):
    """A constant adopted at `time_s`, or dropped (None); `step`: the jump that this caused in the pose, m and rad."""

    time_s: float
    name: str
    constant: Constant | None
    step: tuple[float, ...]


@dataclass(frozen=True)
class Driven:
    """Poses, the time in ns that is the recording's zero, and the constants adopted and dropped."""

    poses: list[Pose]
    zero_ns: int
    changes: list[Change]


def driven(recording: Recording, is_on: bool) -> Driven:
    """Run a recording through the estimator; if `is_on`, a monitor runs too, whose constants are applied."""
    config, zero_ns = configuration(recording), zero_of(recording.fog, recording.encoders)
    wheels, _, _ = wheel_samples(recording.encoders, config, zero_ns)
    gyro, _ = gyro_samples(recording.fog, config, zero_ns)
    estimator = Estimator(config, None, resolution_m(recording.encoders, config))
    changes: list[Change] = []

    def beside(samples: list[Any]) -> Iterator[Any]:
        monitor, applying, now_s = Monitor(config), Applying(), 0.0
        for sample in samples:
            yield sample
            (monitor.gyro if isinstance(sample, GyroSample) else monitor.wheels)(sample)
            if monitor.now_s == now_s:
                continue
            now_s = monitor.now_s
            applying.look(monitor, monitor.findings())
            for name, constant in applying.wanted.items():
                if estimator.knowledge.applied.taken.get(name) != constant:
                    before = estimator.newest()
                    estimator.apply(name, constant)
                    step = tuple(b - a for a, b in zip(before, estimator.newest(), strict=True))
                    changes.append(Change((sample.t_ns - zero_ns) * S_PER_NS, name, constant, step))

    poses = run(estimator, gyro, wheels, beside if is_on else iter)
    return Driven(latest(poses), zero_ns, changes)


def position_rms_m(made: Driven, recording: Recording) -> float:
    """Rms position error against the reference, after the best rotation and shift onto it."""
    time_s = np.array([(p.t_ns - made.zero_ns) * S_PER_NS for p in made.poses])
    poses = Poses(recording.name, time_s, np.array([(p.x_m, p.y_m, p.heading_rad) for p in made.poses]))
    pairs = associate(poses, reference_of(recording), math.inf)
    return absolute_error(align(pairs, "se2")[0]).position_rmse_m


def simulated(name: str, seed: int, seconds: float = SECONDS) -> Recording:
    """Simulate a drive of a case, with a reference."""
    truth = make_truth(make_drive(MISSIONS[seed % len(MISSIONS)], seconds, DEFAULT.standstill_at_start_s), "constant")
    made = simulate(truth, DEFAULT, (), Conditions(), seed, name)
    begin = int(np.searchsorted(made.motion.time_s, BEGIN_S))
    errors = [since(catalogue()[effect], values, made.motion, begin) for effect, values in CASES[name].items()]
    return overlaid(made.recording, made.motion, errors) if errors else made.recording


class Row(NamedTuple):
    """Rms position error of a drive without and with `monitor.apply`, m, and the constants adopted and dropped."""

    name: str
    off_m: float
    on_m: float
    changes: list[Change]


def of_case(name: str, seed: int) -> Row:
    """Compare a simulated drive with and without `monitor.apply`."""
    return compared(name, simulated(name, seed))


def compared(name: str, recording: Recording) -> Row:
    """Compare a recording with and without `monitor.apply`."""
    off, on = (driven(recording, is_on) for is_on in (False, True))
    return Row(name, position_rms_m(off, recording), position_rms_m(on, recording), on.changes)


def lines(rows: Iterable[Row]) -> list[str]:
    """Table by case: rms errors, and the number of drives in which a constant was adopted or dropped."""
    by: dict[str, list[Row]] = {}
    for row in rows:
        by.setdefault(row.name, []).append(row)
    found = [["drive", "n", "taken in", "given back in", "rms off", "rms on", "best", "worst"]]
    for name, group in by.items():
        off, on = np.array([r.off_m for r in group]), np.array([r.on_m for r in group])
        taken = [any(c.constant is not None for c in r.changes) for r in group]
        back = [any(c.constant is None for c in r.changes) for r in group]
        ratio = on / off
        found.append([name, str(len(group)), str(sum(taken)), str(sum(back)), f"{rms(off):.3f} m", f"{rms(on):.3f} m",
                      f"{ratio.min():.2f}", f"{ratio.max():.2f}"])  # fmt: skip
    return columns(found)


def main(argv: Sequence[str] | None = None) -> int:
    """Print the table; always 0."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recordings", nargs="*", type=Path, metavar="RECORDING", help="folders with a reference")
    parser.add_argument("--each", type=whole(1), default=6, metavar="N", help="simulated drives of each case")
    parser.add_argument("--seed", type=whole(0), default=1, metavar="N", help="of the first one")
    parser.add_argument("--jobs", type=whole(1), default=1, metavar="N", help="at a time")
    chosen = parser.parse_args(argv)
    seeds = range(chosen.seed, chosen.seed + chosen.each)
    todo = [partial(of_case, name, seed) for name in CASES for seed in seeds]
    todo += [partial(compared, folder.name, read_recording(folder)) for folder in chosen.recordings]
    rows = list(completed(todo, chosen.jobs))
    print("\n".join(lines(rows)))
    for row in rows:
        for c in row.changes:
            what = "given back" if c.constant is None else f"{c.constant.value:.4g}, sigma {c.constant.sigma:.2g}"
            print(f"{row.name}: {c.time_s:.0f} s: {c.name} {what}; step {max(map(abs, c.step)):.1e}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
