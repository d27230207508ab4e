"""Effective tread, and the difference of the wheels' radii, by a gyro: where no dense reference tells them. (56)"""

from typing import Final, NamedTuple

import numpy as np

from drd_tools.calibrate.wheels.turns import of_wheels
from drd_tools.recordings.folder import Recording

ROUNDS: Final = 10  # of weights, which then change by less than a thousandth


class ByGyro(NamedTuple):
    """Tread over the nominal one, for wheels whose mean radius is the nominal one; radius of the right wheel less that
    of the left, over the nominal one; and their standard deviations.
    """

    tread: float
    difference: float
    tread_sigma: float
    difference_sigma: float


def fit_by_gyro(recording: Recording, late_s: float, growth: float) -> ByGyro | None:
    """Least squares of the wheels' turns over the gyro's, with Huber's weights; None where the rows do not tell.

    `late_s`, `growth`: lag of the wheels behind the gyro at time 0, and by how much it grows, s/s.
    """
    turns = of_wheels(recording, "gyro")
    if turns is None:
        return None
    y, X = turns.columns(late_s + growth * turns.at_s)
    for _ in range(ROUNDS):
        weighted = X * turns.weights[:, None]
        try:
            inverse = np.linalg.inv(weighted.T @ X)
        except np.linalg.LinAlgError:  # it does not turn, or does not move ahead
            return None
        x = inverse @ (weighted.T @ y)
        turns.reweigh(y - X @ x)
    scores = turns.by_block(X * (turns.weights * (y - X @ x))[:, None])
    V = inverse @ (scores.T @ scores) @ inverse * len(scores) / max(len(scores) - 1, 1)
    if len(scores) < 2 or x[0] <= 0.0 or not np.isfinite(V).all():
        return None
    tread_sigma, difference_sigma, _ = np.sqrt(np.diag(V)).tolist()
    # A right wheel that is larger than believed reads too little: on a straight, a turn to the right.
    return ByGyro(float(x[0]), -float(x[1]), tread_sigma, difference_sigma)
