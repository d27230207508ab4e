"""Sensitivities of the catalogue's effects in one recording."""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d, uniform_filter1d

from drd.arrays import Array, cumulative
from drd.effects.effect import ActsOn, Effect, Errors
from drd.effects.motion import Motion
from drd_tools.calibrate.wheels.drift import REFERENCE_WANDER_S, WHEELS_WANDER_S
from drd_tools.diagnose.error_model.denoise import WIDTHS, denoised
from drd_tools.diagnose.error_model.linear import Sensitivity
from drd_tools.diagnose.error_model.path import Path
from drd_tools.diagnose.observe.evidence import Evidence
from drd_tools.diagnose.observe.lags import REFERENCE_LAG_S

SUB = 4  # parts of a step, so that its mean follows the curvature within it
SPEED_SMOOTHING_S = 0.3  # narrowest: limits the sharpness of changes of speed
TEMPERATURE_SMOOTHING_S = 5.0  # less would turn the thermometer's quantisation into rates
MOST_SHARE = 3.0  # times the smooth speed, near a stop
REACH = 4.0  # sigmas at which a Gaussian filter is cut off
SLOW_S = 3.0  # of the path's turn less the gyro's: shorter would admit the fixes' noise
TURN_SMOOTHING_S = 0.2  # narrowest, for turns from fixes and wheels
# Additional narrower widths, each half of the last, where times are estimated: real robots start to turn within 0.1 s.
SHARPER = 2
CALM_SMOOTHING_S = 0.4  # averages a gyro's white noise, short beside a turn
CALM_SIGMAS = 3.0  # beyond, it is a turn, not noise
UNKNOWN_LAG_S = 0.4  # of a real one of undetermined lag: lidar odometry's is 0.26 to 0.46 s
# Nuisances: errors of the reference.
LATENCY, DRIFT, YAW = "reference_latency", "reference_drift", "reference_yaw"
AHEAD, SIDEWAYS, SMOOTHING = "reference_ahead", "reference_sideways", "reference_smoothing"
LAG_SHARE = 0.1  # of a measured lag: headings and positions may be filtered differently
AHEAD_M = 0.2  # lever arm of a reference that nobody has measured, prior
AVERAGED_S = 0.6  # over which a reference may average: lidar odometry of a skid-steer robot does over 0.4 to 0.8 s

Change = Callable[[Motion], Motion]  # of a motion, if more is known of it than the sensors show


def motion_along(e: Evidence, path: Path) -> Motion:
    """The robot's motion on a grid SUB times finer than the steps, of shape (n SUB,): means over its intervals."""
    edges = e.edges_s
    fine = _fine_s(e)
    middle = 0.5 * (fine[1:] + fine[:-1])
    counted = e.counted_m or (e.left_m, e.right_m)
    wl, wr = (np.interp(middle, edges, cumulative(m)) / e.radius_m for m in counted)
    temperature_c, still_c = _temperature_c(e, middle, float(np.median(e.step_s)))
    zero = np.zeros_like(middle)
    at_rest = Motion(
        time_s=middle,
        rate_rad_s=zero,
        speed_m_s=zero,
        acceleration_m_s2=zero,
        heading_rad=CubicSpline(edges, path.pose[:, 2])(middle),
        left_m_s=zero,
        right_m_s=zero,
        left_wheel_rad=wl,
        right_wheel_rad=wr,
        temperature_c=temperature_c,
        still_c=still_c,
        tread_m=e.tread_m,
        wheel_radius_m=e.radius_m,
        end_s=float(edges[-1]),
    )
    return _moving(at_rest, e, path)


def _moving(motion: Motion, e: Evidence, path: Path, sharp: bool = False) -> Motion:
    """Add the speeds to a motion. `sharp`: less smoothing, with sharper changes and more noise."""
    edges, fine = e.edges_s, _fine_s(e)
    typical, h = float(np.median(e.step_s)), np.diff(fine)
    forward = 0.5 * (e.left_m + e.right_m)
    # At nearly constant speed, a column that follows the wheels' noise would explain the wheels by themselves.
    speed = _denoised(forward / np.diff(edges), _speed_sigma_m_s(e), SPEED_SMOOTHING_S / typical, sharp)
    distance = CubicSpline(edges, cumulative(speed * np.diff(edges)))
    turned = CubicSpline(edges, cumulative(_turn(e, path, typical, sharp)))
    # Near a stop the wheels' noise is small: a column smeared across the stop would outweigh all others.
    smooth = np.diff(distance(edges))
    share = np.clip(_ratio(smooth, forward), 0.7, 1.3) * _ratio(forward, smooth)
    # When turning on the spot both are noise, and their ratio is arbitrary.
    share = np.clip(share, 0.0, MOST_SHARE)
    v = np.diff(distance(fine)) / h * np.repeat(share, SUB)
    w = np.diff(turned(fine)) / h
    return replace(
        motion,
        rate_rad_s=w,
        speed_m_s=v,
        acceleration_m_s2=distance(motion.time_s, 2),
        left_m_s=v - 0.5 * w * e.tread_m,
        right_m_s=v + 0.5 * w * e.tread_m,
    )


def _fine_s(e: Evidence) -> Array:
    """Edges of the fine grid, (n SUB + 1,)."""
    n = len(e.time_s)
    return np.interp(np.arange(n * SUB + 1) / SUB, np.arange(n + 1), e.edges_s)


def _temperature_c(e: Evidence, at_s: Array, typical_s: float) -> tuple[Array, float]:
    """Temperature at times (m,), and during the standstill at the start; NaN if there is no thermometer."""
    known = np.isfinite(e.temperature_c)
    if not known.any():
        return np.full(len(at_s), np.nan), np.nan
    sigma = TEMPERATURE_SMOOTHING_S / typical_s
    smooth = _smoothed(np.interp(e.time_s, e.time_s[known], e.temperature_c[known]), sigma)
    still = known & (e.time_s <= e.time_s[0] + max(e.standstill_s, 1.0))
    still_c = float(e.temperature_c[still].mean()) if still.any() else float(smooth[0])
    return np.interp(at_s, e.time_s, smooth), still_c


def _denoised(values: Array, sigma: Array, width: float, sharp: bool) -> Array:
    return denoised(values, sigma, width / 2**SHARPER, WIDTHS + SHARPER) if sharp else denoised(values, sigma, width)


def _smoothed(values: Array, sigma: float) -> Array:
    """Smooth by a Gaussian of `sigma` rows, extrapolating linearly at the ends: mirrored, a steady rise would begin
    with a pause, to which a coil with memory would respond.
    """
    m = min(len(values), math.ceil(REACH * sigma) + 1)
    k = np.arange(m)
    first, last = (np.polynomial.Polynomial.fit(k, part, 1) for part in (values[:m], values[-m:]))
    longer = np.concatenate([first(k - m), values, last(k + m)])
    return np.asarray(gaussian_filter1d(longer, sigma)[m:-m], float)


def _speed_sigma_m_s(e: Evidence) -> Array:
    """Deviation of each step's speed, (n,), m/s."""
    variance_m2 = e.datasheet.slip_m_per_sqrt_m**2 * e.near_travel_m / 4.0 + e.datasheet.count_m**2 / 12.0
    return np.asarray(np.sqrt(variance_m2) / e.step_s, float)


def _turn_sigma_rad_s(e: Evidence) -> Array:
    """Deviation of each step's yaw rate, (n,), due to the wheels and to the fixes to which the path is bent."""
    distance_m2 = e.datasheet.slip_m_per_sqrt_m**2 * e.near_travel_m + e.datasheet.count_m**2 / 3.0
    variance_rad2 = distance_m2 / e.tread_m**2
    variance_rad2[e.fix_step] += 2.0 * e.datasheet.heading_rad**2
    return np.asarray(np.sqrt(variance_rad2) / e.step_s, float)


def _ratio(a: Array, b: Array) -> Array:
    result: Array = np.divide(a, b, out=np.zeros_like(a), where=np.abs(b) > 1e-9)
    return result


def _turn(e: Evidence, path: Path, typical_s: float, sharp: bool) -> Array:
    """Turn of each step, from the gyro with a slow correction, to keep the fixes' noise out of the regressors.

    A column that contains the reference's noise is correlated with the innovations that it should explain.
    """
    turn = path.moved[:, 2]
    # On a straight line the wheels' turn is mostly noise, and would explain itself.
    seen = _denoised(turn / e.step_s, _turn_sigma_rad_s(e), TURN_SMOOTHING_S / typical_s, sharp) * e.step_s
    if e.gyro_rad is not None:
        # Where the gyro is uncertain, the path, bent to the fixes, is better.
        is_unsure = e.gyro_inflation_rad2 > e.datasheet.heading_rad**2
        slow = gaussian_filter1d(np.where(is_unsure | (e.jump_rad2 > 0.0), 0.0, turn - e.gyro_rad), SLOW_S / typical_s)
        seen = np.where(is_unsure, seen, e.gyro_rad + slow)
    return np.asarray(np.where(e.still, 0.0, seen), float)


class Sensitivities:
    """Compute sensitivities along a motion. (72)

    `sharp`: the motion for timing effects. Its noise does no harm there, being orthogonal to its own derivative; a
    scale factor would be found that explains this noise by itself.
    """

    def __init__(self, e: Evidence, motion: Motion, sharp: Motion):
        self.e, self.motion, self.sharp = e, motion, sharp
        self.h = np.repeat(np.diff(e.edges_s) / SUB, SUB)

    @classmethod
    def on(cls, e: Evidence, path: Path) -> "Sensitivities":
        """Sensitivities along the motion on a path."""
        motion = motion_along(e, path)
        return cls(e, motion, _moving(motion, e, path, sharp=True))

    def along(self, change: Change) -> "Sensitivities":
        """Sensitivities along the changed motion; the sharp motion is changed, too."""
        return Sensitivities(self.e, change(self.motion), change(self.sharp))

    def motion_of(self, effect: Effect) -> Motion:
        """The motion along which an effect acts."""
        return self.sharp if effect.acts_on is ActsOn.TIMING else self.motion

    @property
    def body(self) -> Sensitivity:
        """The motion itself, as error-free sensors would measure it."""
        m = self.sharp
        return self.of(Errors(m.rate_rad_s, m.left_m_s, m.right_m_s))

    @cached_property
    def calm_rate_rad_s(self) -> Array:
        """The motion's yaw rate, smoothed: small rates that contain the gyro's noise would explain that noise.

        Where smoothing changes it by more than the noise, it stays unsmoothed: turns do not leak into straight lines.
        """
        e, rate = self.e, self.motion.rate_rad_s
        step_s = float(self.motion.time_s[1] - self.motion.time_s[0])
        calm = gaussian_filter1d(rate, CALM_SMOOTHING_S / step_s)
        sigma_rad_s = np.repeat(np.sqrt(e.datasheet.gyro(e)) / e.step_s, SUB)
        return np.where(np.abs(rate - calm) > CALM_SIGMAS * sigma_rad_s, rate, calm)

    def of(self, errors: Errors) -> Sensitivity:
        """Sum the rates of errors on the fine grid over each step."""

        def summed(rate: Array | float) -> Array | float:
            # Over such a short axis, a product is several times as fast as a sum.
            return (rate * self.h).reshape(-1, SUB) @ np.ones(SUB) if isinstance(rate, np.ndarray) else 0.0

        return Sensitivity(*(summed(rate) for rate in errors))

    def wheels_drift(self, readings: Motion) -> tuple[str, float, Sensitivity]:
        """Growth of the wheels' lag, from the motion as counted; a nuisance as in `nuisances`. (70)"""
        ends_s = self.e.edges_s[[0, -1]]
        growth = WHEELS_WANDER_S / float(np.ptp(ends_s))
        left_m_s, right_m_s = readings.wheels_change(growth * (readings.time_s - ends_s.mean()))
        later = Errors(left_m_s=left_m_s, right_m_s=right_m_s)
        return "wheels_drift", growth, self.of(later) * (1.0 / growth)


def nuisances(e: Evidence, path: Path, ahead_m: float) -> list[tuple[str, float, Sensitivity]]:
    """Nuisances: errors of the reference itself; name, prior sigma, sensitivity. (70)

    `ahead_m`: deviation of its lever arm ahead, if the robot is near robot.yaml.
    """
    if not len(e.fix):
        return []
    k = e.fix_step
    # From the sensors: the path is bent to the fixes and contains their noise.
    travel, middle = 0.5 * (e.left_m + e.right_m), path.middle_rad
    turn = _turn(e, path, float(np.median(e.step_s)), sharp=True)
    # If fixes scatter by 0.2 mm, like lidar odometry's, even their noise in the heading of a lever arm matters.
    heading = path.pose[0, 2] + np.cumsum(turn)[k] if e.is_far else path.pose[k + 1, 2]
    c, s = np.cos(heading), np.sin(heading)
    moved = np.column_stack([travel * np.cos(middle), travel * np.sin(middle), turn])
    dp = (moved / e.step_s[:, None])[k]
    zero = np.zeros(len(k))
    one = zero + 1
    latency_s = math.hypot(REFERENCE_LAG_S, LAG_SHARE * (e.reference_lag_s or 0.0))
    if e.is_far and e.reference_lag_s is None:
        latency_s = UNKNOWN_LAG_S
    found = [
        (LATENCY, latency_s, Sensitivity(fix=-dp)),
        (YAW, np.radians(2.0), Sensitivity(fix=np.column_stack([zero, zero, one]))),
        (SIDEWAYS, 0.05, Sensitivity(fix=np.column_stack([-s, c, zero]))),
    ]
    if e.gyro_rad is None or e.is_far:
        since_s = (e.fix_time_s - e.fix_time_s.mean())[:, None]
        found.append((DRIFT, REFERENCE_WANDER_S / float(np.ptp(e.edges_s)), Sensitivity(fix=-dp * since_s)))
    if ahead_m := AHEAD_M if e.is_far else ahead_m:
        found.append((AHEAD, ahead_m, Sensitivity(fix=np.column_stack([c, s, zero]))))
    if e.is_far:
        passed = np.cumsum(moved, axis=0)
        rows = 2 * round(0.5 * AVERAGED_S / float(np.median(e.step_s))) + 1  # odd: the mean of an even number is late
        mean = uniform_filter1d(passed, rows, axis=0, mode="nearest")
        found.append((SMOOTHING, 1.0, Sensitivity(fix=(mean - passed)[k])))
    return found
