"""`drd explain`: the error budget of an interval of a recording, by cause."""

import argparse
from dataclasses import replace
from pathlib import Path

from drd.commands import command, number
from drd.config.schema import ConfigError
from drd_tools.evaluate.trajectory import Reference, read_reference
from drd_tools.explain.analysis import explain
from drd_tools.explain.report import print_explanation, write_report
from drd_tools.explain.results import Explanation
from drd_tools.explain.source import open_source
from drd_tools.options import kept, reference_lag, reference_sigma, replayed
from drd_tools.report.saved import keep_and_show

DESCRIPTION = """\
Break the pose's uncertainty down by cause: gyro noise, bias, scale and calibration, wheel scales, tread, slip noise,
latency, quantisation, in metres and degrees.

RECORDING is replayed as by `drd replay` (a .mcap file of the daemon or a recording folder). Each filter step, with its
own F, H, K, Q and R, is repeated on one covariance per cause; these sum to the filter's covariance, so that the budget
is exactly what the filter assumes. It contains no physics that is not in the filter.

With --from S or a reference, errors are relative to the pose at the beginning of the interval; the uncertainty of
scales, tread and bias at that time stays with its cause. Otherwise they are relative to the start of the filter.

A reference (the folder's reference.csv, or --reference) gives the actual error: whether the budget covers it and, if
so, its most likely causes, from the error's time history and the innovations of the heading.

Finally, the smallest error that any estimator could achieve on the whole recording (the posterior Cramer-Rao bound),
with known geometry, is given, and what would lower it most.
"""
EXAMPLES = """\
examples:
  drd explain run_07/
  drd explain run_07/ --from 120 --to 180 --output out/explain
  drd explain mybot-20260102T100000Z-1f0c9a55-0001.mcap --calibration gyro/calibration.yaml
  drd explain --draw out/explain

DIR receives results.json, report.html and pictures; --draw redraws report and pictures from results.json. Times are
the recording's time_s, or those of the poses written by `drd replay`.
Exit code: 0 done, 2 bad usage or input.
"""


def main(argv: list[str]) -> int:
    """Explain or draw, print, and return the exit code. Raises ConfigError on bad input."""
    parser = _parser()
    chosen = parser.parse_args(argv)
    if (chosen.recording is None) == (chosen.draw is None):
        parser.error("give a RECORDING, or --draw DIR")
    return keep_and_show(chosen, Explanation, lambda: _explain(chosen, parser), print_explanation, write_report)


def _explain(chosen: argparse.Namespace, parser: argparse.ArgumentParser) -> Explanation:
    source = open_source(chosen.recording, chosen.config, chosen.calibration, chosen.model)
    reference = _reference(chosen, parser, source.has_reference)
    explanation = explain(source, chosen.begin, chosen.to, reference, chosen.reference_lag)
    try:
        return replace(explanation, limit=source.limit())
    except ConfigError as error:
        return replace(explanation, notes=[*explanation.notes, f"No limit: {error}"])


def _reference(chosen: argparse.Namespace, parser: argparse.ArgumentParser, has_own: bool) -> Reference | None:
    path: Path | None = chosen.reference or (chosen.recording if has_own else None)
    if path is None:
        if chosen.reference_sigma is not None or chosen.reference_lag:
            parser.error("--reference-sigma, --reference-lag: there is no reference")
        return None
    return read_reference(path, *(chosen.reference_sigma or (None, None)))


def _parser() -> argparse.ArgumentParser:
    parser = command(
        "drd explain", DESCRIPTION, EXAMPLES, [replayed(), reference_sigma(), reference_lag(), kept(required=False)]
    )
    add = parser.add_argument
    add("recording", nargs="?", type=Path, metavar="RECORDING", help=".mcap file or recording folder")
    add("--from", dest="begin", type=number(), metavar="S", help="the interval's beginning (default: the recording's)")
    add("--to", type=number(), metavar="S", help="its end (default: the recording's)")
    add("--reference", type=Path, metavar="PATH", help="recording folder, or CSV with time_s,x_m,y_m,heading_deg")
    return parser
