"""Effective tread and difference of the wheel radii from a gyro, where no dense reference determines them. (56)"""

from typing import Final, NamedTuple

import numpy as np

from drd_tools.calibrate.wheels.turns import of_wheels
from drd_tools.recordings.folder import Recording

ROUNDS: Final = 10  # of reweighting, after which weights change by less than a thousandth


class ByGyro(NamedTuple):
    """Tread and difference of the radii (right minus left), relative to the nominal tread and radius, and their
    standard deviations. The mean radius is taken as nominal.
    """

    tread: float
    difference: float
    tread_sigma: float
    difference_sigma: float


def fit_by_gyro(recording: Recording, late_s: float, growth: float) -> ByGyro | None:
    """Regress the wheels' turns on the gyro's, with Huber's weights; None if the rows do not determine the result.

    `late_s`, `growth`: lag of the wheels behind the gyro at time 0, and its growth, s/s.
    """
    turns = of_wheels(recording, "gyro")
    if turns is None:
        return None
    y, X = turns.columns(late_s + growth * turns.at_s)
    for _ in range(ROUNDS):
        weighted = X * turns.weights[:, None]
        try:
            inverse = np.linalg.inv(weighted.T @ X)
        except np.linalg.LinAlgError:  # it does not turn, or does not move forward
            return None
        x = inverse @ (weighted.T @ y)
        turns.reweigh(y - X @ x)
    scores = turns.by_block(X * (turns.weights * (y - X @ x))[:, None])
    V = inverse @ (scores.T @ scores) @ inverse * len(scores) / max(len(scores) - 1, 1)
    if len(scores) < 2 or x[0] <= 0.0 or not np.isfinite(V).all():
        return None
    tread_sigma, difference_sigma, _ = np.sqrt(np.diag(V)).tolist()
    # A right wheel larger than nominal reads too little: on a straight, it shows a turn to the right.
    return ByGyro(float(x[0]), -float(x[1]), tread_sigma, difference_sigma)
