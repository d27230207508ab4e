"""Terms that do not hold in held-out recordings are not in the model; those that do, and those unseen there, are."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import pytest
from msgspec import UNSET

from drd.effects.catalogue import catalogue
from drd.effects.model import Amount, Model, Term, load_model
from drd_tools.diagnose.report.text import in_words
from drd_tools.diagnose.results import Finding, Status, Support
from drd_tools.diagnose.results import Term as Said
from drd_tools.diagnose.validate.held_out import CONTRADICTED_NATS, held_out_nats, prepared
from drd_tools.diagnose.validate.validation import Validated, validate
from drd_tools.recordings.folder import Recording, read_recording
from drd_tools.trial.draw import Case, make
from drd_tools.trial.overlay import planted
from drd_tools.trial.plan import Plan, drawings

SHARED = Path(__file__).parents[4] / "shared" / "recordings"


def drawn(name: str) -> Case:
    (drawing,) = drawings(Plan(nulls=1, singles=1), 46, (4.0, 5.0), only=(name,))
    return make(drawing)


def term(effect: str, **parameters: tuple[float, float]) -> Term:
    return Term(catalogue()[effect], {name: Amount(*value) for name, value in parameters.items()})


def proven(folder: Path, terms: tuple[Term, ...], held_out: list[Recording]) -> Validated:
    """What is said of terms that one recording supports."""
    by_name = {t.effect.id: t for t in terms}
    findings = [
        Finding(
            effect=name, status=Status.SUPPORTED, also_fits=(), acts_on="gyro", parameters={}, windows=(),
            covariate=None, evidence=Support(20.0, 0.01, 50.0), explains=1.0, sentence="It is so.",
        )
        for name in by_name
    ]  # fmt: skip

    def build(kept: Sequence[Said]) -> Model:
        return Model(tuple(by_name[t.effect] for t in kept))

    said = [Said(effect=name, parameters={}) for name in by_name]
    return validate(folder / "model.yaml", build, said, findings, [prepared(other) for other in held_out])


@pytest.fixture(scope="module")
def treaded() -> tuple[Term, Recording]:
    """What is true of a robot, as a fit might say it, and another drive of it."""
    case = drawn("tread_error-d12-000")
    ((effect, values),) = case.effects
    k = float(values["k"])
    return term(effect.id, k=(k * 1.02, abs(k) * 0.05)), case.again()


WRONG = {
    "of another sign": lambda true: replace(true, parameters={"k": Amount(-true.parameters["k"].value, 1e-4)}),
    "where there is nothing": lambda _: term("gyro_scale_error", k=(0.01, 1e-4)),
    "a delay where there is none": lambda _: term("encoder_latency", delay=(0.2, 0.002)),
}


@pytest.mark.parametrize("change", WRONG.values(), ids=WRONG)
def test_a_term_that_is_wrong_is_refused_and_the_true_one_beside_it_is_not(
    treaded: tuple[Term, Recording], change: Callable[[Term], Term]
) -> None:
    true, other = treaded
    wrong = change(true)
    terms = [wrong] if wrong.effect is true.effect else [wrong, true]
    nats = held_out_nats(terms, [prepared(other)])
    assert nats[wrong.effect.id] < 2.0 * CONTRADICTED_NATS
    assert wrong.effect is true.effect or nats[true.effect.id] > 10.0


@pytest.mark.skipif(not SHARED.is_dir(), reason="the shared recordings are not here")
def test_a_delay_is_borne_out_by_a_real_drive_whose_turns_no_gyro_tells() -> None:
    """The drive is 0.03 s late by itself. Told by turns too smooth for it, 0.15 s are refused."""
    drive = read_recording(SHARED / "optiodom_ivanjko_250620201618_run-07")
    late = planted(drive, catalogue()["encoder_latency"], {"delay": 0.12})
    assert held_out_nats([term("encoder_latency", delay=(0.15, 0.005))], [prepared(late)])["encoder_latency"] > 20.0


def test_of_what_a_recording_does_not_show_it_says_nothing(treaded: tuple[Term, Recording]) -> None:
    _, other = treaded
    unseen = term("gyro_scale_error", k=(1e-6, 1e-6))
    lasting_no_longer = term("gyro_bias_step", b=(0.5, 1e-4), t0=(60.0, 1.0))
    assert abs(held_out_nats([unseen, lasting_no_longer], [prepared(other)]).pop("gyro_scale_error")) < 0.1
    assert held_out_nats([lasting_no_longer], [prepared(other)]) == {}


def test_the_model_leaves_out_what_is_refused_and_the_finding_says_so(
    treaded: tuple[Term, Recording], tmp_path: Path
) -> None:
    true, other = treaded
    wrong = term("gyro_scale_error", k=(0.01, 1e-4))
    proof = proven(tmp_path, (true, wrong), [other])
    assert [t.effect.id for t in load_model(tmp_path / "model.yaml").terms] == ["tread_error"]
    assert [t.effect.id for t in proof.model.terms] == ["tread_error"]
    assert [f.status for f in proof.findings] == [Status.CONFIRMED, Status.SUSPECTED]
    assert "recordings support it" in in_words(proof.findings[0])
    assert "contradict it, so it is not in the model" in in_words(proof.findings[1])
    (position,) = [bar for bar in proof.bars if (bar.name, bar.quantity) == (other.name, "position rms")]
    assert position.before is not None
    assert position.after is not None
    assert position.after < 1.01 * position.before  # the way goes along the gyro: a tread hardly moves it


def test_without_held_out_recordings_nothing_is_said_of_them(treaded: tuple[Term, Recording], tmp_path: Path) -> None:
    true, _ = treaded
    proof = proven(tmp_path, (true,), [])
    assert proof.model.terms == (true,)
    assert proof.findings[0].held_out is UNSET
    assert in_words(proof.findings[0]) == "It is so."


def test_a_model_without_terms_is_as_good_as_none(treaded: tuple[Term, Recording], tmp_path: Path) -> None:
    _, other = treaded
    wrong = term("gyro_scale_error", k=(0.01, 1e-4))
    proof = proven(tmp_path, (wrong,), [other])
    assert proof.model.terms == ()
    assert proof.bars
    assert all(bar.before == bar.after for bar in proof.bars)
