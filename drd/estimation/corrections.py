"""Calibration and model corrections of the samples, and the reasons of a pose outside their ranges."""

from collections.abc import Callable

from drd.effects.compensation import Compensation
from drd.estimation.calibration import Calibration
from drd.estimation.health import Reasons
from drd.samples import CalibratedRate, GyroSample, WheelSample
from drd.units import NS_PER_S

# This long inside the model's range ends the report that it was left.
INSIDE_NS = 2 * NS_PER_S


class Corrections:
    """The gyro's calibration, followed by the removal of a model's effects.

    `heading_rad(t_ns)`: approximate heading of the robot in the middle of a sample that ends then. `late_ns`: largest
    delay that the model subtracts from stamps; `further_wait_ns`: how much longer gyro samples may take because of it.
    `counters` are the estimator's.
    """

    def __init__(
        self,
        calibration: Calibration | None,
        compensation: Compensation | None,
        heading_rad: Callable[[int], float],
        reasons: Reasons,
        counters: dict[str, int],
    ):
        self.compensation = compensation
        self.late_ns = self.further_wait_ns = 0
        self._calibration, self._heading_rad = calibration, heading_rad
        self._reasons, self._counters = reasons, counters
        self._outside_ns = 0

    def take_over(self, other: "Corrections") -> None:
        """Continue with another's state; its compensation is the same."""
        self.late_ns, self.further_wait_ns, self._outside_ns = other.late_ns, other.further_wait_ns, other._outside_ns

    def gyro(self, sample: GyroSample, standing: bool) -> CalibratedRate:
        """The calibrated rate without the model's effects; `standing`: the bias is still to be measured."""
        rate, model = self._calibrated(sample), self.compensation
        if model is None:
            return rate
        found = model.gyro(rate, sample.temperature_c, self._heading_rad(rate.t_ns), standing)
        self._tell_model(model, rate.t_ns)
        return found

    def wheels(self, sample: WheelSample) -> WheelSample:
        """The travel without the model's effects."""
        model = self.compensation
        if model is None:
            return sample
        found = model.wheels(sample, self._heading_rad(sample.t_ns))
        self._tell_model(model, sample.t_ns)
        return found

    @property
    def is_calibrated(self) -> bool:
        """Whether there is a calibration."""
        return self._calibration is not None

    @property
    def lateral_m_s(self) -> float:
        """The body's own speed to its left, which no sensor measures."""
        return self.compensation.lateral_m_s if self.compensation is not None else 0.0

    def _calibrated(self, sample: GyroSample) -> CalibratedRate:
        calibration = self._calibration
        if calibration is None:
            return CalibratedRate(sample.t_ns, sample.interval_s, sample.rate_rad_s, 0.0)
        inside = calibration.is_inside(sample)
        self._counters["outside_calibration"] += not inside
        text = None if inside else "rate or temperature outside the range of the gyro's calibration"
        self._reasons.update("calibration", text, sample.t_ns)
        return calibration.correct(sample)

    def _tell_model(self, model: Compensation, t_ns: int) -> None:
        """Update the waits by the model's delays, and the health by its range, after each sample."""
        self.late_ns = max(model.gyro_delay_ns, model.wheel_delay_ns)
        self.further_wait_ns = max(0, model.gyro_delay_ns - model.wheel_delay_ns)
        if model.outside:
            self._counters["outside_model"] += 1
            self._outside_ns = t_ns
            self._reasons.set("model", "outside the range in which the model's effects were observed", t_ns)
        elif t_ns - self._outside_ns > INSIDE_NS:
            self._reasons.clear("model")
