"""Report on a simulated folder, made from its files."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from drd.arrays import Array
from drd.effects.catalogue import catalogue
from drd_tools.recordings.folder import read_recording
from drd_tools.report.page import Page
from drd_tools.simulate.files import CHANGES, read_true_motion, read_truth
from drd_tools.simulate.pictures import draw_changes, draw_motion


def sentences(about: dict[str, Any], columns: dict[str, Array]) -> list[str]:
    """Sentences on the drive and its effects."""
    x, y = columns["x_m"], columns["y_m"]
    apart_m = float(np.hypot(x[-1] - x[0], y[-1] - y[0]))
    laps, names = about["whole_laps"], [row["effect"] for row in about["effects"]]
    driven = f"{laps} whole {'lap' if laps == 1 else 'laps'}" if laps else "cut before the first lap ended"
    return [
        f"Mission {about['mission']}, {driven}: {about['duration_s']:g} s, {about['length_m']:.1f} m; it ends "
        f"{apart_m:.3f} m from where it began.",
        f"Effects: {', '.join(names)}." if names else "No effect: nothing is wrong but the noise of the datasheets.",
    ]


def effect_table(about: dict[str, Any]) -> Iterable[tuple[str, str, str, str]]:
    """Rows: effect, parameter, value with unit, description of the effect."""
    for row in about["effects"]:
        effect = catalogue()[row["effect"]]
        for i, p in enumerate(effect.parameters):
            value = row["parameters"][p.name]
            text = value if isinstance(value, str) else f"{value:.6g} {p.unit}".removesuffix(" 1")
            yield (effect.id if i == 0 else "", p.name, text, effect.sentence if i == 0 else "")


def condition_table(about: dict[str, Any]) -> Iterable[tuple[str, str]]:
    """Rows of name and value, flattened."""
    yield "seed", str(about["seed"])
    yield "temperature", str(about["temperature"])
    yield "gyro_bias_deg_s", f"{about['gyro_bias_deg_s']:.6f}"
    for name, value in about["conditions"].items():
        for key, item in value.items() if isinstance(value, dict) else ((None, value),):
            yield (f"{name}.{key}" if key else name), str(item)


def write_report(folder: Path) -> None:
    """Write pictures and report.html from the folder's files. Raises ConfigError, OSError."""
    about, columns = read_truth(folder), read_true_motion(folder)
    recording = read_recording(folder)
    found = sentences(about, columns)
    page = Page(f"Simulated: {about['mission']}", found)
    picture = folder / "simulated.png"
    draw_motion(picture, columns, f"{about['mission']}, {about['duration_s']:g} s, seed {about['seed']}")
    page.picture(picture, "The true motion, and the temperature that the gyro feels.")
    if CHANGES[0] in columns:
        page.heading("What the effects did")
        draw_changes(folder / "effects.png", columns, recording.nominal.tread_m)
        page.picture(folder / "effects.png", "The noise is the same in both runs and falls out.")
        header = ("effect", "parameter", "value", "what it is")
        page.table(header, effect_table(about), text_columns={1, 2, 3})
    page.heading("What was simulated")
    page.table(("condition", "value"), condition_table(about), "Noise: factors on the datasheets in robot.yaml")
    page.heading("robot.yaml: what is believed")
    page.code((folder / "robot.yaml").read_text(encoding="utf-8"))
    page.save(folder / "report.html")
