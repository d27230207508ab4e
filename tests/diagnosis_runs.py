"""Simulated folders, and `drd diagnose` run on them: its answer, checked for the form of diagnosis.json."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

from diagnosis_drives import SLALOM, selected, simulated

from drd.cli import main
from drd.effects.catalogue import catalogue
from drd.effects.model import load_model
from drd_tools.diagnose.selected import Selected
from drd_tools.simulate.conditions import Conditions, Reference
from drd_tools.simulate.files import write_folder
from drd_tools.simulate.robot import DEFAULT

SCALE = selected("gyro_scale_error", k=0.003)
TREAD = selected("tread_error", k=0.05)
NO_GYRO = DEFAULT.without_gyro()
SPEEDS = replace(DEFAULT, counts_per_revolution=None)
KEYS = {
    "schema", "recording", "verdict", "findings", "unexplained", "ruled_out", "detectable", "classes", "fit",
    "next_drive",
}  # fmt: skip
OF_FINDING = {
    "effect", "status", "also_fits", "acts_on", "parameters", "windows", "driver", "evidence", "explains", "sentence",
}  # fmt: skip


def written(
    folder: Path,
    *selection: Selected,
    reference: str = "full",
    drive: tuple[str, float] = SLALOM,
    seed: int = 1,
    **kwargs: Any,
) -> Path:
    conditions = Conditions(reference=Reference.parse(reference))
    write_folder(simulated(drive, seed, *selection, conditions=conditions, **kwargs), folder, {})
    return folder


def diagnosed(folder: Path, output: Path, *more: str) -> dict[str, Any]:
    """Run it; check for exit code 0 and the form of diagnosis.json; return the answer."""
    # In one process: tests share the cores already.
    assert main(["diagnose", str(folder), "--output", str(output), "--jobs", "1", *more]) == 0
    found: dict[str, Any] = json.loads((output / "diagnosis.json").read_text())
    assert set(found) >= KEYS
    assert found["schema"] == 1
    assert found["recording"] == folder.name.removesuffix(".mcap")
    assert found["verdict"] in ("nothing_missing", "explained", "partly_explained", "unknown")
    assert (found["verdict"] == "nothing_missing") == (found["findings"] == [])
    assert set(found["fit"]) == {"train", "held_out"}
    for finding in found["findings"]:
        assert set(finding) >= OF_FINDING
        assert finding["effect"] in catalogue() or finding["effect"] == "unknown"
        assert set(finding["also_fits"]) <= set(catalogue())
        assert finding["status"] in ("suspected", "supported", "confirmed")
        assert finding["acts_on"] in ("gyro", "wheels", "body", "timing")
        assert all(t0 < t1 for t0, t1 in finding["windows"])
        assert 0.0 < finding["evidence"]["family_wise_p"] <= 1.0
        assert 0.0 <= finding["explains"] <= 1.0
    for name, smallest in found["detectable"].items():
        assert name in catalogue()
        assert smallest["smallest"] > 0.0
    load_model(output / "model.yaml")
    assert (output / "report.html").stat().st_size > 1000
    return found


def names(found: dict[str, Any]) -> list[str]:
    return [finding["effect"] for finding in found["findings"]]
