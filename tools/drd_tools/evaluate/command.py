"""`drd evaluate`: errors of poses against a reference, and whether their covariance is consistent."""

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

from tqdm import tqdm

from drd.commands import command, number, writing
from drd.config.schema import ConfigError
from drd_tools.evaluate.alignment import KINDS
from drd_tools.evaluate.compare import compare
from drd_tools.evaluate.judge import judge
from drd_tools.evaluate.report import print_runs, write_report
from drd_tools.evaluate.results import Evaluation, Run
from drd_tools.evaluate.trajectory import MAX_GAP_S, Poses, Reference, read_poses, read_reference
from drd_tools.limit.limit import Limit, limit_of
from drd_tools.options import kept, reference_lag, reference_sigma
from drd_tools.recordings.daemon_log import read
from drd_tools.report.saved import keep_and_show, tell_files

DESCRIPTION = """\
Evaluate poses against a reference: end-point and return error, absolute and relative trajectory error, drift in per
cent (KITTI, on segments scaled to the path), heading drift in deg/h, and consistency (NEES, with its bounds). If the
recording is available (as the input, named in the JSON next to POSES.csv, or as the reference's folder), the smallest
error that any estimator could achieve on it (the posterior Cramer-Rao bound) and what would lower it most are reported.

POSES.csv has time_s,x_m,y_m,heading_deg and optionally the covariance xx_m2,xy_m2,xh_m_rad,yy_m2,yh_m_rad,hh_rad2
and position_bound_99_m, the latter optionally with valid, 1 or 0 (as written by `drd replay` and `drd export --csv`).
--reference is a recording folder or a CSV with time_s,x_m,y_m,heading_deg: one for all poses, or one for each. It may
be sparse; its heading may be wrapped.

RECORDING is a folder with a reference; without --reference it is replayed with its nominal model, robot.yaml.

The estimate is interpolated at the reference's times, never extrapolated. Alignment, by a rigid motion without scale:
  start           the poses agree at the first common time (the default; errors there are zero by definition)
  first-metres M  least squares over the positions on the first M metres
  se2             least squares over all positions (Umeyama); hides part of the drift and makes NEES meaningless
  none            no alignment

A reference may lag the poses; lidar and motion capture do by up to half a second. The lag visible in the turns is
reported, and --reference-lag corrects it.
"""
EXAMPLES = """\
examples:
  drd evaluate poses.csv --reference recordings/run1 --output out/run1
  drd evaluate a.csv b.csv --reference reference.csv --reference-sigma 0.01 0.2 --align none --output out/ab
  drd evaluate recordings/* --output out/nominal
  drd evaluate --compare out/nominal out/calibrated --output out/both
  drd evaluate --draw out/run1

DIR receives results.json, which --compare and --draw use later, and report.html with its pictures.
Exit code: 0 done, 2 bad usage or input.
"""


def main(argv: list[str]) -> int:
    """Evaluate, compare or draw, and return the exit code. Raises ConfigError on bad input."""
    parser = _parser()
    chosen = parser.parse_args(argv)
    if sum((bool(chosen.inputs), chosen.compare is not None, chosen.draw is not None)) != 1:
        parser.error("give POSES.csv or RECORDING, or --compare DIR DIR, or --draw DIR")
    if chosen.compare is None:
        return keep_and_show(
            chosen, Evaluation, lambda: Evaluation(_evaluate(chosen, parser)), print_runs, write_report
        )
    with writing(chosen.output):
        chosen.output.mkdir(parents=True, exist_ok=True)
        tell_files(compare(chosen.compare, chosen.output))
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = command("drd evaluate", DESCRIPTION, EXAMPLES, [kept(), reference_sigma(), reference_lag()])
    add = parser.add_argument
    add("inputs", nargs="*", type=Path, metavar="POSES.csv|RECORDING", help="poses or recordings to evaluate")
    add("--reference", nargs="+", type=Path, metavar="PATH", help="one for all poses, or one for each")
    text = "none, start (default), first-metres M, or se2"
    add("--align", nargs="+", default=["start"], metavar="HOW", help=text)
    text = "no interpolation between poses further apart, s (default: 1)"
    add("--max-gap", type=number(0.0, above=True), default=MAX_GAP_S, metavar="S", help=text)
    text = "a path that ends so near to its start is closed, m (default: 5 %% of its length, at most 1 m)"
    add("--closed-within", type=number(0.0, above=True), metavar="M", help=text)
    add("--compare", nargs="+", type=Path, metavar="DIR", help="compare results that were saved")
    return parser


def _evaluate(chosen: argparse.Namespace, parser: argparse.ArgumentParser) -> list[Run]:
    kind, metres = _alignment(chosen.align, parser)
    given: list[Path] | None = chosen.reference
    if given is not None and len(given) not in (1, len(chosen.inputs)):
        parser.error(
            f"--reference: expected one path, or one for each of {len(chosen.inputs)} inputs, got {len(given)}"
        )
    references = given * len(chosen.inputs) if given is not None and len(given) == 1 else given or chosen.inputs
    sigmas: Sequence[float | None] = chosen.reference_sigma or (None, None)
    runs = []
    pairs = list(zip(chosen.inputs, references, strict=True))
    for path, reference_path in tqdm(pairs, desc="evaluating", disable=True if len(pairs) < 3 else None, leave=False):
        if not path.is_dir() and given is None:
            parser.error(f"{path} is not a recording folder; poses need --reference")
        poses, reference = _read(path, reference_path, sigmas)
        runs.append(
            judge(
                poses,
                reference,
                kind=kind,
                metres=metres,
                max_gap_s=chosen.max_gap,
                closed_within_m=chosen.closed_within,
                lag_s=chosen.reference_lag,
                limit=_limit_of(path, reference_path),
            )
        )
    return runs


def _read(path: Path, reference_path: Path, sigmas: Sequence[float | None]) -> tuple[Poses, Reference]:
    reference = read_reference(reference_path, *sigmas)
    if not path.is_dir():
        return read_poses(path), reference
    from drd_tools.evaluate.replayed import replay_poses  # noqa: PLC0415  # the estimator, where it is needed

    return replay_poses(path), reference


def _alignment(words: Sequence[str], parser: argparse.ArgumentParser) -> tuple[str, float]:
    kind, rest = words[0], words[1:]
    try:
        metres = number(0.0, above=True)(rest[0]) if kind == "first-metres" and len(rest) == 1 else 0.0
    except argparse.ArgumentTypeError:
        metres = 0.0
    if kind not in KINDS or (metres == 0.0) == (kind == "first-metres") or (rest and kind != "first-metres"):
        parser.error(f"--align: expected none, start, first-metres M or se2, got {' '.join(words)}")
    return kind, metres


def _limit_of(path: Path, reference_path: Path) -> Limit | None:
    """Limit of the recording itself, of the one named in the JSON next to POSES.csv, or of the reference's folder.

    None if none of them is a recording from which poses can be computed.
    """
    for candidate in (path, _named_beside(path), reference_path):
        if candidate is None or not (candidate.is_dir() or candidate.suffix == ".mcap"):
            continue
        try:
            return limit_of(read(candidate))
        except ConfigError:
            continue  # errors in its files are reported where they are needed
    return None


def _named_beside(poses: Path) -> Path | None:
    """Recording from which `drd replay` computed the poses."""
    try:
        content = json.loads(poses.with_suffix(".json").read_text(encoding="utf-8"))
        name = content["recording"]
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return Path(name) if isinstance(name, str) and Path(name).exists() else None
