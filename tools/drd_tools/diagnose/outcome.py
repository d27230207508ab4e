"""What is written: diagnosis.json, series.json and model.yaml."""

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from drd.effects.motion import Motion
from drd.model import Model, make_model
from drd.schema import ConfigError
from drd_tools.diagnose.claim import SCALE, Claim
from drd_tools.diagnose.conclude import Conclusion
from drd_tools.diagnose.confirm import rms_per_block
from drd_tools.diagnose.finding import Finding
from drd_tools.diagnose.problem import Problem
from drd_tools.diagnose.ranges import seen
from drd_tools.evaluate.judge import judge
from drd_tools.evaluate.results import Run
from drd_tools.evaluate.trajectory import Poses, reference_of
from drd_tools.recordings.folder import Recording
from drd_tools.replay.folder_source import replay_folder
from drd_tools.replay.nominal import with_model
from drd_tools.replay.result import table

DRAWN_ROWS: Final = 2000
NOTHING, EXPLAINED, PARTLY, UNKNOWN = "nothing_missing", "explained", "partly_explained", "unknown"
WHOLE_SHARE: Final = 0.1  # of the mismatch: so little may be left of what is called explained


def verdict(conclusion: Conclusion) -> str:
    """One of the four words."""
    findings = conclusion.findings
    if not findings:
        return NOTHING
    if all(f.claim is None for f in findings):
        return UNKNOWN
    if any(f.claim is None for f in findings) or conclusion.unexplained > WHOLE_SHARE:
        return PARTLY
    return EXPLAINED


def amounts(claim: Claim | None) -> dict[str, Any]:
    """A claim's parameters in the catalogue's units."""
    if claim is None:
        return {}
    shown: dict[str, Any] = {}
    for q in claim.effect.parameters:
        if q.choices:
            shown[q.name] = claim.values[q.name]
            continue
        value, std = claim.number(q.name), claim.sigma(q.name)
        if q.name == "T0" and SCALE.name in claim.values and claim.number("k"):
            value -= claim.number(SCALE.name) / claim.number("k")  # k (T - T0) w + scale w
        shown[q.name] = {"value": value / q.si, "std": std / q.si, "unit": q.unit}
    return shown


def terms(conclusion: Conclusion) -> list[dict[str, Any]]:
    """The findings as a model's effects."""
    motion = conclusion.found.problem.signatures.motion
    made = []
    for finding in conclusion.findings:
        claim = finding.claim
        if claim is None:
            continue
        made.append(_term(motion, claim))
        if SCALE.name in claim.values and claim.id != "gyro_scale_temperature":
            amount = {"value": claim.number(SCALE.name), "std": claim.sigma(SCALE.name), "unit": "1"}
            made.append({"effect": "gyro_scale_error", "parameters": {"k": amount},
                         "provenance": {"why": f"the straight line beside {claim.id}"}})  # fmt: skip
    return made


def _term(m: Motion, claim: Claim) -> dict[str, Any]:
    term: dict[str, Any] = {"effect": claim.id, "parameters": amounts(claim)}
    if ranges := seen(m, claim):
        term["seen"] = ranges
    return term


def model_of(
    conclusion: Conclusion, recording: Recording, version: str, stand_ins: Sequence[dict[str, Any]] = ()
) -> Model:
    """The nominal robot with what was found, and with names that stand in for what has none."""
    return _model([*terms(conclusion), *_explained(stand_ins)], recording, recording.name, version)


def model_of_findings(
    findings: list[dict[str, Any]],
    recording: Recording,
    names: str,
    version: str,
    stand_ins: Sequence[dict[str, Any]] = (),
) -> Model:
    """The nominal robot with findings as diagnosis.json has them."""
    effects = [
        {"effect": f["effect"], "parameters": f["parameters"]} | ({"seen": f["seen"]} if f["seen"] else {})
        for f in findings
        if f["effect"] != "unknown"
    ]
    return _model([*effects, *_explained(stand_ins)], recording, names, version)


def _explained(stand_ins: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    why = "stands in for a curve without a name, to which it comes nearest"
    return [{**term, "provenance": {"why": why}} for term in stand_ins]


def _model(effects: list[dict[str, Any]], recording: Recording, names: str, version: str) -> Model:
    nominal = recording.nominal
    robot = {
        "wheel": {"radius_m": nominal.wheel.radius_m, "counts_per_revolution": nominal.wheel.counts_per_revolution},
        "tread_m": nominal.tread_m,
    }
    if recording.wheels is None:
        robot = {}
    elif nominal.wheel.counts_per_revolution is None:
        del robot["wheel"]["counts_per_revolution"]  # type: ignore[attr-defined]
    sha = recording.sha256.get("encoders.csv") or next(iter(recording.sha256.values()), "")
    return make_model(effects, robot, recording=names, tool=f"drd diagnose {version}", sha256=sha)


def judged(recording: Recording, model: Path | None) -> tuple[Run | None, npt.NDArray[np.float64]]:
    """The estimator's poses (n, columns) with a model or without, and how far they are from the reference."""
    rows = table(replay_folder(recording if model is None else with_model(recording, model)))
    if recording.reference is None or len(recording.reference.time_s) < 2 or len(rows) < 2:
        return None, rows
    covariance = rows[:, [4, 5, 6, 5, 7, 8, 6, 8, 9]].reshape(-1, 3, 3)
    poses = Poses(recording.name, rows[:, 0], rows[:, 1:4], covariance)
    try:
        return judge(poses, reference_of(recording)), rows
    except ConfigError:
        return None, rows  # start and end only, the start before the first pose


def figures(run: Run | None) -> dict[str, float]:
    """Of an evaluation, by name."""
    if run is None:
        return {}
    found = {
        "end_error_m": run.end.position_m,
        "position_rms_m": run.absolute.position_rmse_m,
        "heading_rms_deg": run.absolute.heading_rmse_deg,
    }
    if run.drift is not None:
        found["drift_percent"] = run.drift.percent
    return found


def drawn_path(rows: Any) -> dict[str, list[float]]:
    """Poses, thinned."""
    index = np.unique(np.linspace(0, len(rows) - 1, min(len(rows), DRAWN_ROWS)).round().astype(int))
    return {name: rows[index, i].tolist() for i, name in enumerate(("time_s", "x_m", "y_m"))}


def paths(recording: Recording, nominal: Any, corrected: Any) -> dict[str, Any]:
    """The paths that are drawn."""
    found: dict[str, Any] = {"reference": None, "nominal": drawn_path(nominal), "corrected": None}
    if recording.reference is not None:
        r = recording.reference
        found["reference"] = drawn_path(np.column_stack([r.time_s, r.x_m, r.y_m]))
    if corrected is not None:
        found["corrected"] = drawn_path(corrected)
    return found


def plain_finding(finding: Finding, problem: Problem) -> dict[str, Any]:
    """As diagnosis.json has it."""
    whole = [[float(problem.evidence.time_s[0]), float(problem.evidence.time_s[-1])]]
    return {
        "effect": finding.effect,
        "status": finding.status.value,
        "also_fits": list(finding.also_fits),
        "acts_on": finding.acts_on,
        "parameters": amounts(finding.claim),
        "windows": [list(w) for w in finding.windows] or whole,
        "seen": {} if finding.claim is None else seen(problem.signatures.motion, finding.claim),
        "driver": finding.driver,
        "evidence": {
            "gain_nats": finding.gain_nats,
            "family_wise_p": finding.family_wise_p,
            "e_value": finding.e_value,
        },
        "explains": finding.explains,
        "stand_in": None if finding.stand_in is None else _term(problem.signatures.motion, finding.stand_in),
        "sentence": finding.sentence,
    }


NO_CURVE: Final[dict[str, Any]] = {"curve": None, "evidence": {"time_s": [], "nats": []}}


def plain_series(finding: Finding) -> dict[str, Any]:
    """As series.json has it."""
    curve: dict[str, Any] | None = None
    if finding.curve is not None:
        c, told = finding.curve, finding.fit.get("told")
        curve = {
            "driver": c.driver, "driver_unit": c.driver_unit, "error_unit": c.unit, "channel": c.channel,
            "x": c.knots.tolist(), "mismatch": c.value.tolist(), "sigma": c.sigma.tolist(),
            "fit_x": [], "fit": [], "low": [], "high": [],
        }  # fmt: skip
        if told is not None and finding.claim is not None:
            share = _relative_sigma(finding)
            band = 1.96 * share * np.abs(told)
            curve |= {"fit_x": c.knots.tolist(), "fit": told.tolist(),
                      "low": (told - band).tolist(), "high": (told + band).tolist()}  # fmt: skip
    evidence = finding.evidence
    return {
        "effect": finding.effect,
        "curve": curve,
        "evidence": {"time_s": [], "nats": []}
        if evidence is None
        else {"time_s": evidence[0].tolist(), "nats": evidence[1].tolist()},
    }


def _relative_sigma(finding: Finding) -> float:
    claim = finding.claim
    assert claim is not None
    shares = [
        claim.sigma(n) / abs(claim.number(n)) for n in claim.effect.linear() if n in claim.free and claim.number(n)
    ]
    return min(1.0, min(shares, default=0.0))


def residual_series(null: Any, conclusion: Conclusion, problem: Problem) -> dict[str, list[float]]:
    """Rms of the whitened data per block, before and after."""
    time_s, before = rms_per_block(problem, null)
    _, after = rms_per_block(conclusion.found.problem, conclusion.found.fit.left)
    return {"time_s": time_s.tolist(), "before": before.tolist(), "after": after.tolist()}


def write_json(file: Path, content: Any) -> None:
    """JSON without values that JSON does not know."""
    file.write_text(json.dumps(finite(content), indent=1, allow_nan=False), encoding="utf-8")


def finite(value: Any) -> Any:
    """As JSON knows it: numpy's numbers as Python's, and null for what is not finite."""
    if isinstance(value, dict):
        return {k: finite(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(v) for v in value]
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, np.integer):
        return int(value)
    return value
