"""Simulated with an effect and replayed with the model that names it, a drive drifts as if there were no effect."""

from functools import cache
from pathlib import Path

import pytest

from drd.effects.catalogue import catalogue
from drd.effects.effect import Effect, Parameter
from drd.effects.model import make_model, save_model
from drd_tools.diagnose.validate.trajectory import judged
from drd_tools.recordings.folder import read_recording
from drd_tools.simulate.files import write_folder
from drd_tools.simulate.missions import make_drive
from drd_tools.simulate.robot import DEFAULT
from drd_tools.simulate.simulator import simulate
from drd_tools.simulate.truth import Truth, make_truth

SEED = 3
SHARE_OF_RANGE = 0.15  # of what is plausible
GIVEN: dict[str, float | str] = {
    "side": "left",
    "t0": 50.0,
    "t1": 90.0,
    "T0": 20.0,
    "largest_rate": 60.0,
    "phase": 1.0,
}


@cache
def truth() -> Truth:
    return make_truth(make_drive("warehouse", 140.0), "cycle")


def value(effect: Effect, q: Parameter) -> float | str:
    if q.name in GIVEN:
        return GIVEN[q.name]
    if effect.id == "encoder_missed_counts" and q.name == "speed":
        return 0.5
    return q.neutral + SHARE_OF_RANGE * (q.high - q.neutral)


def errors(folder: Path, model: Path | None) -> tuple[float, float]:
    """Rms position error, m, and heading error, deg."""
    figures, _ = judged(read_recording(folder), model)
    position_m, heading_deg = figures["position_rms_m"], figures["heading_rms_deg"]
    assert position_m is not None
    assert heading_deg is not None
    return position_m, heading_deg


@pytest.fixture(scope="module")
def without_effect(tmp_path_factory: pytest.TempPathFactory) -> tuple[float, float]:
    folder = tmp_path_factory.mktemp("none")
    write_folder(simulate(truth(), DEFAULT, seed=SEED), folder, {})
    return errors(folder, None)


@pytest.mark.parametrize("name", [e.id for e in catalogue().values() if not e.irreversible])
def test_a_model_takes_the_drift_off(name: str, tmp_path: Path, without_effect: tuple[float, float]) -> None:
    effect = catalogue()[name]
    public = {q.name: value(effect, q) for q in effect.parameters}
    si = {q.name: v * q.si if isinstance(v := public[q.name], float) else v for q in effect.parameters}
    folder, model = tmp_path / "run", tmp_path / "model.yaml"
    write_folder(simulate(truth(), DEFAULT, [(effect, si)], seed=SEED), folder, {})
    save_model(model, make_model([{"effect": name, "parameters": public}], recording="run"))
    nominal, corrected = errors(folder, None), errors(folder, model)
    # The wheels' lag is learned without a model, too: what its removal leaves is not better than that, but alike.
    noise = 0.4 if name in ("encoder_lag", "encoder_latency") else 0.15
    for drifted, left, none in zip(nominal, corrected, without_effect, strict=True):
        assert left <= none + max(0.1 * max(drifted - none, 0.0), noise * none)
    assert nominal != without_effect
