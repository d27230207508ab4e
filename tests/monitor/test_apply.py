"""Constants of the monitor in the estimator: taken, bounded, given back, replayed, and never a step of the pose."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import structs
from recorded_drive import Drive, drive

from drd.config.keys import Config
from drd.config.schema import loads
from drd.estimation.applied import BIAS, LAG, LARGEST, RADII, TURN, Constant, of_filter
from drd.estimation.covariance import unfit
from drd.monitor.applying import ANEW_SIGMAS, CONFIRMED_S, Applying
from drd.monitor.constants import Constants
from drd.monitor.findings import Finding, Size
from drd.monitor.library import CHANGE, TRAVEL
from drd.monitor.library import TURN as TURN_COLUMN
from drd.pipeline import Pipeline
from drd.service.taking import Taking
from drd.units import NS_PER_S, RAD_PER_DEG
from drd_tools.replay.mcap_source import replay_mcap
from drd_tools.replay.result import digest
from drd_tools.trial import applied

TYRE = Constant(RADII, -0.01, 4e-4, 1.0)
TICK = 200  # of 50 ms; the robot drives circles


def finding(effect: str, probability: float = 0.98, named_s: float = 0.0, **changed: Any) -> Finding:
    told = Finding(
        effect=effect, text="", parameters={}, probability=probability, also_fits=(), since_ns=0, since_std_s=1.0,
        since_m=50.0, until_ns=None, named_ns=round(named_s * NS_PER_S), ruled_out=(), settle="",
    )  # fmt: skip
    return structs.replace(told, **changed)


class Knows:
    """A monitor that has measured the constants."""

    zero_ns = 0

    def __init__(self, way: float = -0.01, turn: float = 0.02, change: float = 3.0, now_s: float = 100.0):
        self.now_s = now_s
        self.sigmas = {TRAVEL: 4e-4, TURN_COLUMN: 0.002, CHANGE: 0.1}
        self.means = {TRAVEL: way, TURN_COLUMN: turn, CHANGE: change}

    bias_rad_s = 1e-4

    def constants(self, changed: int) -> Constants | None:
        assert changed in self.means
        return Constants(self.means, self.sigmas)

    def began_with(self, _: int) -> float:
        return 0.0


def wanted(findings: list[Finding], knows: Knows, applying: Applying | None = None) -> dict[str, Constant | None]:
    applying = applying or Applying()
    applying.look(knows, findings)  # type: ignore[arg-type]
    return applying.wanted


# ---- what is confirmed -----------------------------------------------------------------------------------------------


def test_a_confirmed_constant_is_wanted_with_its_value() -> None:
    assert wanted([finding("wheel_radius_error")], Knows()) == {RADII: Constant(RADII, -0.01, 4e-4, 1.0)}
    assert wanted([finding("tread_error")], Knows()) == {TURN: Constant(TURN, 0.02, 0.002)}
    (lag,) = wanted([finding("encoder_latency")], Knows()).values()
    assert lag is not None
    assert lag.value == pytest.approx(0.03)
    step = finding("gyro_bias_step", parameters={"b": Size(0.02, 0.001, 0.018, 0.022, "deg/s")})
    assert wanted([step], Knows()) == {BIAS: Constant(BIAS, 1e-4 + 0.02 * RAD_PER_DEG, 0.001 * RAD_PER_DEG)}


def test_names_of_one_constant_count_together() -> None:
    both = finding("surface_slip", 0.6, also_fits=(("wheel_radius_error", 0.38),))
    assert RADII in wanted([both], Knows())


@pytest.mark.parametrize(
    ("told", "knows"),
    [
        (finding("wheel_radius_error", 0.6, also_fits=(("gyro_bias_step", 0.38),)), Knows()),
        (finding("gyro_bias_step"), Knows()),
        (finding("wheel_radius_error", named_s=100.0 - 0.5 * CONFIRMED_S), Knows()),
        (finding("wheel_radius_error", until_ns=90 * NS_PER_S), Knows()),
        (finding("wheel_radius_error"), Knows(way=1.1 * LARGEST[RADII])),
        (finding("tread_error"), Knows(turn=-1.1 * LARGEST[TURN])),
    ],
    ids=["a look-alike", "another's", "new", "over", "flat", "skids"],
)
def test_nothing_is_wanted_that_is_doubtful_or_too_large(told: Finding, knows: Knows) -> None:
    assert wanted([told], knows) == {}


def test_the_tyre_that_became_smaller_has_changed_and_both_where_nobody_saw_it() -> None:
    def left(way: float, since_m: float) -> float:
        constant = wanted([finding("wheel_radius_error", since_m=since_m)], Knows(way))[RADII]
        assert constant is not None
        return constant.left

    assert (left(-0.01, 50.0), left(0.01, 50.0), left(0.01, 0.0)) == (1.0, 0.0, 0.5)


def test_it_is_given_back_when_the_finding_is_and_taken_anew_when_it_moves() -> None:
    applying, told = Applying(), finding("wheel_radius_error")
    first = wanted([told], Knows(), applying)[RADII]
    assert wanted([told], Knows(way=-0.0101), applying)[RADII] is first
    far = -0.01 - 1.1 * ANEW_SIGMAS * 8e-4
    again = wanted([told], Knows(way=far), applying)[RADII]
    assert again is not None
    assert again.value == far
    assert wanted([finding("wheel_radius_error", 0.6)], Knows(), applying)[RADII] == again
    assert wanted([], Knows(), applying) == {RADII: None}
    # Contradicted once: it is not taken again.
    assert wanted([told], Knows(), applying) == {RADII: None}


# ---- in the estimator ------------------------------------------------------------------------------------------------


def circles(folder: Path, at: dict[int, Any], seconds: float = 20.0) -> Drive:
    """A recorded drive; `at`: what is called with the pipeline and the time after a tick."""
    d = drive(folder)
    recorder = d.start()

    def between(count: int) -> None:
        if count in at:
            at[count](d.pipeline, d.poses[-1].t_ns)

    d.run(seconds, between)
    assert recorder.close(5.0)
    return d


def take(constant: Constant) -> Any:
    def call(pipeline: Pipeline, now_ns: int) -> None:
        assert pipeline.apply(now_ns, constant.name, constant) is None

    return call


def give_back(name: str) -> Any:
    return lambda pipeline, now_ns: pipeline.apply(now_ns, name, None)


constants = st.builds(
    lambda name, share, sigma, left: Constant(name, share * LARGEST[name], sigma * LARGEST[name], left),
    st.sampled_from(sorted(LARGEST)), st.floats(-1.0, 1.0), st.floats(1e-3, 0.5), st.sampled_from((0.0, 0.5, 1.0)),
)  # fmt: skip


@pytest.fixture(scope="module")
def driving(tmp_path_factory: pytest.TempPathFactory) -> Drive:
    return circles(tmp_path_factory.mktemp("driving"), {}, 10.0)


@given(taken=st.lists(constants, min_size=1, max_size=4))
def test_the_pose_never_steps_and_the_covariance_stays_one(driving: Drive, taken: list[Constant]) -> None:
    estimator = driving.pipeline.estimator
    before, six = estimator.newest(), estimator.filter.pose_covariance()
    for constant in taken:
        assert estimator.apply(constant.name, constant) is None
        assert estimator.newest() == pytest.approx(before, abs=1e-9)
        assert unfit(estimator.filter.P) is None
    assert estimator.filter.pose_covariance() == pytest.approx(six, rel=1e-9, abs=1e-15)
    for name in list(estimator.knowledge.applied.taken):
        assert estimator.apply(name, None) is None
    assert estimator.newest() == pytest.approx(before, abs=1e-9)
    assert not estimator.knowledge.applied.taken


@pytest.mark.parametrize(
    "bad",
    [Constant(RADII, 0.031, 1e-4), Constant(TURN, math.nan, 1e-4), Constant(LAG, 0.01, 0.0), Constant("x", 0.0, 1.0),
     Constant(RADII, 0.01, 1e-4, 2.0)],
)  # fmt: skip
def test_what_is_too_large_or_no_constant_is_refused_and_changes_nothing(driving: Drive, bad: Constant) -> None:
    estimator = driving.pipeline.estimator
    P, nominal = estimator.filter.P.copy(), replace(estimator.filter.nominal)
    assert estimator.apply(bad.name, bad) is not None
    assert estimator.apply(RADII, None) == "radii: nothing to restore"
    assert np.array_equal(P, estimator.filter.P)
    assert nominal == estimator.filter.nominal


@pytest.mark.parametrize(
    "taken",
    [TYRE, Constant(TURN, 0.02, 0.002), Constant(LAG, 0.03, 0.001), Constant(BIAS, 1e-4, 1e-6)],
    ids=lambda c: c.name,
)
def test_given_back_the_filter_has_what_it_had_and_is_as_unsure_as_it_was(tmp_path: Path, taken: Constant) -> None:
    driving = circles(tmp_path, {}, 10.0)
    estimator = driving.pipeline.estimator

    def now() -> Constant:
        return of_filter(estimator.filter, taken.name, driving.loaded.value.robot.tread_m, taken.left)

    before = now()
    assert estimator.apply(taken.name, taken) is None
    assert now().value == pytest.approx(taken.value, abs=taken.sigma)
    assert estimator.apply(taken.name, None) is None
    assert now().value == pytest.approx(before.value, abs=1e-3 * abs(taken.value))
    assert now().sigma > 0.999 * before.sigma
    assert unfit(estimator.filter.P) is None


# ---- recorded, replayed, reloaded ------------------------------------------------------------------------------------


def test_a_replay_takes_and_gives_back_the_same_to_the_bit(tmp_path: Path) -> None:
    at = {TICK: take(TYRE), TICK + 20: take(Constant(LAG, 0.03, 0.002)), TICK + 60: give_back(RADII)}
    d = circles(tmp_path, at)
    (file,) = tmp_path.rglob("*.mcap")
    replayed = replay_mcap(file)
    assert digest(replayed.poses) == digest(d.poses)
    assert any("repeated to the bit" in note for note in replayed.notes)
    (tmp_path / "without").mkdir()
    assert digest(circles(tmp_path / "without", {}).poses) != digest(d.poses)


def test_a_reload_keeps_what_was_taken_and_one_with_it_off_gives_it_back(tmp_path: Path) -> None:
    found = []

    def reload(pipeline: Pipeline, now_ns: int) -> None:
        text = (tmp_path / "robot.yaml").read_text()
        pipeline.reload(now_ns, Pipeline(loads(text, Config).value, tmp_path, lambda *_: None), {})
        found.append(dict(pipeline.estimator.knowledge.applied.taken))
        taking = Taking(pipeline, lambda: now_ns)
        taking.put_in_force(True)
        taking.want({RADII: TYRE, LAG: Constant(LAG, 9.0, 0.1)})
        assert taking.health() is not None
        taking.put_in_force(False)
        taking.want({RADII: TYRE})
        found.append(dict(pipeline.estimator.knowledge.applied.taken))

    circles(tmp_path, {TICK: take(TYRE), TICK + 1: reload})
    assert found == [{RADII: TYRE}, {}]


def test_a_reload_for_other_sensors_gives_back_what_was_taken(tmp_path: Path) -> None:
    radii = []

    def look(pipeline: Pipeline, _: int) -> None:
        n = pipeline.estimator.filter.nominal
        radii.append(n.scale_right - n.scale_left)

    def reload(pipeline: Pipeline, now_ns: int) -> None:
        look(pipeline, now_ns)
        text = (tmp_path / "robot.yaml").read_text().replace("ecore,", "ecore, full_scale_deg_s: 120,")
        pipeline.reload(now_ns, Pipeline(loads(text, Config).value, tmp_path, lambda *_: None), {})
        assert not pipeline.estimator.knowledge.applied.taken
        look(pipeline, now_ns)

    circles(tmp_path, {TICK - 1: look, TICK: take(TYRE), TICK + 1: reload})
    before, adopted, restored = radii
    assert adopted == pytest.approx(TYRE.value, abs=0.003)
    assert restored == pytest.approx(before, abs=0.003)


def test_nobody_that_takes_nothing_pays_for_it(tmp_path: Path) -> None:
    digests = []
    for name, is_on in (("a", False), ("b", True)):
        (tmp_path / name).mkdir()

        def off(pipeline: Pipeline, now_ns: int, is_on: bool = is_on) -> None:
            taking = Taking(pipeline, lambda: now_ns)
            taking.put_in_force(is_on)
            taking.want({} if is_on else {RADII: TYRE})

        digests.append(digest(circles(tmp_path / name, {TICK: off}).poses))
    (tmp_path / "c").mkdir()
    assert digests == [digest(circles(tmp_path / "c", {}).poses)] * 2


# ---- what it is for --------------------------------------------------------------------------------------------------


def test_a_tyre_that_changed_is_taken_and_the_later_pose_is_better() -> None:
    recording = applied.simulated("left tyre 1 % smaller", 3, 420.0)
    off, on = (applied.driven(recording, is_on) for is_on in (False, True))
    (change,) = on.changes
    assert change.constant is not None
    assert abs(change.constant.value + 0.01) < 4.0 * change.constant.sigma
    assert max(map(abs, change.step)) < 1e-9
    before = [i for i, p in enumerate(on.poses) if (p.t_ns - on.zero_ns) / NS_PER_S < change.time_s]
    assert on.poses[: len(before) - 1] == off.poses[: len(before) - 1]
    assert applied.position_rms_m(on, recording) < 0.9 * applied.position_rms_m(off, recording)
