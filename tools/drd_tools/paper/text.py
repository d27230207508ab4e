"""Table II and its conclusions, as text."""

from collections.abc import Iterator
from typing import Final

import numpy as np

from drd.arrays import Array
from drd_tools.paper.printed import TABLE_II_CM
from drd_tools.paper.results import Results, factors, single_factors
from drd_tools.paper.runs import CELLS

HEADINGS: Final = ("without either", "filter alone", "calibration alone", "both")
GAINS: Final = (2, 1, 3)  # cells, in the order of the paper's argument


def table_rows(results: Results) -> list[list[str]]:
    """Rows: run or average, then for each cell the paper's and our figure, cm."""
    ours, printed, n = 100.0 * results.return_m, TABLE_II_CM, results.runs_each_way
    rows = []
    for way, runs in (("cw", slice(0, n)), ("ccw", slice(n, 2 * n))):
        paper = printed[:5] if way == "cw" else printed[5:]
        for i, run in enumerate(range(runs.start, runs.stop)):
            own = [f"{v:.1f}" for v in paper[i]] if i < len(paper) else ["-"] * len(CELLS)
            rows.append([f"run {run + 1}", *_pairs(own, ours[:, run])])
        mean = [f"{v:.1f}" for v in paper.mean(axis=0)]
        rows.append([f"average {way}", *_pairs(mean, ours[:, runs].mean(axis=1))])
    return rows


def _pairs(paper: list[str], ours: Array) -> Iterator[str]:
    """Yield cells with both figures. `ours` has the shape (gyros, cells)."""
    low, high = np.percentile(ours, (5.0, 95.0), axis=0)
    for k, printed in enumerate(paper):
        yield f"{printed} | {ours[:, k].mean():.1f} ({low[k]:.0f}-{high[k]:.0f})"


def gain_rows(results: Results) -> list[list[str]]:
    """Rows for each method: the paper's factor, ours with its 95 % interval, that of single gyros, and on the way."""
    rows = []
    for cell in GAINS:
        gain, low, high = factors(results.return_m, cell)
        single = np.percentile(single_factors(results.return_m, cell), (5.0, 95.0))
        way, way_low, way_high = factors(results.largest_m, cell)
        rows.append(
            [
                HEADINGS[cell],
                f"{printed_gain(cell):.1f}",
                f"{gain:.1f} [{low:.1f}, {high:.1f}]",
                f"{single[0]:.1f} to {single[1]:.1f}",
                f"{way:.1f} [{way_low:.1f}, {way_high:.1f}]",
            ]
        )
    return rows


def printed_gain(cell: int) -> float:
    """Improvement factor of the paper: ratio of the sums of Table II's columns."""
    total = TABLE_II_CM.sum(axis=0)
    return float(total[0] / total[cell])


def sentences(results: Results) -> list[str]:
    """Sentences on the results, and where and why they differ from the paper; every figure is computed."""
    gains = [factors(results.return_m, cell)[0] for cell in GAINS]
    printed = [printed_gain(cell) for cell in GAINS]
    return [
        f"Calibration alone makes the return position error {gains[0]:.1f} times smaller, the filter alone "
        f"{gains[1]:.1f} times, both {gains[2]:.1f} times. The paper measured {printed[0]:.1f}, {printed[1]:.1f} and "
        f"{printed[2]:.1f} with one gyro on one robot.",
        *(_difference(results, cell) for cell in GAINS),
        _filter_depends(results),
        _on_the_way(results),
        _table_residual(results),
    ]


def _difference(results: Results, cell: int) -> str:
    """Sentence on whether a gyro like the paper's occurs among ours."""
    printed, single = printed_gain(cell), single_factors(results.return_m, cell)
    low, high = np.percentile(single, (5.0, 95.0))
    share = 100.0 * float(np.mean(single <= printed))
    head = f"{HEADINGS[cell].capitalize()}: the paper's factor {printed:.1f} "
    if low <= printed <= high:
        return head + f"is within what single gyros give ({low:.1f} to {high:.1f}); {share:.0f} % of ours gain less."
    where = "more" if printed > high else "less"
    ratio = 100.0 * results.return_m.mean(axis=(0, 1)) / TABLE_II_CM.mean(axis=0)
    return head + (
        f"is {where} than single gyros give here ({low:.1f} to {high:.1f}): our error without either is {ratio[0]:.1f} "
        f"times the paper's, with this method {ratio[cell]:.1f} times."
    )


def _filter_depends(results: Results) -> str:
    """Sentence explaining the filter's share by the accuracy of the wheels' turn."""
    error = [
        f"{name}, its factor alone is {e[0] / e[1]:.1f}"
        for name, e in zip(results.other_names, results.others, strict=True)
    ]
    compared, alone = np.median(results.comparing_m, axis=0)
    return (
        "The filter can only take from the wheels what they know better than the gyro. With a calibrated gyro and all "
        f"noise known, comparing the headings brings the standard deviation of the return position from {alone:.3f} to "
        f"{compared:.3f} m: both methods can be {alone / compared:.2f} times better than calibration alone, and no "
        "more, since the rest is the wheels' way. Where the robot has "
        f"{'; '.join(error)}. The paper does not say how well its wheels knew a turn."
    )


def _on_the_way(results: Results) -> str:
    largest, back = results.largest_m.mean(axis=(0, 1)), results.return_m.mean(axis=(0, 1))
    delay_s, at_return, on_the_way = results.delay[-1]
    return (
        f"On the way the pose is worse than at the return: {100 * largest[3]:.0f} cm against {100 * back[3]:.0f} cm "
        "with both methods. The return position hides a constant delay altogether: perfect sensors with a gyro "
        f"{delay_s:g} s late return to {1000 * at_return:.1f} mm, but are up to {100 * on_the_way:.0f} cm off on the "
        "way."
    )


def _table_residual(results: Results) -> str:
    before, after = np.sqrt(np.mean(results.table_deg_s**2, axis=0))
    ratio = results.table_deg_s[:, 0] / results.table_deg_s[:, 1]
    return (
        f"On new rate-table data the calibration brings the gyro's error from {before:.3f} to {after:.4f} deg/s rms; "
        f"the median gyro gains {np.median(ratio):.0f} times, {100 * np.mean(ratio >= 10):.0f} % gain ten times or "
        "more."
    )
