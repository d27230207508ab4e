"""Add effects to an existing recording, whatever world it comes from.

`overlaid`: along a known true motion. `planted`: in the raw rows of real sensors, along the motion that they recorded
themselves, `recorded_motion`. The sensor noise is the recording's own, and effects act on it as well.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from scipy.ndimage import gaussian_filter1d

from drd.arrays import Array, cumulative
from drd.effects.effect import Effect, Errors, Values
from drd.effects.motion import Motion
from drd_tools.recordings.folder import Recording

Effects = Sequence[tuple[Effect, Values]]

SPEED_SMOOTHING_S: Final = 0.2  # so that quantisation of counts and speeds does not look like acceleration
STANDSTILL_S: Final = 1.0  # at least


def overlaid(recording: Recording, motion: Motion, errors: Sequence[Errors]) -> Recording:
    """Add the `errors` of effects along the true `motion` to a recording.

    Second-order terms between several effects are omitted. Counts are rounded again, rates are not.
    """

    def gained(rates: Sequence[Array | float], at_s: Array) -> Array:
        """Integral of the rates from the motion's start to each time."""
        steps = np.gradient(motion.time_s)
        ends = np.concatenate([[motion.time_s[0] - 0.5 * steps[0]], motion.time_s + 0.5 * steps])
        total = sum(rates, np.zeros_like(motion.time_s))
        return np.asarray(np.interp(at_s, ends, cumulative(total * steps)))

    fog, reference, log = recording.fog, recording.reference, recording.encoders
    travel = [gained([e.left_m_s for e in errors], log.time_s), gained([e.right_m_s for e in errors], log.time_s)]
    made = _with_travel(recording, *travel)
    if fog is not None:
        edges = _edges_s(fog.time_s)
        # Rounding twice would lose or double a small rate in every sample.
        turned = np.diff(gained([e.gyro_rad_s for e in errors], edges)) / np.diff(edges)
        made = replace(made, fog=replace(fog, rate_rad_s=fog.rate_rad_s + turned))
    if reference is None:
        return made
    x, y = (
        gained([e.lateral_m_s * part for e in errors], reference.time_s)
        for part in (-np.sin(motion.heading_rad), np.cos(motion.heading_rad))
    )
    return _with_slide(made, x, y)


def planted(recording: Recording, effect: Effect, values: Values, reference_lag_s: float = 0.0) -> Recording:
    """Add an effect (values in SI) to the raw rows of each sensor of a recording.

    An effect of the body moves the reference's positions instead, later by its lag: no sensor of the robot sees it.
    """
    fog, reference, log = recording.fog, recording.reference, recording.encoders
    m, step_s = recorded_motion(recording, log.time_s), np.diff(_edges_s(log.time_s))
    errors = effect.error(m, values)
    made = recording
    if np.any(errors.left_m_s) or np.any(errors.right_m_s):
        made = _with_travel(made, *(np.cumsum(rate * step_s) for rate in (errors.left_m_s, errors.right_m_s)))
    if reference is not None and np.any(errors.lateral_m_s):
        slide = errors.lateral_m_s * step_s
        parts = (-np.sin(m.heading_rad), np.cos(m.heading_rad))
        at_s = reference.time_s - reference_lag_s
        x, y = (np.interp(at_s, log.time_s, np.cumsum(slide * part)) for part in parts)
        made = _with_slide(made, x, y)
    if fog is not None:
        # From the gyro's own rows: a limit clips its noise too, and a delay shifts it.
        own = effect.error(recorded_motion(recording, fog.time_s), values).gyro_rad_s
        made = replace(made, fog=replace(fog, rate_rad_s=fog.rate_rad_s + own))
    return made


def recorded_motion(recording: Recording, time_s: Array) -> Motion:
    """Motion as the sensors recorded it: means over the intervals that end at `time_s` (n,); body speed is smoothed.

    At a sensor's own times these are its raw values. Without a gyro the yaw rate is that of the wheels; without a
    reference the heading is the rate's integral. Raises ConfigError if there are no wheels.
    """
    fog, log, nominal = recording.fog, recording.encoders, recording.nominal
    edges = _edges_s(time_s)
    step_s, middle_s = np.diff(edges), 0.5 * (edges[1:] + edges[:-1])
    angles = [np.interp(edges, log.time_s, angle) for angle in recording.wheel_angles_rad()]
    left, right = (nominal.wheel_radius_m * np.diff(angle) / step_s for angle in angles)
    rate = (right - left) / nominal.tread_m
    temperature_c = np.full_like(middle_s, np.nan)
    if fog is not None:
        own = _edges_s(fog.time_s)
        turned = cumulative(fog.rate_rad_s * np.diff(own))
        rate = np.diff(np.interp(edges, own, turned)) / step_s
        if fog.temperature_c is not None:
            temperature_c = np.interp(middle_s, fog.time_s, fog.temperature_c)
    speed = gaussian_filter1d(0.5 * (left + right), SPEED_SMOOTHING_S / float(np.median(step_s)))
    still = middle_s <= edges[0] + max(nominal.standstill_at_start_s, STANDSTILL_S)
    reference = recording.reference
    heading = np.cumsum(rate * step_s)
    if reference is not None and len(reference.time_s) > 1:
        heading = np.interp(middle_s, reference.time_s, reference.heading_rad)
    return Motion(
        time_s=middle_s,
        rate_rad_s=rate,
        speed_m_s=speed,
        acceleration_m_s2=np.gradient(speed, middle_s),
        heading_rad=heading,
        left_m_s=left,
        right_m_s=right,
        left_wheel_rad=0.5 * (angles[0][1:] + angles[0][:-1]),
        right_wheel_rad=0.5 * (angles[1][1:] + angles[1][:-1]),
        temperature_c=temperature_c,
        still_c=float(temperature_c[still].mean()),
        tread_m=nominal.tread_m,
        wheel_radius_m=nominal.wheel_radius_m,
        end_s=float(edges[-1]),
    )


def _with_travel(recording: Recording, left_m: Array, right_m: Array) -> Recording:
    """Add travel since the start, (n,), to the wheels' rows of a recording."""
    log, wheel = recording.encoders, recording.nominal
    if log.left_counts is not None and log.right_counts is not None and wheel.counts_per_revolution is not None:
        count_m = 2.0 * math.pi * wheel.wheel_radius_m / wheel.counts_per_revolution
        # A count covers an interval of travel, whose middle is the best estimate of the wheel's position.
        left, right = (
            np.floor(counts + 0.5 + added / count_m)
            for counts, added in ((log.left_counts, left_m), (log.right_counts, right_m))
        )
        return replace(recording, wheels=replace(log, left_counts=left, right_counts=right))
    assert log.left_rad_s is not None
    assert log.right_rad_s is not None
    step_s = np.diff(_edges_s(log.time_s))
    left, right = (
        rate + np.diff(added, prepend=0.0) / step_s / wheel.wheel_radius_m
        for rate, added in ((log.left_rad_s, left_m), (log.right_rad_s, right_m))
    )
    return replace(recording, wheels=replace(log, left_rad_s=left, right_rad_s=right))


def _with_slide(recording: Recording, x_m: Array, y_m: Array) -> Recording:
    """Shift the reference's positions of a recording."""
    log = recording.reference
    assert log is not None
    return replace(recording, reference=replace(log, x_m=log.x_m + x_m, y_m=log.y_m + y_m))


def _edges_s(time_s: Array) -> Array:
    """Edges of the rows' intervals, (n + 1,); the first interval is as long as the second."""
    return np.concatenate([[2.0 * time_s[0] - time_s[1]], time_s])
