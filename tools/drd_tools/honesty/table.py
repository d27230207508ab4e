"""Results as text."""

from collections.abc import Iterator
from typing import Final

from drd_tools.evaluate.consistency import nees_interval
from drd_tools.honesty.baselines import BASELINES, WHEELS
from drd_tools.honesty.configurations import CALIBRATED, DEFAULT, LIMIT, NOMINAL_LIMIT, PAPER, STATED, WHEEL_LAG_S
from drd_tools.honesty.drives import FOLDS, ROBOTS
from drd_tools.honesty.figures import Figures
from drd_tools.honesty.promises import (
    LEVEL,
    POSE_DOF,
    goals,
    nees_limit,
    nees_of,
    promises,
    single_seeds_worse,
)
from drd_tools.honesty.results import Results, together
from drd_tools.honesty.scenarios import SCENARIOS, SECONDS
from drd_tools.report.terminal import columns

ORDER: Final = (DEFAULT, CALIBRATED, PAPER, *BASELINES, LIMIT, NOMINAL_LIMIT)
HEADER: Final = (
    "drive", "n", "configuration", "pos m", "head deg", "drift %", "inside %", "bound m", "bound/err", "valid %",
)  # fmt: skip
NEES_HEADER: Final = ("scenario", "configuration", "n", "mean", "95 % interval", "at most", "verdict")
TEXT_COLUMNS: Final = (0, 2)
UNKNOWN: Final = "-"
ALLOWED: Final = ", ".join(f"{robot.allowed_m:g} m ({name})" for name, robot in ROBOTS.items())
HEAD: Final = f"""\
Each drive by each configuration. pos, head: root mean square errors over the drive; drift: KITTI's, in per cent of the
travel; inside: share of the moving and valid rows whose error is inside the 99 % bound ({ALLOWED}
allowed to the reference); bound: median; bound/err: that over the median error; valid: share of the rows.
default: the nominal geometry of robot.yaml and nothing else. calibrated: the wheels that four fifths of the robot's
other drives give (each {FOLDS}th drive is judged by the others). paper: the paper's Q and R. {WHEELS}: odometry;
b: gyro's heading, wheels' travel; c: the same, the bias taken at every stop. limit: what the sensors' noise allows
where the geometry is known; limit, nominal: where it is not, of a robot drawn as estimation.initial states.
Real drives: the estimate is put on the reference's first row; the reference's own lag, and where it sits on the robot
by the other drives, are taken off; groups of n drives show medians. Simulated ones ({SECONDS:g} s): root mean squares
over n seeds, since luck decides between nearly equal estimators in a single seed. The promise not to be worse than the
inputs is judged on those; the single seeds that break it are counted below. Rows with a smaller n than the default's
are of the first n seeds, and compare with each other only."""
DRAWN: Final = f"""\
NEES of the pose (x, y, heading) at the end of the drive, 3 degrees of freedom, mean over seeds. What is drawn from
what: radii, tread and gyro scale from estimation.initial's sigmas for two driven wheels; the wheels' lag (below zero:
the gyro's) with a sigma of {WHEEL_LAG_S:g} s; the gyro's bias, its walk, its noise and the slip of each wheel from
robot.yaml. "stated": the configuration says this, and none of the process noise that the simulator lacks, but for the
stamps' uncertainty (at its default, since a lag cuts samples in two) and what the filter always has (the lag's walk,
noise taken for worse until it is learned); the mean has to lie in the interval. "default": robot.yaml alone, which
allows for slip in turns and the like that this simulator does not have: it may be too cautious. The mixes and MuJoCo
have physics that the filter does not model; their effects come on top of the above, or instead:"""


def text_of(results: Results) -> str:
    """Text of all results: the table, NEES, promises and goals."""
    parts = [*results.notes, HEAD, "", *columns([HEADER, *table_rows(results)], TEXT_COLUMNS, "")]
    nees = list(nees_rows(results))
    if nees:
        effects = [
            f"  {name}: {scenario.about}" for name, scenario in SCENARIOS.items() if name in results.groups("simulated")
        ]
        parts += ["", DRAWN, *effects, "", *columns([NEES_HEADER, *nees], TEXT_COLUMNS, "")]
    parts += [
        "",
        *_promise_lines(results),
        "",
        "Goals",
        *(f"  {'met' if g.kept else 'MISSED'}: {g.about}: {g.text}" for g in goals(results)),
    ]
    return "\n".join(parts)


def table_rows(results: Results) -> Iterator[list[str]]:
    """Yield a row for each drive, or group of drives, and configuration."""
    for world in ("real", "simulated"):
        for group, drives in results.groups(world).items():
            label = group
            for name in ORDER:
                figures = [one.figures[name] for one in drives if name in one.figures]
                if figures:
                    yield [label, str(len(figures)), name, *_cells(together(figures, world), world)]
                    label = ""


def _cells(f: Figures, world: str) -> list[str]:
    digits = 4 if world == "real" and f.position_rms_m < 0.1 else 3
    shares = [None if share is None else 100.0 * share for share in (f.inside, f.valid)]
    return [
        f"{f.position_rms_m:.{digits}f}",
        f"{f.heading_rms_deg:.2f}",
        _cell(f.drift_percent, 2),
        _cell(shares[0], 1),
        _cell(f.bound_m, 3),
        _cell(f.bound_ratio, 1),
        _cell(shares[1], 0),
    ]


def _cell(value: float | None, digits: int) -> str:
    return UNKNOWN if value is None else f"{value:.{digits}f}"


def nees_rows(results: Results) -> Iterator[list[str]]:
    """Yield a row for each scenario and configuration."""
    for group, drives in results.groups("simulated").items():
        for name in (STATED, DEFAULT):
            found = nees_of(drives, name)
            if found is not None:
                low, high = nees_interval(found.rows, POSE_DOF, LEVEL)
                most, n = nees_limit(found.rows), str(found.rows)
                yield [group, name, n, f"{found.average:.2f}", f"{low:.2f} to {high:.2f}", f"{most:.2f}", found.verdict]


def _promise_lines(results: Results) -> Iterator[str]:
    found = promises(results)
    broken = [verdict for verdict in found if not verdict.kept]
    yield f"Promises: {len(found) - len(broken)} kept, {len(broken)} broken"
    yield from (f"  BROKEN: {verdict.about}: {verdict.text}" for verdict in broken)
    for group, drives in results.groups("simulated").items():
        worse = f"  single seeds worse than their best baseline: {group}: "
        yield worse + f"{single_seeds_worse(drives)} of {len(drives)}"
