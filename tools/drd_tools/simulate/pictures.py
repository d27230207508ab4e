"""Pictures of a simulation, from the columns of truth.csv."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from drd.arrays import Array
from drd.units import RAD_PER_DEG
from drd_tools.report.style import BLUE, GREEN, ORANGE, TRUE_GREY, VERMILION, draw_path, picture, tidy


def draw_motion(file: Path, columns: Mapping[str, Array], title: str) -> None:
    """Draw the path on the left; speed, yaw rate and temperature on the right. Raises OSError."""
    with picture(file, 11.0, 6.2) as figure:
        figure.suptitle(title, x=0.012, ha="left", fontsize=14, fontweight="bold")
        sides: Any = figure.subfigures(1, 2, width_ratios=(1.0, 1.1))
        left, right = sides
        draw_path(left.subplots(), columns["x_m"], columns["y_m"], "True path, seen from above")
        time_s = columns["time_s"]
        panels: Any = right.subplots(3, 1, sharex=True)
        for axes, name, color, what in zip(
            panels,
            ("speed_m_s", "rate_deg_s", "temperature_c"),
            (BLUE, GREEN, VERMILION),
            ("Speed / (m/s)", "Yaw rate / (°/s), left positive", "Gyro's temperature / °C"),
            strict=True,
        ):
            axes.plot(time_s, columns[name], color=color, linewidth=1.0)
            axes.margins(x=0.0)
            tidy(axes, what, ticks=6)
        if np.ptp(columns["temperature_c"]) < 0.5:
            panels[2].set_ylim(columns["temperature_c"].mean() - 1.0, columns["temperature_c"].mean() + 1.0)
        panels[2].set_xlabel("time / s")


def draw_changes(file: Path, columns: Mapping[str, Array], tread_m: float) -> None:
    """Draw the changes of the readings due to the effects. Raises OSError."""
    time_s, gyro = columns["time_s"], columns["gyro_change_deg_s"]
    left, right = columns["left_change_m"], columns["right_change_m"]
    step_s = np.diff(time_s, prepend=time_s[0])
    with picture(file, 11.0, 7.2) as figure:
        title = "What the effects changed: readings with them, less readings without"
        figure.suptitle(title, x=0.012, ha="left", fontsize=14, fontweight="bold")
        panels: Any = figure.subplots(3, 1, sharex=True)
        panels[0].plot(time_s, gyro, color=GREEN, linewidth=1.0)
        tidy(panels[0], "Gyro's rate / (°/s)", ticks=6)
        most_m = max(np.abs(left).max(), np.abs(right).max())
        scale, unit = (1000.0, "mm") if most_m < 1.0 else (1.0, "m")
        panels[1].plot(time_s, scale * left, color=ORANGE, linewidth=1.6, label="left")
        panels[1].plot(time_s, scale * right, color=BLUE, linewidth=1.6, dashes=(4, 2), label="right")
        tidy(panels[1], f"Wheels' travel counted since the start / {unit}", ticks=6)
        panels[2].plot(time_s, np.cumsum(gyro * step_s), color=GREEN, linewidth=1.6, label="of the gyro")
        wheels = (right - left) / tread_m / RAD_PER_DEG
        panels[2].plot(time_s, wheels, color=VERMILION, linewidth=1.6, dashes=(4, 2), label="of the wheels")
        tidy(panels[2], "Heading that this makes / °", ticks=6)
        panels[2].set_xlabel("time / s")
        for axes in panels:
            axes.axhline(0.0, color=TRUE_GREY, linewidth=0.8, zorder=0)
            axes.margins(x=0.0)
        for axes in panels[1:]:
            axes.legend(loc="lower right", bbox_to_anchor=(1.0, 0.98), borderaxespad=0.0, ncols=2)
