"""Tables of the wheel calibration, as text for the terminal and the report."""

import math
from collections.abc import Iterator, Sequence
from typing import Final

from drd.units import DEG_PER_RAD
from drd_tools.calibrate.wheels.drive import Drive
from drd_tools.calibrate.wheels.fit import WheelFit
from drd_tools.calibrate.wheels.found import Found
from drd_tools.calibrate.wheels.heldout import Error
from drd_tools.calibrate.wheels.lag import Lag
from drd_tools.calibrate.wheels.rest import Rest

_VALUES: Final = ("value", "nominal", "calibrated", "sigma", "between recordings", "change")
_SENSORS: Final = ("sensors", "found", "sigma", "between recordings")
_HELD_OUT: Final = ("held out", "path m", "end cm", "end % of path", "rms cm", "heading deg", "deg per 100 m")


def value_tables(found: Found) -> Iterator[tuple[Sequence[str], list[list[str]]]]:
    """Header and rows of two tables: the wheels' values, and results on the sensors."""
    yield _VALUES, _value_rows(found.fit, found.apart, found.drives[0])
    if rows := _sensor_rows(found.lag, found.rest):
        yield _SENSORS, rows


def _value_rows(fit: WheelFit, apart: Sequence[float], drive: Drive) -> list[list[str]]:
    """The three values, as text. `apart`: their relative spread between recordings, nan if unknown."""
    radii = fit.determined[0] and fit.determined[1]
    old, new = drive.nominal, fit.wheels
    rows = []
    for name, nominal, value, sigma, between, is_known in (
        ("left radius", old.left_radius_m, new.left_radius_m, fit.sigma[0], apart[0], radii),
        ("right radius", old.right_radius_m, new.right_radius_m, fit.sigma[1], apart[1], radii),
        ("effective tread", old.tread_m, new.tread_m, fit.sigma[2], apart[2], fit.determined[2]),
    ):
        known = [
            f"{value:.5f} m",
            f"{sigma * value:.5f} m ({100 * sigma:.2f} %)",
            "-" if math.isnan(between) else f"{100 * between:.2f} %",
            f"{100 * (value / nominal - 1):+.2f} %",
        ]
        rows.append(
            [name, f"{nominal:.5f} m", *(known if is_known else [f"{value:.5f} m", "not determined", "-", "-"])]
        )
    return rows


def _sensor_rows(lag: Lag | None, rest: Rest | None) -> list[list[str]]:
    """Rows of the results on the sensors, as text, without those that are not determined."""
    rows = []
    if lag is not None and lag.determined:
        apart = "-" if math.isnan(lag.spread_s) else f"{1000 * lag.spread_s:.1f} ms"
        name = f"lag of the wheels behind the {lag.against}"
        rows.append([name, f"{1000 * lag.lag_s:.1f} ms", f"{1000 * lag.sigma_s:.1f} ms", apart])
    if rest is not None and rest.noise_deg_per_sqrt_h is not None:
        noise, sigma = rest.noise_deg_per_sqrt_h, rest.noise_sigma
        rows.append(["gyro noise at rest", f"{noise:.3g} deg/sqrt(h)", f"{sigma:.2g} deg/sqrt(h)", "-"])
    if rest is not None and rest.bias_deg_s is not None:
        apart = "only noise" if rest.repeatability_deg_s is None else f"{rest.repeatability_deg_s:.2g} deg/s"
        rows.append(
            ["gyro bias at rest, rms", f"{rest.bias_deg_s:.2g} deg/s", f"{rest.bias_noise_deg_s:.2g} deg/s", apart]
        )
    return rows


def held_out_table(found: Found) -> tuple[Sequence[str], list[list[str]]]:
    """Header and rows: held-out figures, nominal -> calibrated, and over all of them."""
    figures, tread_m = found.figures, found.drives[0].nominal.tread_m
    rows = [_figure_row(f.drive.name, f.drive.path_m, f.nominal, f.calibrated, tread_m) for f in figures]
    count = len(figures)
    if count > 1:
        means = []
        for errors in ([f.nominal for f in figures], [f.calibrated for f in figures]):
            sums = [sum(abs(getattr(e, n)) for e in errors) for n in ("end_m", "end_heading_rad")]
            means.append(Error(sums[0] / count, math.sqrt(sum(e.rms_m**2 for e in errors) / count), sums[1] / count))
        rows.append(
            _figure_row("all (mean)", sum(f.drive.path_m for f in figures) / count, means[0], means[1], tread_m)
        )
    return _HELD_OUT, rows


def _figure_row(name: str, path_m: float, nominal: Error, calibrated: Error, tread_m: float) -> list[str]:
    def pair(digits: int, values: Sequence[float]) -> str:
        return f"{values[0]:.{digits}f} -> {values[1]:.{digits}f}"

    both = (nominal, calibrated)
    heading_deg = [DEG_PER_RAD * e.end_heading_rad for e in both]
    moved = path_m > 2.0 * tread_m
    return [
        name,
        f"{path_m:.1f}",
        pair(1, [100 * e.end_m for e in both]),
        pair(2, [100 * e.end_m / path_m for e in both]) if moved else "-",
        pair(1, [100 * e.rms_m for e in both]),
        pair(2, heading_deg),
        pair(0, [100 * abs(h) / path_m for h in heading_deg]) if moved else "-",
    ]
