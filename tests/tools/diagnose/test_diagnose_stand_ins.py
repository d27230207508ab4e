"""What is in no catalogue, and has a name near it: the model has the name where held-out recordings gain by it."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import diagnosis_files
import numpy as np
import pytest
from diagnosis_drives import SLALOM, recorded, selected
from msgspec.structs import replace

from drd.effects.model import Model, load_model
from drd_tools.diagnose.analysis import analyse
from drd_tools.diagnose.combine.pool import combined
from drd_tools.diagnose.combine.statistics import SufficientStatistics
from drd_tools.diagnose.conclude.outcome import findings_of, model_of, terms_found
from drd_tools.diagnose.files import load
from drd_tools.diagnose.report.text import in_words
from drd_tools.diagnose.results import Amount, Result, Status, Term
from drd_tools.diagnose.run import concluded, together
from drd_tools.diagnose.validate.held_out import prepared
from drd_tools.diagnose.validate.validation import validate
from drd_tools.trial.draw import make
from drd_tools.trial.plan import Plan, drawings

EMPTY = SufficientStatistics((), np.zeros((0, 0)), np.zeros(0), 0, {}, (0.0, 1.0))


def term(k: float, std: float, rates: tuple[float, float]) -> Term:
    return Term(effect="tread_error", parameters={"k": Amount(k, std, "1")}, seen={"yaw_rate": rates})


def with_surrogate(folder: Path, name: str, surrogate: Term) -> Result:
    result, _ = load(diagnosis_files.write(folder, diagnosis_files.only_unknown()))
    finding = replace(result.findings[0], surrogate=surrogate, explains=0.5)
    return replace(result, recording=name, detectable={}, findings=(finding,))


def test_several_recordings_have_one_surrogate_of_their_mean(tmp_path: Path) -> None:
    results = [
        with_surrogate(tmp_path, "one", term(0.02, 0.001, (-10.0, 20.0))),
        with_surrogate(tmp_path, "two", term(0.03, 0.002, (-30.0, 5.0))),
    ]
    found = combined(results, [EMPTY, EMPTY]).findings
    (only,) = [f.surrogate for f in found if f.surrogate is not None]
    scatter = 19 / (1.25e6 - 1.0625e12 / 1.25e6)  # of values whose squared deviations from their mean add up to 20
    one, two = 1e-6 + scatter, 4e-6 + scatter
    assert only.parameters["k"].value == pytest.approx((0.02 / one + 0.03 / two) / (1 / one + 1 / two))
    assert only.seen == {"yaw_rate": (-30.0, 20.0)}


def test_a_name_that_is_found_is_no_surrogate_beside_itself(tmp_path: Path) -> None:
    result = with_surrogate(tmp_path, "one", term(0.02, 0.001, (-10.0, 20.0)))
    named = replace(
        result.findings[0], effect="tread_error", parameters={"k": Amount(0.01, 0.001, "1")}, surrogate=None
    )
    result = replace(result, findings=(*result.findings, named))
    assert [f.surrogate for f in combined([result], [EMPTY]).findings] == [None, None]


def test_a_curve_has_the_nearest_name_in_the_model_where_another_drive_gains_by_it(tmp_path: Path) -> None:
    (drawing,) = drawings(Plan(unknowns=2), 31, (4.0, 10.0), only=("unknown_slip_map-d20-001",))
    case = make(drawing)
    result, file = analyse(case.recording), tmp_path / "model.yaml"
    findings, terms = findings_of(result.conclusion), terms_found(findings_of(result.conclusion))
    (surrogate,) = [f.surrogate for f in findings]
    assert findings[0].effect == "unknown"
    assert surrogate is not None
    assert surrogate.effect == "wheel_radius_error"
    build = partial(model_of, recording=result.recording, names=result.recording.name, version="0")

    def made(sign: float) -> Model:
        asked: list[str] = []

        def turned(terms: Sequence[Term]) -> Model:
            asked.extend(t.effect for t in terms)
            signed = [{n: replace(a, value=sign * a.value) for n, a in t.parameters.items()} for t in terms]
            return build([replace(t, parameters=p) for t, p in zip(terms, signed, strict=True)])

        (said,) = validate(file, turned, terms, findings, [prepared(case.again())]).findings
        assert asked[-1] == surrogate.effect
        assert ("in its place" in in_words(said)) == (said.surrogate is not None) == (sign > 0.0)
        return load_model(file)

    (kept,) = made(1.0).terms
    assert kept.effect.id == "wheel_radius_error"
    assert "stands in" in kept.provenance["why"]
    assert made(-1.0).terms == ()
    alone = concluded(result)
    assert alone.model.terms == ()
    assert alone.findings[0].surrogate is None
    # Only the common model of several recordings is validated.
    of_all = together([case.recording] * 2, [prepared(case.again())], [alone] * 2, "all")
    assert [t.effect.id for t in of_all.model.terms] == ["wheel_radius_error"]


def test_a_curve_that_stands_for_a_chance_find_does_not_hide_what_is_left_of_it() -> None:
    """A step of the bias, which chance gives as well, and what is left beside it are the same curve of the scale."""
    (drawing,) = drawings(Plan(unknowns=1), 2053, (4.0, 10.0), only=("unknown_scale_hysteresis-d20-000",))
    conclusion = analyse(make(drawing, judged=False).recording).conclusion
    assert [c.id for c in conclusion.found.fit.selection] == ["gyro_bias_step"]
    (cause,) = conclusion.causes
    assert cause.effect == "unknown"
    assert cause.curve is not None
    assert (cause.curve.channel, cause.curve.covariate) == ("gyro's scale", "time")
    assert cause.explains == pytest.approx(1.0)


def test_what_is_only_suspected_is_not_in_the_model_unless_another_drive_bears_it_out(tmp_path: Path) -> None:
    bent = selected("gyro_scale_nonlinearity", a2=0.01, a3=0.008, largest_rate=0.5)
    result, file = analyse(recorded(SLALOM, 3, bent)), tmp_path / "model.yaml"
    (finding,), terms = findings_of(result.conclusion), terms_found(findings_of(result.conclusion))
    build = partial(model_of, recording=result.recording, names=result.recording.name, version="0")
    assert [t.effect for t in terms] == [finding.effect, "gyro_scale_error"]  # the straight line beside the bent one
    for status, held_out, expected in (
        (Status.CONFIRMED, [], [t.effect for t in terms]),
        (Status.SUSPECTED, [], []),
        (Status.SUSPECTED, [prepared(recorded(SLALOM, 4, bent))], [t.effect for t in terms]),
    ):
        validate(file, build, terms, [replace(finding, status=status)], held_out)
        assert [t.effect.id for t in load_model(file).terms] == expected
