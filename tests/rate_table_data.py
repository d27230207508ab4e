"""A simulated gyro on a rate table, with the paper's Table I; shares no formula with the fit."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from drd.arrays import Array
from drd_tools.calibrate.gyro.data_sets import DataSets

ErrorLaw = Callable[[Array, Array], Array]  # error for a true rate in deg/s and a temperature in degC

ARW_DEG_S_ROOT_HZ = 5.0 / 3600.0
RATES = tuple(range(-100, 101, 20))
TEMPERATURES = tuple(range(-20, 61, 10))


def rd2100_error(w: Array, T: Array) -> Array:
    """Table I, not as a polynomial: 0.5 % rms of full scale; scale 2 %, bias 0.2 deg/s p-p over -40..75 degC."""
    x, t = w / 100.0, (T - 17.5) / 57.5
    nonlinearity = 2.35 * (np.sin(2.2 * x) - 1.30 * x) + 0.12 * (1.0 - np.cos(1.5 * x))
    scale = 0.01 * np.sin(1.4 * t) / np.sin(1.4)
    bias = 0.1 * np.tanh(1.3 * t + 0.3) / np.tanh(1.6)
    error: Array = nonlinearity + scale * w + bias
    return error


def reading_of(w: Array, T: Array, law: ErrorLaw) -> Array:
    """Reading of a noise-free gyro at the true rate."""
    return w + law(w, T)


def means(
    law: ErrorLaw,
    rng: np.random.Generator,
    rates: Sequence[float] = RATES,
    temperatures: Sequence[float] = TEMPERATURES,
    seconds: float = 30.0,
) -> tuple[Array, Array, Array, Array]:
    """Table rate, mean reading, temperature and sigma of each data set."""
    T, w = (a.ravel() for a in np.meshgrid(np.asarray(temperatures, float), np.asarray(rates, float), indexing="ij"))
    T = T + rng.uniform(-1.0, 1.0, len(T))
    sigma = np.full(len(w), ARW_DEG_S_ROOT_HZ / np.sqrt(seconds))
    return w, reading_of(w, T, law) + sigma * rng.standard_normal(len(w)), T, sigma


def samples(
    rng: np.random.Generator,
    rates: Sequence[float] = RATES,
    temperature_c: float = 25.0,
    *,
    law: ErrorLaw = rd2100_error,
    seconds: float = 8.0,
    rate_hz: float = 10.0,
    resolution_deg_s: float = 0.004,
    step_c: float = 0.1,
    spikes: float = 0.0,
    settle_s: float = 0.5,
) -> tuple[Array, Array, Array, Array]:
    """A recording that steps through the rates: time, table rate, reading, temperature; the table lags behind."""
    n = round(seconds * rate_hz)
    time_s = np.arange(1, n * len(rates) + 1) / rate_hz
    table = np.repeat(np.asarray(rates, float), n)
    since = np.tile(np.arange(n) / rate_hz, len(rates))
    before = np.repeat(np.concatenate([[0.0], np.asarray(rates, float)[:-1]]), n)
    w = np.where(since < settle_s, before + (table - before) * since / max(settle_s, 1e-9), table)
    T = temperature_c + np.linspace(0.0, 0.6, len(time_s))  # the gyro warms itself
    rate = reading_of(w, T, law) + ARW_DEG_S_ROOT_HZ * np.sqrt(rate_hz) * rng.standard_normal(len(w))
    hit = rng.random(len(rate)) < spikes
    rate = np.where(hit, rate + rng.choice([-1.0, 1.0], len(rate)) * rng.uniform(0.5, 50.0, len(rate)), rate)
    rate = resolution_deg_s * np.round(rate / resolution_deg_s)
    return time_s, table, rate, step_c * np.round(T / step_c)


def write_csv(file: Path, columns: Sequence[Array]) -> Path:
    header = "time_s,table_rate_deg_s,rate_deg_s,temperature_c\n"
    lines = (f"{t:.3f},{w:g},{g:.4f},{c:.2f}\n" for t, w, g, c in zip(*columns, strict=True))
    file.write_text(header + "".join(lines), encoding="utf-8")
    return file


def write_table(
    folder: Path, rng: np.random.Generator, temperatures: Sequence[float] = TEMPERATURES, **options: object
) -> Path:
    """Write one file for each temperature."""
    folder.mkdir(parents=True, exist_ok=True)
    for temperature in temperatures:
        write_csv(folder / f"rates_{temperature:+.0f}c.csv", samples(rng, temperature_c=temperature, **options))  # type: ignore[arg-type]
    return folder


def of_means(w: Array, g: Array, T: Array, sigma: Array, temperature_sigma_c: float = 0.0) -> DataSets:
    """Data sets from known means, each of shape (n,)."""
    n = len(w)
    counts = np.ones(n, np.int64), np.zeros(n, np.int64)
    return DataSets(w, g, T, sigma, np.full(n, temperature_sigma_c), *counts, ("",) * n)
