"""Pictures of a trial's figures."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from drd_tools.report.style import BLUE, GREY, INK, SERIES, make_figure, styled, tidy
from drd_tools.trial.figures import OURS, Figures, Pair
from drd_tools.trial.plan import VISIBILITIES
from drd_tools.trial.score import of_names, wilson

COLUMNS: Final = 5


def draw_effects(file: Path, figures: Figures) -> bool:
    """A panel per effect: how often its name comes first, against its visibility. False where there is none."""
    kinds = [f"single d={d:g}" for d in VISIBILITIES]
    pairs = figures.of(*kinds)
    names = sorted({r["effects"][0]["effect"] for r, _ in pairs})
    if not names:
        return False
    rows = math.ceil(len(names) / COLUMNS)
    with styled():
        figure = make_figure(13.0, 1.9 * rows + 0.5)
        panels: Any = figure.subplots(rows, COLUMNS, sharex=True, sharey=True, squeeze=False)
        for axes, name in zip(panels.ravel(), names, strict=False):
            own = [[p for p in pairs if p[0]["kind"] == k and p[0]["effects"][0]["effect"] == name] for k in kinds]
            _points(axes, own)
            tidy(axes, name)
            axes.set_title(name, fontsize=8.5)
            axes.set_xticks(range(len(kinds)), [f"{d:g}" for d in VISIBILITIES])
            axes.set_yticks([0.0, 0.5, 1.0])
            axes.set_ylim(-0.06, 1.06)
        for axes in panels.ravel()[len(names) :]:
            axes.set_visible(False)
        figure.supxlabel("visibility d", fontsize=10)
        figure.supylabel("share with the right name first", fontsize=10)
        figure.savefig(file, format="png")
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
    """Bars of the methods: claims where nothing is missing, and the right name first. False where there is nothing."""
    names = [OURS, *sorted({name for r, _ in figures.pairs for name in r.get("baselines", {})})]
    groups = [("nothing is missing:\nsomething is claimed (wrong)", figures.of(*figures.null_kinds))]
    groups += [(f"{k}:\nright name first", figures.of(k)) for k in figures.named_kinds if k.startswith("single d=")]
    groups += [("in no catalogue:\nsomething is named (wrong)", figures.of(*figures.unknown_kinds))]
    groups = [(text, pairs) for text, pairs in groups if pairs]
    if len(names) < 2 or not groups:
        return False
    with styled():
        figure = make_figure(11.0, 3.8)
        axes: Any = figure.subplots()
        width = 0.8 / len(names)
        for k, name in enumerate(names):
            for x, (text, pairs) in enumerate(groups):
                own = [p for p in pairs if name == OURS or name in p[0].get("baselines", {})]
                scores = [s if name == OURS else of_names(r, r["baselines"][name]) for r, s in own]
                if "nothing" in text:
                    good = sum(s.claims for s in scores)
                elif "no catalogue" in text:
                    good = sum(s.named > 0 for s in scores)
                else:
                    good = sum(s.top_1 for s in scores)
                if not scores:
                    continue
                at, value = x + (k - 0.5 * (len(names) - 1)) * width, good / len(scores)
                low, high = wilson(good, len(scores))
                axes.bar(at, value, 0.9 * width, color=SERIES[k], label=name if not x else None)
                axes.plot([at, at], [low, high], color=INK, linewidth=1.0)
        tidy(axes, "Share of recordings, with 95 % Wilson intervals")
        axes.set_xticks(range(len(groups)), [text for text, _ in groups])
        axes.set_ylim(0.0, 1.02)
        axes.legend(ncols=len(names), loc="lower left", bbox_to_anchor=(0.5, 1.0))
        figure.savefig(file, format="png")
    return True
