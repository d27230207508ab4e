"""`drd paper`: Table II and the figures of the paper from simulation, beside the printed ones."""

import argparse
import sys
import time
from pathlib import Path

from drd_tools.paper.experiment import run_experiment
from drd_tools.paper.pictures import draw_all
from drd_tools.paper.results import Results
from drd_tools.paper.text import HEADINGS, gain_rows, sentences, table_rows
from drd_tools.report.page import Page

GAIN_HEADER = ("method", "paper", "ours [95 %]", "single gyros, 5 % to 95 %", "largest error on the way")


def main(argv: list[str]) -> int:
    """Exit code 0; 2 for bad usage."""
    arguments = _arguments(argv)
    folder: Path = arguments.output
    if arguments.gyros < 2:
        print(f"drd paper: --gyros: expected at least 2, got {arguments.gyros}", file=sys.stderr)
        return 2
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        print(f"drd paper: --output: {folder}: {error.strerror}", file=sys.stderr)
        return 2
    if arguments.draw:
        results = Results.load(folder)
    else:
        began_s = time.monotonic()
        results = run_experiment(arguments.gyros, arguments.seed)
        results.save(folder)
        print(f"{arguments.gyros} gyros, ten runs each, in {time.monotonic() - began_s:.0f} s\n")
    _print(results)
    draw_all(results, folder)
    _report(results, folder)
    print(f"\nreport: {folder / 'report.html'}")
    return 0


def _arguments(argv: list[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="drd paper",
        description="Repeat the experiments of Chung, Ojeda and Borenstein (2001) in simulation: gyros as in Table I, "
        "each calibrated on a rate table, ten runs around the 210 m path in the four configurations of Table II, "
        "estimated by the daemon's own classes. Prints Table II beside the paper's and writes pictures, a report and "
        "the results.",
        epilog="example: drd paper --output paper; later: drd paper --output paper --draw. "
        "Exit code: 0 done, 2 bad usage or results that cannot be read.",
    )
    parser.add_argument("--output", type=Path, required=True, metavar="DIR", help="folder for report.html and pictures")
    parser.add_argument("--gyros", type=int, default=50, metavar="N", help="how many gyros are drawn (default: 50)")
    parser.add_argument("--seed", type=int, default=1, metavar="N", help="other gyros, robots and noise (default: 1)")
    parser.add_argument("--draw", action="store_true", help="only report and draw the results that DIR holds")
    return parser.parse_args(argv)


def _print(results: Results) -> None:
    gyros = len(results.return_m)
    print(f"Table II: return position error in cm, paper | ours: mean (5 % to 95 % of {gyros} gyros)\n")
    _print_table(("", *HEADINGS), table_rows(results))
    print("\nHow many times smaller the error is than without either\n")
    _print_table(GAIN_HEADER, gain_rows(results))
    print()
    for sentence in sentences(results):
        print(f"- {sentence}")
    print("\nPhysical parameters, the same for all cells\n")
    _print_table(("parameter", "value", "unit", "meaning", "source"), results.parameters)


def _print_table(header: tuple[str, ...], rows: list[list[str]]) -> None:
    widths = [max(len(row[k]) for row in (header, *rows)) for k in range(len(header))]
    for row in (header, *rows):
        print("  " + "  ".join(f"{cell:<{width}}" for cell, width in zip(row, widths, strict=True)).rstrip())


def _report(results: Results, folder: Path) -> None:
    found = sentences(results)
    page = Page("The paper's experiments, repeated in simulation", found[:1])
    page.text(
        "H. Chung, L. Ojeda, J. Borenstein: Accurate Mobile Robot Dead-reckoning With a Precision-calibrated Fiber "
        "Optic Gyroscope (2001). The estimates are the daemon's own: its calibration, estimator and filter."
    )
    page.heading("Table II")
    page.picture(folder / "table2.png", "Return position errors: ours as bars, the paper's averages as diamonds.")
    averages = {row for row, cells in enumerate(table_rows(results)) if cells[0].startswith("average")}
    caption = f"Return position error in cm: paper | ours, mean (5 % to 95 % of {len(results.return_m)} gyros)"
    page.table(("", *HEADINGS), table_rows(results), caption, averages)
    page.table(GAIN_HEADER, gain_rows(results), "How many times smaller the error is than without either")
    page.heading("Where this differs from the paper, and why")
    for sentence in found[1:]:
        page.text(sentence)
    page.heading("The path")
    page.picture(folder / "path.png", "210 m, eight via points, 1.5 m/s and 0.8 m/s near the corners.")
    page.picture(folder / "onway.png", "What the return position does not show.")
    rows = [(f"{d:g}", f"{1000 * r:.1f}", f"{1000 * w:.1f}") for d, r, w in results.delay]
    header = ("gyro's delay / s", "return error / mm", "largest error on the way / mm")
    page.table(header, rows, "Perfect sensors, except that the gyro is late and nobody compensates it")
    page.heading("Calibration: Figure 3")
    page.picture(folder / "figure3.png", "One gyro on the rate table; new data, which the calibration has not seen.")
    page.heading("The filter's variances")
    page.picture(
        folder / "variances.png",
        "As the paper says: position and heading grow without bound, the encoder scales converge, tread and gyro bias "
        "diverge slowly.",
    )
    page.heading("What was simulated")
    page.table(("parameter", "value", "unit", "meaning", "source"), results.parameters, text_columns={2, 3, 4})
    page.table(("the daemon was told", "value"), results.told, f"Seed {results.seed}; config/pioneer-at.yaml and these")
    page.save(folder / "report.html")
