"""Spread of a value between recordings, beyond the noise of each."""

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

    After Paule and Mandel: s is such that sum (value - mean)^2 / (variance + s^2) is n - 1, with a mean of the same
    weights; 0 if the variances explain all. (54)
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
    """Spread of left radius, right radius and tread, relative to `fit`; nan if fewer than two drives determine a value.

    Each drive is fitted alone, with the common mounting, which would otherwise be confounded with radii and tread.
    Drives that do not determine a value are left out. The noise of each is that of its windows: datasheet slip is
    often larger, and would hide differences between drives.
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
