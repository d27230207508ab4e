"""What is in no catalogue, and has a name near it: the model has the name where held-out recordings gain by it."""

import copy
from pathlib import Path
from typing import Any

import diagnosis_files
import numpy as np
import pytest

from drd.model import Model, load_model
from drd_tools.diagnose.diagnose import diagnose
from drd_tools.diagnose.joint import Share
from drd_tools.diagnose.outcome import model_of, plain_finding
from drd_tools.diagnose.pool import pooled
from drd_tools.diagnose.prove import save_proven
from drd_tools.diagnose.report_text import in_words
from drd_tools.trial.draw import make
from drd_tools.trial.plan import Plan, drawings

EMPTY = Share((), np.zeros((0, 0)), np.zeros(0), 0, {}, (0.0, 1.0))


def term(k: float, std: float, rates: tuple[float, float]) -> dict[str, Any]:
    parameters = {"k": {"value": k, "std": std, "unit": "1"}}
    return {"effect": "tread_error", "parameters": parameters, "seen": {"yaw_rate": list(rates)}}


def with_stand_in(name: str, stand_in: dict[str, Any]) -> dict[str, Any]:
    content = copy.deepcopy(diagnosis_files.only_unknown()[0])
    content |= {"recording": name, "detectable": {}}
    content["findings"][0] |= {"stand_in": stand_in, "seen": {}, "explains": 0.5}
    return content


def test_several_recordings_have_one_stand_in_of_their_mean() -> None:
    contents = [
        with_stand_in("one", term(0.02, 0.001, (-10.0, 20.0))),
        with_stand_in("two", term(0.03, 0.002, (-30.0, 5.0))),
    ]
    found = pooled(contents, [EMPTY, EMPTY])["findings"]
    (only,) = [f["stand_in"] for f in found if f["stand_in"] is not None]
    assert only["parameters"]["k"]["value"] == pytest.approx((0.02 / 1e-6 + 0.03 / 4e-6) / (1 / 1e-6 + 1 / 4e-6))
    assert only["seen"] == {"yaw_rate": [-30.0, 20.0]}


def test_a_name_that_is_found_does_not_stand_in_beside_itself() -> None:
    content = with_stand_in("one", term(0.02, 0.001, (-10.0, 20.0)))
    named = {**content["findings"][0], "effect": "tread_error", **term(0.01, 0.001, (-10.0, 20.0)), "stand_in": None}
    content["findings"].append(named)
    assert [f["stand_in"] for f in pooled([content], [EMPTY])["findings"]] == [None, None]


def test_a_curve_has_the_nearest_name_in_the_model_where_another_drive_gains_by_it(tmp_path: Path) -> None:
    (drawing,) = drawings(Plan(unknowns=2), 31, (4.0, 10.0), only=("unknown_slip_map-d20-001",))
    case = make(drawing)
    result, file = diagnose(case.recording), tmp_path / "model.yaml"
    problem = result.conclusion.found.problem
    findings = [plain_finding(f, problem) for f in result.conclusion.findings]
    (stand_in,) = [f["stand_in"] for f in findings]
    assert findings[0]["effect"] == "unknown"
    assert stand_in["effect"] == "wheel_radius_error"

    def made(sign: float) -> Model:
        asked: list[Any] = []

        def make_one(near: Any) -> Model:
            asked.append(near)
            turned = [copy.deepcopy(t) for t in near]
            for amount in (a for t in turned for a in t["parameters"].values()):
                amount["value"] *= sign
            return model_of(result.conclusion, result.recording, "0", turned)

        said = copy.deepcopy(findings)
        save_proven(file, make_one, said, [case.again()])
        assert asked[-1] == [stand_in]
        assert ("stands in for it" in in_words(said[0])) == (said[0]["stand_in"] is not None) == (sign > 0.0)
        return load_model(file)

    (kept,) = made(1.0).terms
    assert kept.effect.id == "wheel_radius_error"
    assert "stands in" in kept.provenance["why"]
    assert made(-1.0).terms == ()
    save_proven(file, lambda near: model_of(result.conclusion, result.recording, "0", near), findings, [])
    assert load_model(file).terms == ()
    assert findings[0]["stand_in"] is None
