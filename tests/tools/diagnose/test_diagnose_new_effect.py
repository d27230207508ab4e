"""A new effect is a new file: with no other change it is simulated, found, reported and taken off."""

import importlib
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from diagnosis_drives import WAREHOUSE, selected
from diagnosis_runs import diagnosed, written

import drd.effects
from drd.cli import main
from drd.effects.catalogue import catalogue
from drd.effects.model import load_model
from drd_tools.evaluate.trajectory import read_reference

NAME = "gyro_bias_speed"
SENTENCE = "The gyro's bias follows the speed, as that of a coil beside a motor."
MODULE = f'''"""The gyro's bias follows the speed."""

from drd.effects.effect import ActsOn, Effect, Errors, Parameter, Values, number
from drd.effects.motion import Motion
from drd.units import RAD_PER_DEG


class BiasSpeed(Effect):
    """{SENTENCE}"""

    id = "{NAME}"
    acts_on = ActsOn.GYRO
    formula = "e = field v"
    source = "made up"
    parameters = (Parameter("field", "deg/s per m/s", "bias per speed", 1e-3, 1.0, RAD_PER_DEG),)
    covariate = "speed"
    manoeuvre = "straight lines at several speeds"

    def error(self, m: Motion, p: Values) -> Errors:
        return Errors(gyro_rad_s=number(p, "field") * m.speed_m_s)


EFFECT = BiasSpeed()
'''


@pytest.fixture
def added(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The catalogue with one file more."""
    (tmp_path / "more").mkdir()
    (tmp_path / f"more/{NAME}.py").write_text(MODULE)
    monkeypatch.setattr(drd.effects, "__path__", [*drd.effects.__path__, str(tmp_path / "more")])
    importlib.invalidate_caches()
    catalogue.cache_clear()
    yield
    sys.modules.pop(f"drd.effects.{NAME}", None)
    catalogue.cache_clear()


def heading_rms_deg(poses: Path, folder: Path) -> float:
    table, reference = read_table(poses), read_reference(folder)
    error = np.degrees(np.interp(reference.time_s, table[:, 0], np.radians(table[:, 3])) - reference.pose[:, 2])
    return float(np.std(error[reference.time_s <= table[-1, 0]]))


def read_table(file: Path) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    return np.loadtxt([line for line in file.read_text().splitlines() if line[:1] in "-0123456789"], delimiter=",")


@pytest.mark.usefixtures("added")
def test_a_file_more_is_simulated_found_reported_and_taken_off(tmp_path: Path) -> None:
    size = np.radians(0.05)
    folder = written(tmp_path / "run", selected(NAME, field=size), drive=WAREHOUSE)
    found = diagnosed(folder, tmp_path / "out")
    assert [f["effect"] for f in found["findings"]] == [NAME]
    field = found["findings"][0]["parameters"]["field"]
    assert field["value"] == pytest.approx(0.05, abs=4.0 * field["std"])
    assert SENTENCE in (tmp_path / "out/report.html").read_text().replace("&#39;", "'")
    assert [t.effect.id for t in load_model(tmp_path / "out/model.yaml").terms] == [NAME]
    rms = []
    for more in ([], ["--model", str(tmp_path / "out/model.yaml")]):
        assert main(["replay", str(folder), *more, "--output", str(tmp_path / "poses.csv")]) == 0
        rms.append(heading_rms_deg(tmp_path / "poses.csv", folder))
    assert rms[1] < 0.8 * rms[0]


def test_it_is_gone_again() -> None:
    assert NAME not in catalogue()
