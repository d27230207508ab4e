"""`drd calibrate gyro`: the error function of a gyro from rate-table data sets, with its uncertainty and its report."""

import argparse
import importlib
import sys
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from tqdm import tqdm

import drd
from drd.commands import command, number
from drd.config.schema import ConfigError
from drd_tools.calibrate.gyro.candidates import (
    ORDERS,
    Candidate,
    NotObservableError,
    compare,
    recommend,
    require_observable,
)
from drd_tools.calibrate.gyro.data_sets import SETTLE_S, DataSets
from drd_tools.calibrate.gyro.error_function import FILE_ORDER, ErrorFunction, Order
from drd_tools.calibrate.gyro.evaluation import Evaluation
from drd_tools.calibrate.gyro.file import write_calibration
from drd_tools.calibrate.gyro.rate_table import RateTable, data_sets, files_in, read_rate_table
from drd_tools.calibrate.gyro.report import write_report
from drd_tools.calibrate.gyro.result import CANDIDATE_HEADER, GyroResult
from drd_tools.evaluate.metrics import rms
from drd_tools.report.terminal import print_table

PROG = "drd calibrate gyro"
DESCRIPTION = """\
Fit the gyro's error function (cubic in rate, its coefficients quadratic in temperature) to data from a rotary table,
compare other orders on held-out data, and write the file that the daemon loads (calibration.file), with a report.

DATA is CSV with the columns time_s, table_rate_deg_s, rate_deg_s, temperature_c; others are ignored. A file may hold
one rate or many. Counter-clockwise is positive, as in the daemon after fog.positive. Let the table hold each rate for
half a minute or so, from standstill to the fastest in both directions, at three or more temperatures.
"""
EPILOG = """\
examples:
  drd calibrate gyro rates/ --output gyro            a folder of files, one for each temperature
  drd calibrate gyro rates/ --held-out again/ --latitude 48.1 --output gyro
  drd calibrate gyro --live robot.yaml --rates -100,-50,0,50,100 --seconds 30 rates/ --output gyro

Exit code: 0 done, 1 cannot write, 2 bad usage or data, or data that do not determine the result
"""


def main(argv: list[str]) -> int:
    """Exit code 0; 1 where the results cannot be written; 2 for bad usage, bad data or a refusal."""
    arguments = _arguments(argv)
    try:
        arguments.output.mkdir(parents=True, exist_ok=True)
        tables = _tables(arguments)
        result = calibrate(tables, arguments)
        calibration = result.fitted.calibration(
            rms(result.evaluation.after_deg_s), _provenance(result, arguments), rms(result.evaluation.before_deg_s)
        )
        file = arguments.output / "calibration.yaml"
        written = [file, *write_report(arguments.output, result)]
        write_calibration(file, calibration)
    except ConfigError as error:
        print(f"{PROG}: {error}", file=sys.stderr)
        return 2
    except NotObservableError as error:
        print(f"{PROG}: refused: {error}", file=sys.stderr)
        return 2
    except OSError as error:
        print(f"{PROG}: cannot write {error.filename or arguments.output}: {error.strerror}", file=sys.stderr)
        return 1
    _print(result, written)
    return 0


def calibrate(tables: Sequence[RateTable], arguments: argparse.Namespace) -> GyroResult:
    """Fit and evaluate the orders. Raises ConfigError for bad data, NotObservableError if they do not suffice."""
    data = data_sets(tables, arguments.settle, arguments.latitude)
    new_tables = [read_rate_table(file) for file in files_in(arguments.held_out)]
    _refuse_shared(tables, new_tables)
    new = data_sets(new_tables, arguments.settle, arguments.latitude) if new_tables else None
    require_observable(data, arguments.order or FILE_ORDER)
    with tqdm(ORDERS, "candidates", delay=2.0, disable=None, leave=False) as bar:
        candidates = compare(data, new, progress=lambda _: bar)
    recommended, why = recommend(candidates)
    chosen = recommended
    if arguments.order is not None:
        chosen = next(c for c in candidates if c.order == arguments.order)
    if chosen.fitted is None:
        raise NotObservableError(chosen.reason)
    evaluation, outside = _evaluation(new, chosen, chosen.fitted)
    return GyroResult(
        inputs=[(table.file, table.sha256) for table in (*tables, *new_tables)],
        data=data,
        candidates=candidates,
        recommended=recommended,
        why=why,
        chosen=chosen,
        fitted=chosen.fitted,
        evaluation=evaluation,
        latitude_deg=arguments.latitude,
        forced=arguments.order is not None,
        outside=outside,
    )


def _evaluation(new: DataSets | None, chosen: Candidate, fitted: ErrorFunction) -> tuple[Evaluation, int]:
    """Evaluate on the new data within the valid range if there are any, otherwise by cross-validation."""
    if new is None:
        assert chosen.unseen is not None
        assert chosen.residual_deg_s is not None
        how = "data sets, each held out of the fit that corrects it (tenfold cross-validation)"
        return Evaluation(chosen.unseen, chosen.residual_deg_s, how), 0
    inside = np.ones(len(new), dtype=bool)
    for values, (low, high) in (
        (new.rate_deg_s, fitted.rate_range_deg_s),
        (new.temperature_c, fitted.temperature_range_c),
    ):
        margin = 0.02 * (high - low)  # settings are never repeated exactly
        inside &= (values >= low - margin) & (values <= high + margin)
    if not inside.any():
        raise NotObservableError("no new data set lies within the rates and temperatures of the calibration")
    chosen_new = new.select(inside)
    how = "new data sets that the fit has not seen"
    return Evaluation(chosen_new, fitted.residual_deg_s(chosen_new), how), int((~inside).sum())


def _tables(arguments: argparse.Namespace) -> list[RateTable]:
    files = files_in(arguments.data)
    if arguments.live is not None:
        live = importlib.import_module("drd_tools.calibrate.gyro.live")  # only then are the daemon's ports needed
        folder = arguments.output / "recordings" / datetime.now(UTC).strftime("%Y-%m-%dT%H%M%SZ")
        recorded: list[Path] = live.record_steps(arguments.live, folder, arguments.rates, arguments.seconds)
        print(f"\nRecorded {len(recorded)} steps in {folder}; give it as DATA to use them again.\n")
        files += recorded
    if not files:
        raise ConfigError("--live", "steps", "at least one that was recorded", "none")
    return [read_rate_table(file) for file in tqdm(files, "reading", delay=2.0, disable=None, leave=False)]


def _refuse_shared(tables: Sequence[RateTable], new_tables: Sequence[RateTable]) -> None:
    known = {table.sha256: table.file for table in tables}
    for table in new_tables:
        if table.sha256 in known:
            got = f"the same content as {known[table.sha256]}"
            raise ConfigError(str(table.file), "--held-out", "data that the fit has not seen", got)


def _provenance(result: GyroResult, arguments: argparse.Namespace) -> dict[str, str]:
    earth = "in the constant coefficient" if arguments.latitude is None else f"removed, latitude {arguments.latitude:g}"
    return {
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "tool": f"{PROG} {drd.__version__}",
        "order": str(result.order),
        "data_sets": f"{len(result.data)}, {int((result.fitted.weights == 0.0).sum())} rejected",
        "residual_from": f"{len(result.evaluation.data)} {result.evaluation.how}",
        "settling_time_s": f"{arguments.settle:g}",
        "earth_rate": earth,
        **{f"sha256 {file}": digest for file, digest in result.inputs},
    }


def _print(result: GyroResult, written: Sequence[Path]) -> None:
    print("Candidates: powers of rate,temperature; rms error of held-out data sets")
    print_table(CANDIDATE_HEADER, result.candidate_rows(), text=(6,))
    for part in (result.choice(), result.summary(), result.notes()):
        print()
        print("\n".join(part))
    print()
    for label, place, error, residual in result.outlier_rows():
        print(f"Rejected: {label} ({place}): error {error} deg/s, {residual} deg/s off the fit")
    print("Written: " + ", ".join(str(file) for file in written))


def _arguments(argv: list[str]) -> argparse.Namespace:
    parser = command(PROG, DESCRIPTION, EPILOG)
    add = parser.add_argument
    add("data", nargs="*", type=Path, metavar="DATA", help="rate-table CSV files, or folders of them")
    add("--output", type=Path, required=True, metavar="DIR", help="where calibration.yaml and the report go")
    add("--held-out", nargs="+", type=Path, default=[], metavar="DATA", help="new data, only to judge the result by")
    text = "take this order, such as 3,2, not the recommended one"
    add("--order", type=_order, metavar="RATE,TEMPERATURE", help=text)
    text = "of the table: takes the Earth's rate off (table level)"
    add("--latitude", type=number(-90, 90), metavar="DEG", help=text)
    text = f"left out at the start of each rate (default {SETTLE_S:g})"
    add("--settle", type=number(0, 3600), default=SETTLE_S, metavar="S", help=text)
    add("--live", type=Path, metavar="CONFIG", help="first record from the gyro of this configuration")
    add("--rates", type=_rates, metavar="R,R,...", help="with --live: the table's rates in deg/s, step by step")
    add("--seconds", type=number(1, 36000), default=30.0, metavar="S", help="with --live: at each rate (default 30)")
    if "--rates" in argv[:-1]:  # argparse mistakes "-100,0,100" for an option
        k = argv.index("--rates")
        argv = [*argv[:k], f"--rates={argv[k + 1]}", *argv[k + 2 :]]
    arguments = parser.parse_args(argv)
    if not arguments.data and arguments.live is None:
        parser.error("expected DATA, or --live to record it")
    if (arguments.live is None) != (arguments.rates is None):
        parser.error("--live and --rates go together")
    return arguments


def _order(text: str) -> Order:
    """Parse an order of the form 3,2, within what a calibration file holds."""
    try:
        rate, temperature = map(int, text.split(","))
    except ValueError:
        rate, temperature = 0, 0
    if not (1 <= rate <= FILE_ORDER.rate and 0 <= temperature <= FILE_ORDER.temperature):
        raise argparse.ArgumentTypeError(f"expected 1,0 to {FILE_ORDER}, which a calibration file holds, got {text!r}")
    return Order(rate, temperature)


def _rates(text: str) -> list[float]:
    return [number()(part) for part in text.split(",")]
