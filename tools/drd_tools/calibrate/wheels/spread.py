"""How much a value differs from recording to recording, beyond what the noise of each explains."""

import math
from collections.abc import Sequence

import numpy as np
from scipy.optimize import brentq
from tqdm import tqdm

from drd.arrays import Array
from drd_tools.calibrate.wheels.drive import Drive
from drd_tools.calibrate.wheels.fit import WheelFit, fit_wheels


def spread(values: Array, variances: Array) -> float:
    """Standard deviation between values, shape (n,), whose own variances are known; nan for fewer than two.

    After Paule and Mandel: s is such that sum (value - mean)^2 / (variance + s^2) is n - 1, the mean being weighted
    alike; 0 where the variances explain all. (54)
    """
    count = len(values)
    if count < 2:
        return math.nan

    def excess(squared: float) -> float:
        weights = 1.0 / np.maximum(variances + squared, 1e-300)
        mean = float(weights @ values / weights.sum())
        return float(weights @ (values - mean) ** 2) - (count - 1)

    if excess(0.0) <= 0.0:
        return 0.0
    high = float(np.ptp(values)) ** 2
    return math.sqrt(brentq(excess, 0.0, high, xtol=1e-12 * high))


def wheel_spread(drives: Sequence[Drive], fit: WheelFit) -> tuple[float, ...]:
    """Spread of left radius, right radius and tread, relative to `fit`; nan where fewer than two drives tell a value.

    Each drive is fitted by itself, with the mounting of all: it would trade that for radii and tread. One that does not
    tell a value is no witness for it. Its own noise is what its windows show: slip as on a data sheet is often larger,
    and would hide how much drives differ.
    """
    if len(drives) < 2:
        return math.nan, math.nan, math.nan
    alone = [
        fit_wheels([drive], fit, fit.mounting) for drive in tqdm(drives, desc="by itself", disable=None, leave=False)
    ]
    found = []
    for k, joint in enumerate(fit.wheels):
        informative = [f for f in alone if (all(f.determined[:2]) if k < 2 else f.determined[2])]
        ratios = np.array([f.wheels[k] / joint for f in informative])
        found.append(
            spread(ratios, np.array([(f.window_sigma[k] * r) ** 2 for f, r in zip(informative, ratios, strict=True)]))
        )
    return tuple(found)
