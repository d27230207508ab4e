"""Errors of the gyro's heading against the reference, with or without a model, for recordings without wheels."""

import math
from pathlib import Path

import numpy as np
import numpy.typing as npt

from drd.arrays import Array
from drd.batch.run import zero_for_terms
from drd.batch.samples import MISSING_ROWS
from drd.config.keys import Robot
from drd.effects.compensation import Compensation
from drd.samples import CalibratedRate
from drd.units import DEG_PER_RAD, NS_PER_S
from drd_tools.diagnose.results import Figures
from drd_tools.recordings.folder import Recording
from drd_tools.replay.nominal import with_model


def heading_figures(recording: Recording, model: Path | None) -> Figures:
    """Errors of the integrated gyro heading, aligned with the reference's first row; none without a reference.

    The bias is that of the standstill at the start, as in the estimator. Raises ConfigError.
    """
    fog, reference = recording.fog, recording.reference
    assert fog is not None
    if reference is None:
        return {}
    if model is not None:
        recording = with_model(recording, model)
    whole_s = np.diff(fog.time_s, prepend=2.0 * fog.time_s[0] - fog.time_s[1])
    typical_s = float(np.median(whole_s))
    interval_s = np.where(whole_s > MISSING_ROWS * typical_s, typical_s, whole_s)
    standing = fog.time_s < fog.time_s[0] + recording.nominal.standstill_at_start_s
    rate = _corrected(recording, fog.rate_rad_s, fog.time_s, interval_s, fog.temperature_c, standing)
    bias = float(rate[standing].mean()) if standing.any() else 0.0
    heading = np.cumsum((rate - bias) * whole_s)
    inside = (reference.time_s >= fog.time_s[0]) & (reference.time_s <= fog.time_s[-1])
    if inside.sum() < 2:
        return {}
    error = np.interp(reference.time_s[inside], fog.time_s, heading) - reference.heading_rad[inside]
    # Sparse rows may have lost whole turns.
    error = DEG_PER_RAD * np.array([math.remainder(e, 2.0 * math.pi) for e in (error - error[0]).tolist()])
    return {"end_heading_deg": float(abs(error[-1])), "heading_rms_deg": float(np.sqrt(np.mean(error**2)))}


def _corrected(
    recording: Recording, rate: Array, time_s: Array, interval_s: Array, temperature_c: Array | None,
    standing: npt.NDArray[np.bool_],
) -> Array:  # fmt: skip
    """Rates (n,) with the recording's effects removed as in the daemon."""
    if not recording.terms:
        return rate
    # The wheels' sizes are required, but have no meaning here.
    robot = Robot(wheel_radius_m=1.0, tread_m=1.0)
    zero_s = zero_for_terms(float(time_s[0])) if recording.zero_s is None else recording.zero_s
    model = Compensation(recording.terms, robot, has_gyro=True, zero_ns=0, end_s=float(time_s[-1]) - zero_s)
    celsius = np.full(len(rate), np.nan) if temperature_c is None else temperature_c
    heading, found = 0.0, np.empty(len(rate))
    rows = zip(time_s.tolist(), interval_s.tolist(), rate.tolist(), celsius.tolist(), standing.tolist(), strict=True)
    for i, (t, h, w, c, still) in enumerate(rows):
        sample = CalibratedRate(round((t - zero_s) * NS_PER_S), h, w, 0.0)
        found[i] = model.gyro(sample, c, heading, still).rate_rad_s
        heading += found[i] * h
    return found
