"""The path around which errors are linearised: the best estimate from fixes and sensors."""

from typing import Final

import numpy as np

from drd_tools.diagnose.error_model.linear import Linear
from drd_tools.diagnose.error_model.path import Path, dead_reckon
from drd_tools.diagnose.observe.evidence import Evidence

ROUNDS: Final = 2  # the second linearises around a path that is already bent to the fixes


def follow(e: Evidence) -> Path:
    """Dead-reckon with the measured constants, then smooth the path to the fixes, trusting the sensors less than their
    data sheets do.
    """
    # A tread 70 % off makes half a turn too much in a few seconds without gyro: no fix tells it from half too little.
    turn = e.apart_m / (e.tread_m * e.robot.tread)
    if e.gyro_rad is not None:
        known = e.still & (e.time_s < e.time_s[0] + e.standstill_s)
        bias = float(e.gyro_rad[known].sum() / e.step_s[known].sum()) if known.any() else 0.0
        turn = np.where(e.gyroless, turn, e.gyro_rad - bias * e.step_s)
    path = dead_reckon(turn, 0.5 * (e.left_m + e.right_m), e.fix[0] if len(e.fix) else np.zeros(3))
    for _ in range(ROUNDS if len(e.fix) else 0):
        path = inflated_model(e, path).smoothed()
    return path


def inflated_model(e: Evidence, path: Path, like: Linear | None = None) -> Linear:
    """Linear model with inflated noise, to bend a path to the fixes; `like`: a model whose gains are reused if near.

    With gains of another path the smoothed path is close to the best but not exact: compare only those of `follow`.
    """
    return Linear(e, path, e.datasheet.inflated(), like=like)
