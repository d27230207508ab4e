"""`drd paper`: Table II and the figures of the paper from simulation, compared with the printed ones."""

import argparse
import time
from pathlib import Path

from drd.commands import command, whole
from drd_tools.options import seed
from drd_tools.paper.experiment import run_experiment
from drd_tools.paper.pictures import draw_all
from drd_tools.paper.results import Results
from drd_tools.paper.text import HEADINGS, gain_rows, sentences, table_rows
from drd_tools.report.page import Page
from drd_tools.report.saved import keep_and_show
from drd_tools.report.terminal import print_table

DESCRIPTION = """\
Repeat the experiments of Chung, Ojeda and Borenstein (2001) in simulation: gyros as in Table I, each calibrated on a
rate table, ten runs around the 210 m path in the four configurations of Table II, estimated by the daemon's own
classes. Prints Table II beside the paper's and writes pictures, a report and the results.
"""
EPILOG = """\
examples:
  drd paper --output paper
  drd paper --output paper --draw

Exit code: 0 done, 2 bad usage or results that cannot be read.
"""
GAIN_HEADER = ("method", "paper", "ours [95 %]", "single gyros, 5 % to 95 %", "largest error on the way")


def main(argv: list[str]) -> int:
    """Run the command. Returns the exit code: 0, or 2 for bad usage."""
    parser = command("drd paper", DESCRIPTION, EPILOG, [seed("gyros, robots and noise", 1)])
    add = parser.add_argument
    add("--output", type=Path, required=True, metavar="DIR", help="folder for report.html and pictures")
    add("--gyros", type=whole(2), default=50, metavar="N", help="number of random gyros (default: 50)")
    add("--draw", action="store_true", help="only report and draw the results that DIR holds")
    chosen = parser.parse_args(argv)
    chosen.draw = chosen.output if chosen.draw else None
    return keep_and_show(chosen, Results, lambda: _run(chosen), _print, _report)


def _run(chosen: argparse.Namespace) -> Results:
    chosen.output.mkdir(parents=True, exist_ok=True)  # before work that takes minutes
    began_s = time.monotonic()
    results = run_experiment(chosen.gyros, chosen.seed)
    print(f"{chosen.gyros} gyros, ten runs each, in {time.monotonic() - began_s:.0f} s\n")
    return results


def _print(results: Results) -> None:
    gyros = len(results.return_m)
    print(f"Table II: return position error in cm, paper | ours: mean (5 % to 95 % of {gyros} gyros)\n")
    print_table(("", *HEADINGS), table_rows(results), range(5))
    print("\nHow many times smaller the error is than without either\n")
    print_table(GAIN_HEADER, gain_rows(results), range(5))
    print()
    for sentence in sentences(results):
        print(f"- {sentence}")
    print("\nPhysical parameters, the same for all cells\n")
    print_table(("parameter", "value", "unit", "meaning", "source"), results.parameters, range(5))


def _report(results: Results, folder: Path) -> list[Path]:
    pictures = draw_all(results, folder)
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
    page.text(*found[1:])
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
    return [folder / "report.html", *pictures]
