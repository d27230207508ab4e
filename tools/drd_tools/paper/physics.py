"""Physical parameters of the simulation, the same for all cells of Table II."""

from dataclasses import dataclass, field
from typing import Any, Final

# Table I of the paper (KVH E-Core RD2100).
TABLE_I: Final = "Table I"


def parameter(value: float, unit: str, text: str, source: str) -> Any:
    """A physical parameter with unit, description and source."""
    return field(default=value, metadata={"unit": unit, "text": text, "source": source})


@dataclass(frozen=True, kw_only=True)
class Gyro:
    """Population of the gyros."""

    full_scale_deg_s: float = parameter(100.0, "deg/s", "largest rate", TABLE_I)
    count_deg_s: float = parameter(100.0 / 32768, "deg/s", "one count of a reading", "Table I, 16 bits")
    nonlinearity: float = parameter(
        0.005, "rms", "deviation of the scale factor from the straight line, over all rates", TABLE_I
    )
    scale_over_temperature: float = parameter(0.02, "p-p", "change of the scale from -40 to 75 degC", TABLE_I)
    bias_over_temperature_deg_s: float = parameter(0.2, "deg/s p-p", "change of the bias from -40 to 75 degC", TABLE_I)
    bias_stability_deg_s: float = parameter(0.002, "deg/s", "wandering of the bias at constant temperature", TABLE_I)
    bias_correlation_s: float = parameter(300.0, "s", "time in which it wanders", "assumed: some minutes")
    walk_deg_per_sqrt_h: float = parameter(5 / 60, "deg/sqrt(h)", "angle random walk", TABLE_I)
    thermometer_c: float = parameter(0.1, "degC", "one count of the temperature", "assumed: no manual is public")
    delay_s: float = parameter(
        0.05, "s", "age of a reading that nobody compensates", "protocols of the sensor: filter, line, adapter"
    )


@dataclass(frozen=True, kw_only=True)
class Weather:
    """Temperature of the gyro during the ten runs."""

    coldest_c: float = parameter(10.0, "degC", "ambient temperature, lowest of the uniform draw", "assumed")
    warmest_c: float = parameter(30.0, "degC", "and highest", "assumed")
    self_heating_c: float = parameter(10.0, "degC", "rise after switching on", "FOGs: 10 to 20")
    self_heating_s: float = parameter(900.0, "s", "its time constant", "FOGs: 3 to 15 min")
    run_period_s: float = parameter(
        240.0, "s", "from the start of one run to the next", "about three minutes and a pause"
    )


@dataclass(frozen=True, kw_only=True)
class Robot:
    """The Pioneer AT: four driven wheels that skid in turns. Errors are those left by a good calibration."""

    scale_sigma: float = parameter(0.001, "1", "error of each side's wheel radius", "UMBmark's accuracy")
    tread_sigma: float = parameter(0.003, "1", "error of the effective tread on this ground", "UMBmark's accuracy")
    skid: float = parameter(
        0.02, "1", "fluctuation of the effective tread as the tyres grip and slip", "smooth asphalt: some per cent"
    )
    skid_length_m: float = parameter(0.5, "m", "travel over which it changes", "about the wheelbase")
    pavement_m_per_sqrt_m: float = parameter(0.002, "m/sqrt(m)", "each side's travel: irregular ground", "assumed")
    bump_per_m: float = parameter(0.5, "1/m", "cracks and stones, which only ever add travel (section 3.1)", "assumed")
    bump_m: float = parameter(0.002, "m", "travel that one adds, on average", "assumed")


@dataclass(frozen=True, kw_only=True)
class RateTable:
    """Calibration of each gyro on a rate table."""

    coldest_c: float = parameter(0.0, "degC", "lowest temperature of the chamber", "assumed")
    warmest_c: float = parameter(45.0, "degC", "highest", "assumed")
    temperatures: float = parameter(6, "", "number of temperatures", "assumed")
    rate_step_deg_s: float = parameter(10.0, "deg/s", "between the table's rates, up to 95 % of full scale", "Figure 1")
    dwell_s: float = parameter(20.0, "s", "at each rate", "assumed")


@dataclass(frozen=True, kw_only=True)
class Physics:
    """All physical parameters."""

    gyro: Gyro = Gyro()
    weather: Weather = Weather()
    robot: Robot = Robot()
    table: RateTable = RateTable()
