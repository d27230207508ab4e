"""Range of its covariate in which an effect was seen; beyond it, a model keeps the values at the ends."""

from dataclasses import replace
from typing import Final

import numpy as np

from drd.effects.model import COVARIATES
from drd.effects.motion import Motion
from drd_tools.diagnose.results import Ranges
from drd_tools.diagnose.selected import Selected

TURNING_RAD_S: Final = 0.02  # slower, there is no curvature
SLOWEST_M_S: Final = 1e-3  # slower, dividing by speed amplifies noise


def seen(m: Motion, selected: Selected) -> dict[str, tuple[float, float]]:
    """The range of the covariate to which a lasting effect is limited, in its file's unit; empty if there is none."""
    if not selected.effect.lasting or selected.effect.proportional:
        return {}
    turning = np.abs(m.rate_rad_s) > TURNING_RAD_S
    lag_s = selected.effect.lag_s(selected.values)
    values = {
        "time": m.time_s,
        "yaw_rate": m.rate_rad_s,
        "speed": m.speed_m_s,
        "acceleration": m.acceleration_m_s2,
        "lateral_acceleration": m.speed_m_s * m.rate_rad_s,
        "curvature": np.abs(m.rate_rad_s[turning]) / np.maximum(np.abs(m.speed_m_s[turning]), SLOWEST_M_S),
        "temperature": m.temperature_c,
        "temperature_rate": m.temperature_rate_c_s(lag_s) if lag_s else np.zeros(0),
    }.get(selected.effect.covariate, np.zeros(0))
    if not len(values) or not np.isfinite(values).all() or not np.ptp(values) > 0.0:
        return {}
    si = COVARIATES[selected.effect.covariate].si
    return {selected.effect.covariate: (float(values.min()) / si, float(values.max()) / si)}


def within(m: Motion, ranges: Ranges) -> Motion:
    """Clip the motion's covariates to their ranges; the wheels' speeds follow."""
    for covariate, ends in ranges.items():
        low, high = (end * COVARIATES[covariate].si for end in ends)
        if covariate in ("time", "acceleration", "temperature"):
            name = {"time": "time_s", "acceleration": "acceleration_m_s2", "temperature": "temperature_c"}[covariate]
            m = replace(m, **{name: np.clip(getattr(m, name), low, high)})
            continue
        v, w = m.speed_m_s, m.rate_rad_s
        if covariate == "speed":
            v = np.clip(v, low, high)
        elif covariate == "yaw_rate":
            w = np.clip(w, low, high)
        elif covariate == "lateral_acceleration":
            w = np.divide(np.clip(v * w, low, high), v, out=w.copy(), where=np.abs(v) > SLOWEST_M_S)
        elif covariate == "curvature":
            bend = np.abs(w) / np.maximum(np.abs(v), SLOWEST_M_S)
            v = np.copysign(np.abs(w) / np.clip(bend, max(low, SLOWEST_M_S), high), v)
        ahead, half_turn = v - m.speed_m_s, 0.5 * m.tread_m * (w - m.rate_rad_s)
        left, right = m.left_m_s + ahead - half_turn, m.right_m_s + ahead + half_turn
        m = replace(m, speed_m_s=v, rate_rad_s=w, left_m_s=left, right_m_s=right)
    return m
