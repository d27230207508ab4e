"""Warm restart: inflate a saved estimate for the time in which the robot was not watched."""

import dataclasses
import math
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from drd.config.keys import Config
from drd.effects.effect import Effect
from drd.estimation.basis import changes, learned_anew
from drd.estimation.estimate import Estimate, forget_gyro, forget_lag, forget_wheels
from drd.estimation.filter import Filter
from drd.estimation.learning import Learned
from drd.estimation.state import GYRO_BIAS, GYRO_SCALE, SCALE_L, SCALE_R, TREAD
from drd.estimation.uncertainty import UNSEEN_ACCELERATION_M_S2, UNSEEN_TURN_RAD_S2, unseen_growth
from drd.pipeline import Pipeline
from drd.state.saved import Moment, Saved
from drd.units import DEG_PER_RAD, NS_PER_S, RAD_PER_DEG, S_PER_H, S_PER_NS

CLOCK_CHIPS: Final = Path("/sys/class/rtc")
# Agreement of two clocks that are read one after the other, and of a wall clock that is slewed.
CLOCKS_AGREE_NS: Final = 2 * NS_PER_S
# Beyond this much unseen motion the position is "anywhere"; capped so that squares do not overflow.
LONGEST_UNSEEN_S: Final = 1e5
# A bias with a sigma below this fraction of a cold start's need not be measured before the pose is used.
KNOWN_PART: Final = 0.5


class Restart(NamedTuple):
    """How the daemon starts: the estimate to continue from, whether its bias still holds, and a sentence for people."""

    estimate: Estimate
    bias_known: bool
    off_s: float | None
    text: str


def has_clock_chip() -> bool:
    """Whether the wall clock can have kept running while the machine was off."""
    try:
        return any(CLOCK_CHIPS.iterdir())
    except OSError:
        return False


def time_off_s(then: Moment, now: Moment, clock_chip: bool) -> float | None:
    """How long the robot was not watched; None if no clock shows it.

    Within a boot CLOCK_BOOTTIME is used, and steps of the wall clock do not matter. Across boots only the wall clock
    is available: it is believed unless it stood still while the machine was off, or shows less than the present boot
    has lasted. A clock that was set ahead makes the time too long, which only inflates the covariance more.
    """
    same_boot = then.boot_id == now.boot_id if then.boot_id and now.boot_id else None
    ran_ns = now.boottime_ns - then.boottime_ns
    if same_boot and ran_ns >= 0:
        return ran_ns * S_PER_NS
    # Without boot ids the boot may be the same one, in which case it has lasted `ran_ns` since.
    least_ns = ran_ns if same_boot is None and ran_ns >= 0 else now.boottime_ns
    wall_ns = now.wall_ns - then.wall_ns
    if not clock_chip or wall_ns < least_ns - CLOCKS_AGREE_NS:
        return None
    return max(wall_ns, least_ns) * S_PER_NS


def warm_restart(saved: Saved, now: Moment, config: Config, pipeline: Pipeline, clock_chip: bool) -> Restart:
    """Inflate the saved estimate for what may have happened since, and drop what no longer applies."""
    estimator, settings = pipeline.estimator, config.state
    off_s = time_off_s(saved.moment, now, clock_chip)
    kf = Filter(config.robot.tread_m, estimator.sigmas, estimator.noise)
    kf.put(saved.estimate.nominal, saved.estimate.P)
    kf.anchor_gyro()
    other = changes(saved.basis, pipeline.basis)
    if pipeline.model is not None and any(_counts_from_start(term.effect) for term in pipeline.model.terms):
        other.gyro.append("the model takes the gyro's time and temperature from each start on")
    learned = saved.estimate.learned
    if other.wheels:
        learned = Learned(gyro_differences=learned.gyro_differences, gyro_rad2_per_s=learned.gyro_rad2_per_s)
        forget_wheels(kf, config.robot.tread_m, estimator.sigmas)
    if other.gyro:
        learned = dataclasses.replace(learned, gyro_differences=0.0, gyro_rad2_per_s=0.0)
        forget_gyro(kf, estimator.sigmas)
    if other.lag:
        forget_lag(kf, estimator.sigmas)
    _widen_learned(kf, off_s, config, pipeline)
    unseen_s = 0.0 if saved.estimate.at_rest else LONGEST_UNSEEN_S if off_s is None else off_s
    lost = saved.estimate.lost
    if settings.pose == "origin":
        s = estimator.sigmas
        kf.set_pose(0.0, 0.0, 0.0, np.diag([s.position_m**2, s.position_m**2, s.heading_rad**2]))
        lost = False
    else:
        lost |= unseen_s > config.estimation.invalid_after_s or off_s is None or off_s > settings.believed_s
        _widen_pose(kf, saved.estimate, unseen_s, settings.position_m, settings.heading_deg * RAD_PER_DEG)
    estimate = dataclasses.replace(
        saved.estimate, nominal=kf.nominal, P=kf.P.copy(), lost=lost, speed_m_s=0.0, rate_rad_s=0.0, learned=learned
    )
    bias_rad_s = kf.sigma(GYRO_BIAS)
    bias_text = f"gyro bias known to {bias_rad_s * DEG_PER_RAD * S_PER_H:.2g} deg/h"
    sentences = [_pose_sentence(saved, off_s, config, lost), bias_text, *learned_anew(other)]
    bias_known = bias_rad_s < KNOWN_PART * estimator.sigmas.gyro_bias_rad_s
    return Restart(estimate, bias_known, off_s, "; ".join(sentences))


def _counts_from_start(effect: Effect) -> bool:
    """Whether its gyro correction is relative to the first samples, so that the old bias goes with the old start."""
    return effect.channel == "gyro" and ("time" in effect.covariate or "temperature" in effect.covariate)


def _widen_learned(kf: Filter, off_s: float | None, config: Config, pipeline: Pipeline) -> None:  # (41)
    """Add random walks over the time off, a gyro power cycle, another load; at most a cold start's variance."""
    s, k, settings = pipeline.estimator.sigmas, pipeline.estimator.noise, config.state

    def walked(variance_per_s: float) -> float:
        return math.inf if off_s is None else variance_per_s * off_s

    wheel, tread = settings.wheel_scale**2, (settings.tread * kf.nominal.tread_m) ** 2
    grown = {
        SCALE_R: (wheel, s.wheel_scale),
        SCALE_L: (wheel, s.wheel_scale),
        TREAD: (tread, s.tread_m),
        GYRO_SCALE: (walked(k.gyro_scale_per_s), s.gyro_scale),
        GYRO_BIAS: (walked(k.gyro_bias_rad2_s2_per_s) + k.gyro_bias_restart_rad2_s2, s.gyro_bias_rad_s),
    }
    for i, (variance, cold) in grown.items():
        kf.P[i, i] += min(variance, max(0.0, cold**2 - kf.P[i, i]))


def _widen_pose(kf: Filter, then: Estimate, unseen_s: float, position_m: float, heading_rad: float) -> None:  # (41)
    """Inflate the pose: the robot may have been pushed and, if not at rest, have driven on. (36)"""
    kf.add_position_variance(position_m**2)
    kf.add_heading_variance(heading_rad**2, both=True)
    speed, rate = abs(then.speed_m_s), abs(then.rate_rad_s)
    kf.add_position_variance(unseen_growth(0.0, unseen_s, speed, UNSEEN_ACCELERATION_M_S2))
    kf.add_heading_variance(unseen_growth(0.0, unseen_s, rate, UNSEEN_TURN_RAD_S2), both=True)


def _pose_sentence(saved: Saved, off_s: float | None, config: Config, lost: bool) -> str:
    settings = config.state
    if settings.pose == "origin":
        pose = "at the origin, as state.pose says"
    elif saved.estimate.at_rest:
        pose = f"where it stood, {settings.position_m:g} m and {settings.heading_deg:g} deg less certain"
    else:
        pose = "where it was last seen, moving, less certain by what it may have driven since"
    off = "after a time that no clock tells" if off_s is None else f"after {duration(off_s)}"
    return f"warm restart {off}: {pose}" + (", only set_pose or reset make it good" if lost else "")


def duration(seconds: float) -> str:
    """The time as text, such as 42 s, 7.5 min, 3.2 h or 12 days."""
    for limit, unit, text in ((120.0, 1.0, "s"), (7200.0, 60.0, "min"), (172_800.0, 3600.0, "h")):
        if seconds < limit:
            return f"{seconds / unit:.3g} {text}"
    return f"{seconds / 86_400.0:.3g} days"
