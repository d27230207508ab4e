"""Summary of a replay as text."""

import math
from collections import Counter

import numpy as np

from drd.units import DEG_PER_RAD, S_PER_NS
from drd_tools.replay.reference import EndError
from drd_tools.replay.result import ORIGIN, Replayed, Start, table

# Share of rejected comparisons that noise of the assumed sigmas never reaches.
MANY = 0.01
# Counters of normal events.
GOOD = ("poses", "accepted", "bias_measured", "frames", "samples", "bytes", "packets")


def summary(replayed: Replayed, start: Start = ORIGIN, error: EndError | None = None, taken_s: float = 0.0) -> str:
    """Aligned lines on inputs, results and digest. There must be poses."""
    rows, last, robot = table(replayed, start), replayed.poses[-1], replayed.config.robot
    steps_m = np.hypot(np.diff(rows[:, 1]), np.diff(rows[:, 2]))
    is_set = np.isin(rows[1:, 0], [(t_ns - replayed.zero_ns) * S_PER_NS for t_ns in replayed.set_ns])
    distance_m = float(steps_m[~is_set].sum())
    _, x_m, y_m, heading_rad, xx, _, _, yy, _, hh, _, _ = rows[-1]
    sigmas = [math.sqrt(max(value, 0.0)) for value in (xx, yy, hh)]
    lines = {
        "recording": str(replayed.source),
        "robot": f"{robot.name}, wheel radius {robot.wheel_radius_m:.6g} m, tread {robot.tread_m:.6g} m",
        "calibration": "none" if replayed.calibration is None else str(replayed.config.calibration.file),
        "duration": f"{replayed.duration_s:.3f} s",
        "samples": ", ".join(f"{count} {name}" for name, count in replayed.samples.items()),
        "poses": f"{len(replayed.poses)}",
        "path": f"{distance_m:.3f} m",
        "end": f"x {x_m:.3f} m (sigma {sigmas[0]:.3f}), y {y_m:.3f} m ({sigmas[1]:.3f}), "
        f"heading {heading_rad * DEG_PER_RAD:.3f} deg ({sigmas[2] * DEG_PER_RAD:.3f}); "
        f"99 % bound {last.position_bound_m:.3f} m",
        "validity": _shares(Counter(p.validity.value for p in replayed.poses), len(replayed.poses)),
        "reasons": _shares(Counter(r.source for p in replayed.poses for r in p.reasons), len(replayed.poses)),
        "counters": _counters(replayed),
        "reference": _error_text(error),
        "digest": f"{replayed.digest()} (SHA-256 of all poses)",
    }
    if taken_s > 0.0:
        lines["speed"] = f"{replayed.duration_s / taken_s:.0f} times real time ({taken_s:.2f} s)"
    width = max(map(len, lines))
    told = [f"{name:{width}}  {text}" for name, text in lines.items() if text]
    return "\n".join([*told, *replayed.notes, *_advice(replayed)])


def _shares(counts: Counter[str], total: int) -> str:
    return ", ".join(f"{name} {100.0 * count / total:.3g} %" for name, count in counts.most_common())


def _counters(replayed: Replayed) -> str:
    found = {
        f"{part}.{name}": count
        for part, counters in replayed.counters.items()
        for name, count in counters.items()
        if count and name not in GOOD
    }
    return ", ".join(f"{name} {count}" for name, count in found.items())


def _advice(replayed: Replayed) -> list[str]:
    """Lines of advice if the two headings disagree."""
    counters = replayed.counters.get("estimator", {})
    rejected, compared = counters.get("rejected", 0), counters.get("rejected", 0) + counters.get("accepted", 0)
    if rejected < MANY * compared or not rejected:
        return []
    share = f"{100.0 * rejected / compared:.2g} % of {compared}"
    return [
        f"In {share} comparisons wheels and gyro disagree by more than their noise allows. Where the wheels skid",
        "or report late, say so with --config (estimation.initial.tread, estimation.noise.turn_rad_per_sqrt_rad and",
        "timing_s), or take the heading from the gyro alone (estimation.heading).",
    ]


def _error_text(error: EndError | None) -> str:
    if error is None:
        return ""
    share = ""
    if error.reference_m > 0.0:
        share = f" ({100.0 * error.position_m / error.reference_m:.3g} % of {error.reference_m:.2f} m)"
    return (
        f"end error {error.position_m:.3f} m{share}, "
        f"heading {error.heading_rad * DEG_PER_RAD:.2f} deg; put on its pose at {error.start_s:.2f} s, "
        f"compared at {error.time_s:.2f} s"
    )
