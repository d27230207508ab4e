"""Pictures of a trial's figures."""

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

from drd_tools.report.style import BLUE, GREY, INK, SERIES, picture, tidy
from drd_tools.trial.figures import OURS, Figures, Pair, by_effect, by_method
from drd_tools.trial.plan import DISTANCES
from drd_tools.trial.score import Score, wilson

COLUMNS: Final = 5


def draw_effects(file: Path, figures: Figures) -> bool:
    """Draw a panel per effect: how often its name comes first, against its detectability. False if there is none."""
    kinds = [f"single d={d:g}" for d in DISTANCES]
    groups = by_effect(figures.of(*kinds))
    if not groups:
        return False
    rows = math.ceil(len(groups) / COLUMNS)
    with picture(file, 13.0, 1.9 * rows + 0.5) as figure:
        panels: Any = figure.subplots(rows, COLUMNS, sharex=True, sharey=True, squeeze=False)
        for axes, (name, pairs) in zip(panels.ravel(), groups, strict=False):
            _points(axes, [[p for p in pairs if p[0].kind == kind] for kind in kinds])
            tidy(axes, name)
            axes.set_title(name, fontsize=8.5)
            axes.set_xticks(range(len(kinds)), [f"{d:g}" for d in DISTANCES])
            axes.set_yticks([0.0, 0.5, 1.0])
            axes.set_ylim(-0.06, 1.06)
        for axes in panels.ravel()[len(groups) :]:
            axes.set_visible(False)
        figure.supxlabel("detectability d", fontsize=10)
        figure.supylabel("share with the right name first", fontsize=10)
    return True


def _points(axes: Any, groups: Sequence[Sequence[Pair]]) -> None:
    for x, pairs in enumerate(groups):
        n, good = len(pairs), sum(s.top_1 for _, s in pairs)
        as_class = sum(s.top_1_class for _, s in pairs)
        if not n:
            continue
        low, high = wilson(good, n)
        axes.plot([x, x], [low, high], color=BLUE, linewidth=2.0, alpha=0.45, solid_capstyle="butt")
        axes.plot(x, as_class / n, "o", color="white", markeredgecolor=GREY, markersize=8)
        axes.plot(x, good / n, "o", color=BLUE, markersize=5)
    axes.set_xlim(-0.5, len(groups) - 0.5)


def draw_methods(file: Path, figures: Figures) -> bool:
    """Draw bars of the methods: false alarms, and the right name first. False if there is nothing to draw."""
    names = [OURS, *figures.methods]
    kinds: list[tuple[str, list[Pair], Callable[[Score], bool]]] = [
        ("nothing is missing:\nsomething is reported (wrong)", figures.of(*figures.null_kinds), lambda s: s.reports),
        *((f"{k}:\nright name first", figures.of(k), lambda s: s.top_1) for k in figures.single_kinds if "=" in k),
        ("in no catalogue:\nsomething is named (wrong)", figures.of(*figures.unknown_kinds), lambda s: s.named > 0),
    ]
    groups = [group for group in kinds if group[1]]
    if len(names) < 2 or not groups:
        return False
    with picture(file, 11.0, 3.8) as figure:
        axes: Any = figure.subplots()
        width = 0.8 / len(names)
        for k, name in enumerate(names):
            for x, (_, pairs, yes) in enumerate(groups):
                flags = [yes(s) for _, s in by_method(name, pairs)]
                if not flags:
                    continue
                at, good = x + (k - 0.5 * (len(names) - 1)) * width, sum(flags)
                low, high = wilson(good, len(flags))
                axes.bar(at, good / len(flags), 0.9 * width, color=SERIES[k], label=name if not x else None)
                axes.plot([at, at], [low, high], color=INK, linewidth=1.0)
        tidy(axes, "Share of recordings, with 95 % Wilson intervals")
        axes.set_xticks(range(len(groups)), [text for text, *_ in groups])
        axes.set_ylim(0.0, 1.02)
        axes.legend(ncols=len(names), loc="lower left", bbox_to_anchor=(0.5, 1.0))
    return True
