"""The gyro's calibration as one HTML page and the paper's three figures."""

from pathlib import Path

from drd_tools.calibrate.gyro.figures import before_and_after, error_over_rate, error_over_temperature
from drd_tools.calibrate.gyro.result import CANDIDATE_HEADER, GyroResult
from drd_tools.evaluate.metrics import rms
from drd_tools.report.page import Page


def write_report(folder: Path, result: GyroResult) -> list[Path]:
    """Write figure1.png, figure2.png, figure3.png and report.html; returns their paths. Raises OSError."""
    figures = [folder / f"figure{k}.png" for k in (1, 2, 3)]
    after = rms(result.evaluation.after_deg_s)
    middle_c = error_over_rate(figures[0], result.fitted, result.data, after)
    error_over_temperature(figures[1], result.fitted, result.data)
    before_and_after(figures[2], result.evaluation)
    page = Page("Calibration of the gyro", result.summary())
    page.heading("How good it is")
    page.picture(
        figures[2],
        "Figure 3. Error of each unseen data set, (a) as read and (b) after the correction. The light band in (a) is "
        "the whole height of (b). Colour is temperature.",
    )
    page.text(*result.notes())
    page.heading("The error function")
    page.picture(
        figures[0],
        f"Figure 1. Left: error against rate at {middle_c:.1f} degC, the middle one. Right: what the fit leaves. Bars "
        "are two sigma of the samples' noise; the band is two sigma of a corrected rate.",
    )
    page.picture(figures[1], "Figure 2. Error against temperature at several rates.")
    _coefficients(page, result)
    page.heading("Candidates")
    page.text(
        "The order is the highest power of the rate, then of the temperature. Held-out: rms error of data sets that "
        "the fit had not seen, by tenfold cross-validation over whole data sets.",
        *result.choice(),
    )
    chosen = [k for k, c in enumerate(result.candidates) if c is result.chosen]
    page.table(CANDIDATE_HEADER, result.candidate_rows(), chosen=chosen, text_columns=(6,))
    page.heading("What it was made from")
    if rows := result.outlier_rows():
        page.table(("rejected data set", "where", "error / deg/s", "off the fit / deg/s"), rows, text_columns=(1,))
    page.inputs({str(file): digest for file, digest in result.inputs})
    page.save(folder / "report.html")
    return [folder / "report.html", *figures]


def _coefficients(page: Page, result: GyroResult) -> None:
    fitted = result.fitted
    page.table(
        ("coefficient", "of", "value", "sigma", "sigmas from zero"),
        result.coefficient_rows(),
        "error(w, T) in deg/s, reading w in deg/s, temperature T in degC",
        text_columns=(1,),
    )
    page.text(
        f"Fitted with rate and temperature scaled to -1..1 (condition number {fitted.condition_scaled:.3g}; "
        f"{fitted.condition_raw:.2g} in raw powers), then turned into raw powers exactly. Sigmas come from the data "
        "sets' scatter about the fit, never below that of their samples. The raw coefficients are strongly "
        "correlated, so the file holds the whole covariance. What the polynomial's form cannot follow is in the "
        "residual, not here."
    )
