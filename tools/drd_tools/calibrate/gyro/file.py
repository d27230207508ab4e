"""Writer of the calibration file, from which the daemon's loader reads exactly the same numbers."""

from pathlib import Path

import yaml

from drd.estimation.calibration import FORMAT, Calibration

HEAD = """\
# Calibration of a gyro, for `calibration.file` of the daemon's configuration.
# error(w, T) = sum of a_i w^i, i = 0..3, with a_i = b_i0 + b_i1 T + b_i2 T^2; w: reading in deg/s, T: degC.
# Each a_i lists b_i0, b_i1, b_i2. The corrected rate is w - error(w, T). Residuals are rms, in deg/s, of data sets that
# the fit has not seen. covariance: of b_00, b_01, b_02, b_10, ... b_32, one row for each.
"""


def write_calibration(file: Path, calibration: Calibration) -> None:
    """Write the file that `drd.estimation.calibration.load_calibration` reads. Raises OSError."""
    data: dict[str, object] = {
        "format": FORMAT,
        "error_deg_s": {f"a{i}": list(row) for i, row in enumerate(calibration.rows)},
        "rate_range_deg_s": list(calibration.rate_range_deg_s),
        "temperature_range_c": list(calibration.temperature_range_c),
        "residual_deg_s": calibration.residual_deg_s,
    }
    if calibration.residual_before_deg_s is not None:
        data["residual_before_deg_s"] = calibration.residual_before_deg_s
    if calibration.covariance:
        data["covariance"] = [list(row) for row in calibration.covariance]
    numbers = yaml.safe_dump(data, sort_keys=False, default_flow_style=None, width=400)
    provenance = {"provenance": dict(calibration.provenance)}
    sources = yaml.safe_dump(provenance, sort_keys=False, width=400, allow_unicode=True)
    file.write_text(HEAD + numbers + sources, encoding="utf-8")
