"""Data sets: the gyro on a rate table at one rate and nearly one temperature, reduced to robust means. (4)"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields
from typing import Final

import numpy as np
import numpy.typing as npt

from drd.arrays import Array
from drd_tools import robust

Counts = npt.NDArray[np.int64]

SETTLE_S: Final = 1.0
MAX_SPREAD_C: Final = 2.0  # a dwell whose temperature varies more is cut: 0.02 % of scale at the paper's 2 % p-p
MIN_SAMPLES: Final = 10  # fewer determine their own scatter to no better than a quarter
SPIKE_SIGMA: Final = 5.0
USUAL_STEPS_C: Final = (1.0, 0.5, 0.25, 0.1, 0.05, 0.02, 0.01)


@dataclass(frozen=True)
class DataSets:
    """Means of n data sets, each array of shape (n,). The error is `rate_deg_s - table_rate_deg_s`. (1)

    `sigma_deg_s`: standard deviation of the mean reading, from the samples' scatter; `temperature_sigma_c`: that of the
    temperature, from the sensor's resolution (assuming readings centred on the truth). `count`: samples in the mean;
    `spikes`: samples left out of it. `label`: source of the data set. Raises ValueError for other shapes,
    non-finite values, a sigma that is not positive, or a negative temperature sigma.
    """

    table_rate_deg_s: Array
    rate_deg_s: Array
    temperature_c: Array
    sigma_deg_s: Array
    temperature_sigma_c: Array
    count: Counts
    spikes: Counts
    label: tuple[str, ...]

    def __post_init__(self) -> None:
        for field in fields(self):
            if len(getattr(self, field.name)) != len(self.table_rate_deg_s):
                raise ValueError(f"{field.name}: expected {len(self.table_rate_deg_s)} elements")
        values = np.array([getattr(self, field.name) for field in fields(self)[:5]])
        if not (np.isfinite(values).all() and (values[3] > 0.0).all() and (values[4] >= 0.0).all()):
            raise ValueError("data sets: expected finite numbers and a positive sigma")

    def __len__(self) -> int:
        return len(self.table_rate_deg_s)

    @property
    def error_deg_s(self) -> Array:
        """Error of each mean reading, shape (n,). (1)"""
        return self.rate_deg_s - self.table_rate_deg_s

    def select(self, index: npt.NDArray[np.bool_] | Counts) -> "DataSets":
        """Select the data sets of a mask or of indices."""
        chosen = {field.name: getattr(self, field.name)[index] for field in fields(self)[:-1]}
        return DataSets(label=tuple(np.array(self.label, dtype=object)[index]), **chosen)


def joined(parts: Sequence[DataSets]) -> DataSets:
    """Join the data sets of `parts` (at least one) in their order."""
    names = [field.name for field in fields(DataSets)[:-1]]
    arrays = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
    return DataSets(label=tuple(label for part in parts for label in part.label), **arrays)


def data_sets_of_samples(
    time_s: Array,
    table_rate_deg_s: Array,
    rate_deg_s: Array,
    temperature_c: Array,
    *,
    settle_s: float = SETTLE_S,
    describe: Callable[[int, int], str] = lambda first, last: f"samples {first + 1} to {last}",
) -> DataSets:
    """Cut a recording where the table's rate changes, drop the settling time, reduce each piece to its means.

    Arrays of shape (k,), finite, time increasing. Pieces of fewer than 10 samples (the table's ramps) are left out;
    the result may be empty. `describe(first, last)` labels the samples first <= i < last.
    """
    step_deg_s, step_c = resolution_deg_s(rate_deg_s), resolution_c(temperature_c)
    rows: list[tuple[float, float, float, float, float, int, int]] = []
    labels: list[str] = []
    for first, last in _dwells(table_rate_deg_s):
        begin = first + int(np.searchsorted(time_s[first:last], time_s[first] + settle_s))
        for low, high in _pieces(temperature_c, begin, last):
            piece = slice(low, high)
            rate = rate_deg_s[piece]
            good = _without_spikes(rate, step_deg_s)
            count = int(good.sum())
            table, temperature = float(table_rate_deg_s[piece][good].mean()), float(temperature_c[piece].mean())
            if np.ptp(temperature_c[piece]) > MAX_SPREAD_C:  # after the cutting, only spikes are left
                temperature = float(np.median(temperature_c[piece]))
            scatter = float(rate[good].std(ddof=1))
            # A temperature that passes through several steps is better known than one that stays at one.
            steps = max(1.0, float(np.ptp(temperature_c[piece])) / step_c) if step_c else 1.0
            temperature_sigma = step_c / np.sqrt(12.0) / steps
            rate_mean = float(rate[good].mean())
            rows.append((table, rate_mean, temperature, scatter, temperature_sigma, count, len(rate) - count))
            labels.append(describe(low, high))
    columns = np.array(rows, dtype=np.float64).reshape(-1, 7).T
    count = columns[5].astype(np.int64)
    # A scatter far below the others' is chance or quantisation: the mean is not that accurate.
    floor = max(0.5 * float(np.median(columns[3])) if rows else 0.0, step_deg_s / np.sqrt(12.0), 1e-9)
    sigma = np.maximum(columns[3], floor) / np.sqrt(np.maximum(count, 1))
    spikes = columns[6].astype(np.int64)
    return DataSets(columns[0], columns[1], columns[2], sigma, columns[4], count, spikes, tuple(labels))


def resolution_deg_s(rate_deg_s: Array) -> float:
    """Resolution of the gyro: the smallest difference between readings; 0 if there is none."""
    steps = np.diff(np.unique(rate_deg_s))
    steps = steps[steps > 1e-6]  # smaller ones come from a text file's decimals
    return float(steps.min()) if len(steps) else 0.0


def resolution_c(temperature_c: Array) -> float:
    """Resolution of a thermometer: the coarsest usual step that fits its readings; 0 if none does."""
    for step in USUAL_STEPS_C:
        if np.abs(temperature_c - step * np.round(temperature_c / step)).max(initial=0.0) < 1e-6:
            return step
    return 0.0


def _dwells(table_rate_deg_s: Array) -> Iterator[tuple[int, int]]:
    """Ranges of samples in which the table holds its rate to 0.1 deg/s and 0.1 %."""
    rates = table_rate_deg_s.tolist()
    first = 0
    for i, rate in enumerate(rates):
        if abs(rate - rates[first]) > 0.1 + 0.001 * abs(rates[first]):
            yield first, i
            first = i
    if rates:
        yield first, len(rates)


def _pieces(temperature_c: Array, first: int, last: int) -> Iterator[tuple[int, int]]:
    """Halve a dwell until its temperature stays within MAX_SPREAD_C."""
    if last - first < MIN_SAMPLES:
        return
    low, high = np.percentile(temperature_c[first:last], (5.0, 95.0))
    if high - low <= MAX_SPREAD_C or last - first < 2 * MIN_SAMPLES:
        yield first, last
        return
    middle = (first + last) // 2
    yield from _pieces(temperature_c, first, middle)
    yield from _pieces(temperature_c, middle, last)


def _without_spikes(rate_deg_s: Array, step_deg_s: float) -> npt.NDArray[np.bool_]:
    """True where a sample is no spike: within five robust standard deviations, or two steps, of the median."""
    deviation = np.abs(rate_deg_s - np.median(rate_deg_s))
    scale = robust.deviation(deviation, 0.0) or float(deviation.mean())
    return deviation <= max(SPIKE_SIGMA * scale, 2.0 * step_deg_s)
