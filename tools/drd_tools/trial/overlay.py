"""Effects put onto a recording that exists already, whatever world it comes from."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from drd.effects.effect import Effect, Values
from drd.effects.motion import Array, Motion
from drd_tools.recordings.folder import Recording

Effects = Sequence[tuple[Effect, Values]]


def overlaid(recording: Recording, motion: Motion, effects: Effects) -> Recording:
    """The recording with `effects` (values in SI) along its true `motion`.

    Each effect takes the motion as it is: of several together, second-order terms are left out. The sensors' noise is
    the recording's own; counts are rounded again, rates are not. Raises ValueError where encoders.csv has no counts.
    """
    log, nominal = recording.encoders, recording.nominal
    if log.left_counts is None or log.right_counts is None or nominal.wheel.counts_per_revolution is None:
        raise ValueError("effects are put onto counts only")
    errors = [effect.error(motion, values) for effect, values in effects]
    count_m = 2.0 * np.pi * nominal.wheel.radius_m / nominal.wheel.counts_per_revolution

    def gained(rates: Sequence[Array | float], at_s: Array) -> Array:
        return _gained(motion, sum(rates, np.zeros_like(motion.time_s)), at_s)

    added = (
        gained(rates, log.time_s) / count_m for rates in ([e.left_m_s for e in errors], [e.right_m_s for e in errors])
    )
    # A count stands for the whole of its length: its middle is the best guess of where the wheel was.
    left, right = (np.floor(c + 0.5 + a) for c, a in zip((log.left_counts, log.right_counts), added, strict=True))
    made = replace(recording, wheels=replace(log, left_counts=left, right_counts=right))
    fog, reference = recording.fog, recording.reference
    if fog is not None:
        edges = np.concatenate([[2.0 * fog.time_s[0] - fog.time_s[1]], fog.time_s])
        turned = gained([e.gyro_rad_s for e in errors], edges)
        # Rounded twice, a small rate would be lost or doubled in one sample after the other.
        made = replace(made, fog=replace(fog, rate_rad_s=fog.rate_rad_s + np.diff(turned) / np.diff(edges)))
    if reference is not None:
        x, y = (
            gained([e.lateral_m_s * part for e in errors], reference.time_s)
            for part in (-np.sin(motion.heading_rad), np.cos(motion.heading_rad))
        )
        made = replace(made, reference=replace(reference, x_m=reference.x_m + x, y_m=reference.y_m + y))
    return made


def _gained(motion: Motion, rate: Array | float, at_s: Array) -> Array:
    """Integral of a rate from the motion's start to each time."""
    steps = np.gradient(motion.time_s)
    ends = np.concatenate([[motion.time_s[0] - 0.5 * steps[0]], motion.time_s + 0.5 * steps])
    return np.asarray(np.interp(at_s, ends, np.concatenate([[0.0], np.cumsum(rate * steps)])))
