"""Result of a gyro calibration: numbers, and the sentences and tables that terminal and report share."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drd_tools.calibrate.gyro.candidates import Candidate, beyond_the_file
from drd_tools.calibrate.gyro.data_sets import DataSets
from drd_tools.calibrate.gyro.error_function import ErrorFunction, Order
from drd_tools.calibrate.gyro.evaluation import Evaluation
from drd_tools.calibrate.gyro.rate_table import EARTH_RATE_DEG_H
from drd_tools.evaluate.metrics import rms

Rows = list[list[str]]
CANDIDATE_HEADER = ("order", "coefficients", "held-out / deg/s", "+-", "against chosen", "new data / deg/s", "")
POWERS = ("1", "w", "w^2", "w^3"), ("1", "T", "T^2")
MUCH = 3.0  # lack of fit over noise that is worth a sentence


@dataclass(frozen=True)
class GyroResult:
    """The chosen error function, all candidates, and its evaluation on held-out data sets.

    `inputs`: each file and its SHA-256; `forced`: the user set the order; `outside`: new data sets beyond the range.
    """

    inputs: Sequence[tuple[Path, str]]
    data: DataSets
    candidates: Sequence[Candidate]
    recommended: Candidate
    why: str
    chosen: Candidate
    fitted: ErrorFunction
    evaluation: Evaluation
    latitude_deg: float | None
    forced: bool
    outside: int

    @property
    def order(self) -> Order:
        """The order that was chosen."""
        return self.chosen.order

    def summary(self) -> list[str]:
        """The calibration in a few sentences."""
        before, after = rms(self.evaluation.before_deg_s), rms(self.evaluation.after_deg_s)
        low, high = self.evaluation.factor_range()
        (slow, fast), (cold, warm) = self.fitted.rate_range_deg_s, self.fitted.temperature_range_c
        n, worst = len(self.evaluation.data), int(np.argmax(np.abs(self.evaluation.after_deg_s)))
        lines = [
            f"The rms error falls from {before:.3g} to {after:.3g} deg/s on {n} {self.evaluation.how}: "
            f"{self.evaluation.factor:.3g} times smaller (95 % interval {low:.3g} to {high:.3g}).",
            f"The worst of them is {abs(self.evaluation.after_deg_s[worst]):.3g} deg/s off, at "
            f"{self._place(self.evaluation.data, worst)}; before, the worst was "
            f"{np.max(np.abs(self.evaluation.before_deg_s)):.3g} deg/s.",
        ]
        if (still := self.evaluation.without_static_bias()) is not None:
            lines.append(
                "The daemon measures the static bias at each start anyway. With it subtracted from both, the rms error "
                f"falls from {still[0]:.3g} to {still[1]:.3g} deg/s, {still[0] / max(still[1], 1e-300):.3g} times."
            )
        lines.append(f"It holds for readings from {slow:.4g} to {fast:.4g} deg/s at {cold:.3g} to {warm:.3g} degC.")
        return lines

    def choice(self) -> list[str]:
        """Sentences on why this order was chosen."""
        lines = [self.why]
        if self.forced and self.order != self.recommended.order:
            lines.append(f"Order {self.order} was requested and written.")
        return [line for line in (*lines, beyond_the_file(self.candidates, self.chosen)) if line]

    def notes(self) -> list[str]:
        """Caveats of the calibration, as sentences."""
        noise = float(np.median(self.data.sigma_deg_s))
        lines = [
            f"The Earth's rate at latitude {self.latitude_deg:g} deg was added to the table's: "
            f"{EARTH_RATE_DEG_H * np.sin(np.radians(self.latitude_deg)):.3g} deg/h."
            if self.latitude_deg is not None
            else f"The Earth's rate of the laboratory (up to {EARTH_RATE_DEG_H:g} deg/h, {EARTH_RATE_DEG_H / 3600:.4f} "
            "deg/s) is included in the constant coefficient; --latitude removes it."
        ]
        if self.fitted.between_deg_s > MUCH * noise:
            lines.append(
                f"The residual is {self.fitted.between_deg_s:.2g} deg/s between data sets, of which noise explains "
                f"{noise:.1g} deg/s: the rest is the polynomial's form, a lag of the thermometer, or the table."
            )
        if self.order.temperature == 0:
            lines.append("No term in temperature: at another temperature the daemon assumes a typical slope.")
        if self.evaluation.factor_range()[0] < 1.5:
            lines.append("Warning: the calibration hardly helps; the gyro's errors are not of this form, or are small.")
        if self.outside:
            lines.append(f"{self.outside} new data sets lie outside the valid range and were not counted.")
        rejected, light = int((self.fitted.weights == 0.0).sum()), int((self.fitted.weights < 0.5).sum())
        lines.append(
            f"Of {len(self.data)} data sets {rejected} were rejected as outliers and {light - rejected} counted less "
            f"than half; of {int((self.data.count + self.data.spikes).sum())} samples {int(self.data.spikes.sum())} "
            "were left out as spikes."
        )
        return lines

    def candidate_rows(self) -> Rows:
        """The candidates, for CANDIDATE_HEADER."""
        rows = []
        for c in self.candidates:
            if c.fitted is None:
                rows.append([str(c.order), str(c.order.coefficients), "-", "-", "-", "-", c.reason])
                continue
            marks = ["chosen"] * (c is self.chosen) + ["recommended"] * (c is self.recommended)
            marks += ["not in the file's form"] * (not c.order.fits_in_file)
            new = "-" if c.new_residual_deg_s is None else f"{rms(c.new_residual_deg_s):.5f}"
            ratio = f"x {c.held_out_deg_s / max(self.chosen.held_out_deg_s, 1e-300):.2f}"
            numbers = [f"{c.held_out_deg_s:.5f}", f"{c.standard_error_deg_s:.5f}", ratio, new]
            rows.append([str(c.order), str(c.order.coefficients), *numbers, ", ".join(marks)])
        return rows

    def coefficient_rows(self) -> Rows:
        """Rows of name, term, value, sigma, and distance from zero in sigmas."""
        sigma = np.sqrt(np.diag(self.fitted.covariance)).reshape(self.fitted.coefficients.shape)
        rows = []
        for (i, j), value in np.ndenumerate(self.fitted.coefficients):
            term = " ".join(name for name in (POWERS[0][i], POWERS[1][j]) if name != "1") or "1"
            rows.append([f"b_{i}{j}", term, f"{value:+.4e}", f"{sigma[i, j]:.1e}", f"{abs(value) / sigma[i, j]:.1f}"])
        return rows

    def outlier_rows(self) -> Rows:
        """Rejected data sets: source, rate and temperature, error, and residual."""
        residual = self.fitted.residual_deg_s(self.data)
        return [
            [self.data.label[k], self._place(self.data, k), f"{self.data.error_deg_s[k]:+.4f}", f"{residual[k]:+.4f}"]
            for k in np.flatnonzero(self.fitted.weights == 0.0).tolist()
        ]

    @staticmethod
    def _place(data: DataSets, k: int) -> str:
        return f"{data.table_rate_deg_s[k]:.4g} deg/s and {data.temperature_c[k]:.3g} degC"
