"""What no method could pass."""

import math

import numpy as np
import pytest
from scipy.stats import norm
from trial_records import SCALE, TREAD, finding, record

from drd.effects.catalogue import catalogue
from drd_tools.diagnose.observe.evidence import gather
from drd_tools.diagnose.regression.marginal import Marginal
from drd_tools.diagnose.regression.problem import Problem
from drd_tools.diagnose.results import NOTHING
from drd_tools.diagnose.selected import Selected
from drd_tools.simulate.conditions import PERFECT
from drd_tools.simulate.missions import make_drive
from drd_tools.simulate.robot import DEFAULT
from drd_tools.simulate.simulator import simulate
from drd_tools.simulate.truth import make_truth
from drd_tools.trial.ceiling import ceiling_of, set_given
from drd_tools.trial.distance import Rivals, ceiling, half_square, least, nearest
from drd_tools.trial.draw import make
from drd_tools.trial.figures import Figures
from drd_tools.trial.plan import Drawing
from drd_tools.trial.results import TrueEffect
from drd_tools.trial.score import score

NAMES = ("gyro_scale_error", "gyro_scale_asymmetry", "tread_error", "gyro_lag", "gyro_latency")


@pytest.fixture(scope="module")
def problem() -> Problem:
    return Problem(gather(simulate(make_truth(make_drive("warehouse", 90.0)), DEFAULT, (), PERFECT).recording))


def effect(name: str, **values: float) -> Selected:
    return Selected(catalogue()[name], values, tuple(values))


def sized(problem: Problem, name: str, parameter: str, d: float) -> Selected:
    """An effect with one linear parameter, at a distance from nothing."""
    rows = problem.effect_rows([effect(name, **{parameter: 1e-3})])
    return effect(name, **{parameter: 1e-3 * d / math.sqrt(2.0 * half_square(rows, problem.nuisance))})


def test_of_two_linear_names_the_distance_is_what_projection_leaves(problem: Problem) -> None:
    truth = sized(problem, "gyro_scale_error", "k", 12.0)
    near = nearest(problem, truth, [], Rivals(problem, ["gyro_scale_asymmetry"]))
    distances = {n.name: n.distance for n in near}
    assert distances[NOTHING] == pytest.approx(12.0, rel=1e-6)
    a, b = problem.effect_rows([truth]), problem.effect_rows([effect("gyro_scale_asymmetry", k=1e-3)])
    projected = Marginal(problem.nuisance).projected
    share = (a @ projected(b)) ** 2 / (a @ projected(a)) / (b @ projected(b))
    assert 0.0 < share < 0.99
    assert distances["gyro_scale_asymmetry"] == pytest.approx(12.0 * math.sqrt(1.0 - share), rel=1e-3)


def test_look_alikes_are_near_and_a_distance_grows_with_the_size(problem: Problem) -> None:
    rivals = Rivals(problem, NAMES)
    lag = nearest(problem, effect("gyro_lag", tau=0.02), [], rivals)
    assert lag[0].name == "gyro_latency"
    assert lag[0].distance < 0.1 * dict(lag)[NOTHING]
    small, large = (nearest(problem, sized(problem, "tread_error", "k", d), [], rivals)[0] for d in (6.0, 12.0))
    assert large.distance == pytest.approx(2.0 * small.distance, rel=0.05)


def test_others_that_adapt_bring_a_rival_nearer(problem: Problem) -> None:
    truth, rivals = sized(problem, "gyro_scale_error", "k", 12.0), Rivals(problem, ["gyro_lag"])
    beside = sized(problem, "gyro_scale_asymmetry", "k", 12.0)
    alone, among = (nearest(problem, truth, others, rivals) for others in ([], [beside]))
    assert {n.name for n in among} == {NOTHING, "gyro_lag"}
    assert dict(among)[NOTHING] < dict(alone)[NOTHING]


def test_no_method_passes_the_ceiling_of_two_names() -> None:
    # Both names equally often, sizes known: the likelier one, at a distance of 1.5.
    random, d = np.random.default_rng(0), 1.5
    is_other = random.random(40_000) < 0.5
    z = random.normal(size=40_000) + d * is_other
    assert np.mean((z > 0.5 * d) == is_other) == pytest.approx(ceiling([d, 7.0]), abs=0.01)
    assert ceiling([d, 7.0]) == pytest.approx(norm.cdf(0.75))
    assert least([d, 7.0]) == pytest.approx(norm.cdf(0.75) - norm.sf(3.5))
    assert (ceiling([]), least([0.0, 0.0, 0.0])) == (1.0, 0.0)


def test_a_drawn_case_has_a_ceiling() -> None:
    case = make(Drawing("gyro_warmup-d12-000", "single d=12", ("gyro_warmup",), 12.0, 3, (1.5, 1.6)))
    (true,) = case.answer.effects
    assert isinstance(true.distance, float)
    assert true.nearest in {*catalogue(), NOTHING} - {"gyro_warmup"}
    assert 0.0 <= true.distance <= 12.5
    assert true.ceiling == pytest.approx(norm.cdf(0.5 * true.distance))
    assert isinstance(true.least, float)
    assert 0.0 <= true.least <= norm.cdf(0.5 * true.distance)


def limited(true: TrueEffect, ceiling: float, distance: float) -> TrueEffect:
    return TrueEffect(
        effect=true.effect, parameters=true.parameters, detectability=25.0,
        nearest="turn_scrub", distance=distance, ceiling=ceiling, least=ceiling - 0.01,
    )  # fmt: skip


def test_a_row_has_the_mean_of_its_ceilings_and_a_set_its_lowest() -> None:
    low, high = limited(TREAD, 0.7, 1.05), limited(SCALE, 0.9, 2.56)
    singles = [
        record("explained", [true], finding("tread_error"), kind="single d=25")
        for true in (low, high, limited(SCALE, 1.0, 9.0))
    ]
    pair = record("explained", [low, high], finding("tread_error"), kind="pair d=25")
    assert ceiling_of(pair) == 0.7
    assert ceiling_of(record("explained", [low, SCALE])) is None
    assert score(record("nothing_missing", [])).ceiling is None
    figures = Figures([*singles, pair])
    found = next(t for t in figures.tables() if t.caption.startswith("Something is missing: the first name"))
    at = found.header.index("ceiling")
    assert {row[0]: row[at] for row in found.rows} == {"single d=25": "0.87", "pair d=25": "-"}
    sets = next(t for t in figures.tables() if t.caption.startswith("Something is missing: exactly"))
    assert next(r for r in sets.rows if r[0] == "pair d=25")[sets.header.index("ceiling")] == "0.70"
    quoted = {row[0]: row[-1] for row in figures.quoted().rows}
    assert quoted["single d=25: the right name first"] == "0.87"
    assert quoted["single d=25: the right name, or one that the drive cannot tell from it"] == "-"
    drives = figures.drives()
    assert [row[5] for row in drives.rows] == ["0.700", "0.700", "0.900", "0.900", "1.000"]


@pytest.mark.parametrize(
    ("name", "parameters"),
    [("gyro_scale_nonlinearity", {"amplitude_deg_s": 0.05}), ("gyro_scale_temperature", {"k": -1e-4})],
)
def test_an_answer_in_another_form_than_the_catalogues_has_no_ceiling(name: str, parameters: dict[str, float]) -> None:
    row = TrueEffect(effect=name, parameters=dict(parameters))
    set_given(simulate(make_truth(make_drive("warehouse", 30.0)), DEFAULT, (), PERFECT).recording, [row])
    assert row == TrueEffect(effect=name, parameters=dict(parameters))
