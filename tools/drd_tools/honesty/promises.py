"""Promises and goals of the estimator, judged on the results."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy import stats

from drd_tools.evaluate.consistency import Nees, nees_interval
from drd_tools.honesty.baselines import BASELINES, GYRO
from drd_tools.honesty.configurations import CALIBRATED, DEFAULT, NOMINAL_LIMIT, STATED
from drd_tools.honesty.figures import Figures
from drd_tools.honesty.results import Judged, Results, together

# By luck, noise may make the best of three simple estimators slightly better than a good one.
NOT_WORSE: Final = 1.05
# With fewer seeds luck decides: they show a divergent estimate, not a difference of a tenth.
MANY_SEEDS: Final = 30
NOT_ASTRAY: Final = 1.5
ASTRAY_LEVEL: Final = 0.999
# The bound is one of 99 %, and useful if it is not many times the error: for a Gaussian error in one direction with a
# known sigma the ratio is 3.03 / 0.674 = 4.5.
INSIDE: Final = 0.99
LARGEST_RATIO: Final = 8.0
LEVEL: Final = 0.95  # of the intervals over seeds
POSE_DOF: Final = 3
# Goals: errors of gyro odometry calibrated by hand on the same drives, see the shared reference.
WARTHOG_M, WARTHOG_DEG, WARTHOG_CALIBRATED_M = 0.6, 2.5, 0.3
CIRCULAR_M, SQUARE_M = 0.009, 0.011
OF_THE_LIMIT: Final = 1.1


@dataclass(frozen=True)
class Verdict:
    """A promise or a goal, whether it is kept, and the figures."""

    about: str
    kept: bool
    text: str


def promises(results: Results) -> list[Verdict]:
    """All promises; a broken one fails the run."""
    return [*_not_worse(results), *_bound(results), *_nees(results)]


def best_baseline(figures: dict[str, Figures]) -> tuple[str, float] | None:
    """Name and position error of the best baseline."""
    found = [(figures[name].position_rms_m, name) for name in BASELINES if name in figures]
    return (min(found)[1], min(found)[0]) if found else None


def _not_worse(results: Results) -> Iterator[Verdict]:
    for drives in results.groups("real").values():
        for one in drives:
            yield from _against_best(one.drive, one.figures, NOT_WORSE)
    for group, drives in results.groups("simulated").items():
        yield from _against_best_over_seeds(group, drives)


def _against_best(about: str, figures: dict[str, Figures], most: float) -> Iterator[Verdict]:
    best = best_baseline(figures)
    if best is not None:
        name, best_m = best
        own_m = figures[DEFAULT].position_rms_m
        ratio = own_m / best_m if best_m > 0.0 else 1.0
        text = f"position rms {own_m:.3g} m, {ratio:.2f} x the best baseline's ({name}: {best_m:.3g} m)"
        yield Verdict(f"never worse than its inputs: {about}", own_m <= most * best_m, f"{text}, at most {most:g}")


def _against_best_over_seeds(group: str, drives: Sequence[Judged]) -> Iterator[Verdict]:
    """Compare root mean squares over the seeds. The ratio's uncertainty is reported, but excuses nothing: the few seeds
    in which an estimate diverges make the ratio both large and uncertain.
    """
    names = [name for name in (DEFAULT, *BASELINES) if name in drives[0].figures]
    rows = {name: together([one.figures[name] for one in drives], "simulated") for name in names}
    most = NOT_WORSE if len(drives) >= MANY_SEEDS else NOT_ASTRAY
    for verdict in _against_best(f"{group}, {len(drives)} seeds", rows, most):
        best = min(names[1:], key=lambda name: rows[name].position_rms_m)
        own, other = ([one.figures[name].position_rms_m for one in drives] for name in (DEFAULT, best))
        least = ratio_at_least(own, other)
        yield Verdict(verdict.about, verdict.kept, f"{verdict.text}; by the seeds' scatter at least {least:.2f}")


def ratio_at_least(own: Sequence[float], other: Sequence[float]) -> float:
    """Lower end of the one-sided 95 % interval of the ratio of two root mean squares over the same seeds.

    Jackknife of the ratio's logarithm, with Student's t, since luck in a few seeds moves both sums; 0 for one seed.
    """
    a, b = np.square(own), np.square(other)
    n = len(a)
    if n < 2 or not b.sum() > 0.0:
        return 0.0
    left_out = 0.5 * np.log((a.sum() - a) / (b.sum() - b))
    sigma = float(np.sqrt((n - 1) / n * np.sum((left_out - left_out.mean()) ** 2)))
    return float(np.exp(0.5 * np.log(a.sum() / b.sum()) - stats.t.ppf(LEVEL, n - 1) * sigma))


def single_seeds_worse(drives: Sequence[Judged]) -> int:
    """Count single drives that break the promise, which is judged over all of them."""
    return sum(not verdict.kept for one in drives for verdict in _against_best("", one.figures, NOT_WORSE))


def _bound(results: Results) -> Iterator[Verdict]:
    for drives in results.groups("real").values():
        for one in drives:
            f = one.figures[DEFAULT]
            if f.inside is None:
                yield Verdict(f"the bound holds: {one.drive}", False, "no moving row is valid")
                continue
            text = f"{100.0 * f.inside:.1f} % inside"
            yield Verdict(f"the bound holds: {one.drive}", f.inside >= INSIDE, text)
            if GYRO in one.figures:
                yield from _of_use(one.drive, f)


def _of_use(about: str, f: Figures) -> Iterator[Verdict]:
    """Judge the bound's ratio to the error: a promise with a gyro. Without one nothing is learned during the drive: the
    bound is the prior of tread and wheels, whose error may by luck be small.
    """
    if f.bound_ratio is not None:
        kept = f.bound_ratio <= LARGEST_RATIO
        yield Verdict(f"the bound is of use: {about}", kept, f"{f.bound_ratio:.1f} x the median error")


def nees_of(drives: Sequence[Judged], configuration: str, level: float = LEVEL) -> Nees | None:
    """NEES of the pose at the end over the drives, with its two-sided interval."""
    values = [one.nees[configuration] for one in drives if configuration in one.nees]
    if not values:
        return None
    n = len(values)
    return Nees("pose", POSE_DOF, n, n, float(np.mean(values)), *nees_interval(n, POSE_DOF, level))


def nees_limit(n: int) -> float:
    """Upper limit, at LEVEL, of the mean NEES over n drives if the covariance is not too small."""
    return nees_interval(n, POSE_DOF, 2.0 * LEVEL - 1.0)[1]


def _nees(results: Results) -> Iterator[Verdict]:
    """Judge NEES two-sided, if the filter has all physics and the configuration states the drawn distributions."""
    for group, drives in results.groups("simulated").items():
        found = nees_of(drives, STATED, LEVEL if len(drives) >= MANY_SEEDS else ASTRAY_LEVEL)
        if found is not None:
            text = f"{found.average:.2f}, expected {found.low:.2f} to {found.high:.2f}: {found.verdict}"
            yield Verdict(f"NEES of the pose: {group}, {found.rows} seeds", found.verdict == "consistent", text)


def goals(results: Results) -> list[Verdict]:
    """All goals; a missed one is printed, but does not fail the run."""
    found: list[Verdict] = []
    warthog = [one for one in results.judged if one.drive.startswith("warthog_")]
    found += _goal("Warthog, nominal geometry", warthog, DEFAULT, WARTHOG_M, WARTHOG_DEG)
    found += _goal("Warthog, calibrated on other drives", warthog, CALIBRATED, WARTHOG_CALIBRATED_M)
    for kind, most_m in (("circular", CIRCULAR_M), ("square", SQUARE_M)):
        drives = [one for one in results.judged if one.drive.startswith(f"optiodom_{kind}")]
        found += _goal(f"OptiOdom {kind}, calibrated on other drives", drives, CALIBRATED, most_m)
    for drives in results.groups("real").values():
        for one in drives:
            if GYRO not in one.figures:
                found += _of_use(one.drive, one.figures[DEFAULT])
    for group, drives in results.groups("simulated").items():
        found += [*_near_limit(group, drives), *_not_overconfident(group, drives)]
    return found


def _goal(
    about: str, drives: Sequence[Judged], configuration: str, most_m: float, most_deg: float | None = None
) -> Iterator[Verdict]:
    figures = [one.figures[configuration] for one in drives if configuration in one.figures]
    if figures:
        middle = together(figures, "real")
        text = f"median {middle.position_rms_m:.3g} m (goal {most_m:g})"
        kept = middle.position_rms_m <= most_m
        if most_deg is not None:
            text += f", {middle.heading_rms_deg:.2f} deg (goal {most_deg:g})"
            kept = kept and middle.heading_rms_deg <= most_deg
        yield Verdict(about, kept, text)


def _near_limit(group: str, drives: Sequence[Judged]) -> Iterator[Verdict]:
    known = [one for one in drives if NOMINAL_LIMIT in one.figures]
    if known:
        own, limit = (together([one.figures[name] for one in known], "simulated") for name in (DEFAULT, NOMINAL_LIMIT))
        ratio = own.position_rms_m / limit.position_rms_m
        yield Verdict(f"near the limit: {group}", ratio <= OF_THE_LIMIT, f"{ratio:.2f} x (goal {OF_THE_LIMIT:g})")


def _not_overconfident(group: str, drives: Sequence[Judged]) -> Iterator[Verdict]:
    """Judge NEES one-sided with the default configuration, whose noise allows for worse ground."""
    found = nees_of(drives, DEFAULT)
    if found is not None:
        most = nees_limit(found.rows)
        text = f"NEES {found.average:.2f} (at most {most:.2f})"
        yield Verdict(f"covariance not too small: {group}, {found.rows} seeds", found.average <= most, text)
