"""The path around which errors are linear: as near to the truth as fixes and sensors know it."""

from dataclasses import replace
from typing import Final

import numpy as np

from drd_tools.diagnose.evidence import Evidence
from drd_tools.diagnose.linear import Linear, Path, dead_reckon

# What is missing from the model is no noise, but it must not keep the path from following the fixes.
LOOSER: Final = 10.0
ROUNDS: Final = 2


def follow(e: Evidence, near: Path | None = None) -> Path:
    """Dead-reckon, then bend the path to the fixes, with sensors that are trusted less than their sheets say.

    `near`: a path that is near already, and is bent once more.
    """
    turn = (e.right_m - e.left_m) / e.tread_m
    if e.gyro_rad is not None:
        known = e.still & (e.time_s < e.time_s[0] + e.standstill_s)
        bias = float(e.gyro_rad[known].sum() / e.step_s[known].sum()) if known.any() else 0.0
        turn = e.gyro_rad - bias * e.step_s
    path = (
        near
        if near is not None and len(e.fix)
        else dead_reckon(turn, 0.5 * (e.left_m + e.right_m), e.fix[0] if len(e.fix) else np.zeros(3))
    )
    if not len(e.fix):
        return path
    sheet = e.sheet
    loose = replace(
        sheet,
        walk_rad_per_sqrt_s=LOOSER * sheet.walk_rad_per_sqrt_s,
        bias_rad_s=LOOSER * sheet.bias_rad_s,
        slip_m_per_sqrt_m=LOOSER * sheet.slip_m_per_sqrt_m,
        lateral_m_per_sqrt_m=LOOSER * sheet.slip_m_per_sqrt_m,
    )
    for _ in range(ROUNDS if near is None else 1):
        path = Linear(e, path, loose).smoothed()
    return path
