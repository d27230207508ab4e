"""Accuracy of a calibration: errors of held-out data sets, before and after the correction."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from drd.arrays import Array
from drd_tools.calibrate.gyro.candidates import TEMPERATURE_STEP_C
from drd_tools.calibrate.gyro.data_sets import DataSets
from drd_tools.evaluate.metrics import rms

RESAMPLES: Final = 1000


@dataclass(frozen=True)
class Evaluation:
    """Errors of n unseen data sets, shape (n,) each: `before_deg_s` as read (1), `after_deg_s` corrected (6).

    `how`: where the unseen data sets come from, for a sentence.
    """

    data: DataSets
    after_deg_s: Array
    how: str

    @property
    def before_deg_s(self) -> Array:
        """Errors of the uncorrected readings. (1)"""
        return self.data.error_deg_s

    @property
    def factor(self) -> float:
        """Ratio of the rms error before the correction to that after it."""
        return rms(self.before_deg_s) / max(rms(self.after_deg_s), 1e-300)

    def factor_range(self) -> tuple[float, float]:
        """95 % interval of `factor`, by resampling the data sets (bootstrap, fixed seed)."""
        draws = np.random.default_rng(1).integers(0, len(self.data), (RESAMPLES, len(self.data)))
        before, after = (np.sqrt(np.mean(x[draws] ** 2, axis=1)) for x in (self.before_deg_s, self.after_deg_s))
        low, high = np.percentile(before / np.maximum(after, 1e-300), (2.5, 97.5))
        return float(low), float(high)

    def without_static_bias(self) -> tuple[float, float] | None:
        """Rms errors before and after, both less the error at standstill at the same temperature.

        The daemon removes that error at its start, so this is its gain from the calibration. None if some data set has
        none at standstill within 3 degC.
        """
        still = np.flatnonzero(np.abs(self.data.table_rate_deg_s) < 0.01)  # the Earth's rate may be included
        if not len(still):
            return None
        distance = np.abs(self.data.temperature_c[:, None] - self.data.temperature_c[still])
        if (distance.min(axis=1) > TEMPERATURE_STEP_C).any():
            return None
        nearest = still[np.argmin(distance, axis=1)]
        moving = np.abs(self.data.table_rate_deg_s) >= 0.01
        before, after = (x[moving] - x[nearest][moving] for x in (self.before_deg_s, self.after_deg_s))
        return rms(before), rms(after)
