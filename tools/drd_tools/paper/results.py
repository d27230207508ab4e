"""Results of `drd paper`: computed once, saved as JSON, then reported and drawn any number of times."""

import dataclasses
from typing import ClassVar, Final

import numpy as np

from drd.arrays import Array
from drd_tools.report.saved import Saved

RESAMPLES: Final = 2000


@dataclasses.dataclass(frozen=True)
class Results(Saved):
    """Arrays over gyros (g), runs (r, cw first), cells (c, of runs.CELLS) and seconds (s). Metres, degrees."""

    FORMAT: ClassVar = "drd-paper/2"
    COMMAND: ClassVar = "drd paper"

    return_m: Array  # (g, r, c)
    largest_m: Array  # (g, r, c)
    heading_deg: Array  # (g, r, c)
    bound_m: Array  # (g, r, c)
    trace_m: Array  # (3, c, s): 5th, 50th and 95th percentile of the position error over gyros and runs
    example_true_m: Array  # (s, 2): cw run of the first gyro
    via_m: Array  # (8, 2): beginnings and ends of the corners
    example_m: Array  # (c, s, 2)
    table_deg_s: Array  # (g, 2): rms error of new rate-table data before and after calibration
    figure3: Array  # (n, 4): one gyro's new data sets: rate in deg/s, temperature, error before and after in deg/s
    variance_time_s: Array  # (k,)
    variance_sigma: Array  # (k, 9)
    delay: Array  # (d, 3): delay in s, return error, largest error on the way
    comparing_m: Array  # (k, 2): sigma of the return position, gyro calibrated, with and without comparing headings
    others: Array  # (v, 2): mean return error of the other robots, without filter and with it
    other_names: list[str]
    parameters: list[list[str]]  # name, value, unit, meaning, source
    told: list[list[str]]  # configuration key, value
    seed: int

    @property
    def runs_each_way(self) -> int:
        """Runs in one direction."""
        return len(self.return_m[0]) // 2


def factors(return_m: Array, cell: int, seed: int = 0) -> tuple[float, float, float]:
    """Factor by which the mean error is smaller in a cell than in the first, with the 95 % interval over gyros."""
    mean = return_m.mean(axis=1)
    picked = np.random.default_rng(seed).integers(len(mean), size=(RESAMPLES, len(mean)))
    resampled = mean[picked].mean(axis=1)
    low, high = np.percentile(resampled[:, 0] / resampled[:, cell], (2.5, 97.5))
    return float(mean[:, 0].mean() / mean[:, cell].mean()), float(low), float(high)


def single_factors(return_m: Array, cell: int) -> Array:
    """The same factor for each single gyro, shape (g,)."""
    mean = return_m.mean(axis=1)
    return np.asarray(mean[:, 0] / mean[:, cell])
