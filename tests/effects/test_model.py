"""model.yaml: what it holds, what is refused, and what estimator, pipeline and replay do with it."""

import dataclasses
import math
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import recorded_drive
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from replay_folders import long_drive, short_drive
from sensors import NO_BIAS, T0, S, drive, feed

from drd.batch.run import compensation
from drd.batch.samples import FIRST_NS
from drd.config.file import load_config
from drd.config.keys import Config
from drd.config.schema import ConfigError, loads
from drd.effects.catalogue import catalogue
from drd.effects.compensation import Compensation
from drd.effects.effect import Parameter
from drd.effects.model import COVARIATES, Amount, Model, Term, load_model, loads_model, make_model, save_model
from drd.estimation.estimator import Estimator
from drd.pipeline import Pipeline
from drd.recording.in_force import MODEL, files_in_force
from drd.samples import CalibratedRate, GyroSample, Validity, WheelSample
from drd.units import RAD_PER_DEG
from drd_tools.recordings.folder import Recording
from drd_tools.replay.folder_source import replay_folder
from drd_tools.replay.mcap_source import replay_mcap
from drd_tools.replay.nominal import with_model
from drd_tools.replay.result import digest

EXAMPLE = """\
tread_m: 0.55
wheel: {radius_m: 0.11}
effects:
  - effect: gyro_scale_error
    parameters:
      k: {value: 0.0016, std: 0.0001, unit: "1"}
    seen: {yaw_rate: [-40.0, 40.0]}
    provenance: {recording: run_07, gain_nats: 310}
  - effect: gyro_bias_step
    parameters: {b: 2e-2, t0: 100}
  - effect: wheel_eccentricity
    parameters: {side: left, e: 0.01, phase: 1.5}
    provenance: {recording: "run_08, run_09"}
provenance: {source: drd diagnose}
"""


def test_the_example_in_full() -> None:
    model = loads_model(EXAMPLE)
    scale, step, ripple = model.terms
    assert dict(model.stated()) == {"wheel.radius_m": 0.11, "tread_m": 0.55}
    assert scale.parameters == {"k": Amount(0.0016, 0.0001)}
    assert scale.seen == {"yaw_rate": (-40.0, 40.0)}
    assert scale.provenance == {"recording": "run_07", "gain_nats": "310"}
    assert step.values() == {"b": pytest.approx(0.02 * RAD_PER_DEG), "t0": 100.0}
    assert scale.stds() == {"k": 0.0001}
    assert step.stds() == {}
    assert ripple.values()["side"] == "left"
    assert model.provenance == {"source": "drd diagnose"}


@pytest.mark.parametrize("text", ["", "effects: []\n", "effects: null\n", "# nothing\n", "provenance: {}\n"])
def test_an_empty_model_is_one(text: str) -> None:
    model = loads_model(text)
    assert model.terms == ()
    assert list(model.stated()) == []


def effect(name: str, parameters: str, more: str = "") -> str:
    return f"tread_m: 1\neffects:\n- effect: {name}\n  parameters: {parameters}\n{more}"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (effect("gyro_skale", "{k: 1}"), r":3: effects\[0\].effect: expected one of .*gyro_lag.*got 'gyro_skale'"),
        ("effects: [{parameters: {k: 1}}]", r":1: effects\[0\].effect: .*got nothing"),
        ("effects: [{effect: [1]}]", r":1: effects\[0\].effect: .*got a list"),
        (effect("gyro_scale_error", "{kk: 1}"), r":4: effects\[0\].parameters.kk: expected one of k, got an unk"),
        (effect("gyro_scale_error", "{}"), r"effects\[0\].parameters.k: expected a number in 1 from .*, got nothing"),
        (effect("gyro_scale_error", "{k: 1, k: 2}"), r"parameters.k: expected each key once, got a duplicate"),
        (effect("gyro_scale_error", "{k: .nan}"), r":4: effects\[0\].parameters.k: .*got '.nan'"),
        (effect("gyro_scale_error", "{k: .inf}"), r"parameters.k: expected a number .*got '.inf'"),
        (effect("gyro_scale_error", "{k: 1e300}"), r"parameters.k: expected a number in 1 from -5 to 5, got '1e300'"),
        (effect("gyro_scale_error", "{k: '0.1'}"), r"parameters.k: expected a number"),
        (effect("gyro_scale_error", "{k: yes}"), r"parameters.k: expected a number"),
        (effect("gyro_scale_error", "{k: [1]}"), r"parameters.k: expected a number.*got a list"),
        (effect("gyro_scale_error", "{k: {std: 1}}"), r"parameters.k.value: expected a number .*got nothing"),
        (effect("gyro_scale_error", "{k: {value: 0, std: -1}}"), r"parameters.k.std: expected a number from 0 to"),
        (effect("gyro_scale_error", "{k: {value: 0, unit: '%'}}"), r"parameters.k.unit: expected '1', .*got '%'"),
        (effect("gyro_scale_error", "{k: {value: 0, sigma: 1}}"), r"parameters.k.sigma: expected one of value, std"),
        (effect("gyro_bias_step", "{b: 1}"), r"parameters.t0: expected a number in s .*got nothing"),
        (effect("gyro_latency", "{delay: -0.1}"), r"parameters.delay: expected a number in s from 1e-05 to"),
        (effect("gyro_lag", "{tau: 0}"), r"parameters.tau: expected a number in s from"),
        (effect("tyre_deflation", "{side: top, total: 0.1}"), r"parameters.side: expected one of left, right, got 'to"),
        (effect("tyre_deflation", "{total: 0.1}"), r"parameters.side: expected one of left, right, got nothing"),
        (effect("gyro_scale_error", "{k: 0}", "  seen: {heading: [0, 1]}\n"), r":5: .*seen.heading: expected one of t"),
        (effect("gyro_scale_error", "{k: 0}", "  seen: {yaw_rate: [1, 1]}\n"), r"seen.yaw_rate: expected a low and a"),
        (effect("gyro_scale_error", "{k: 0}", "  seen: {speed: 3}\n"), r"seen.speed: expected a low .*in m/s, got '3'"),
        (effect("gyro_scale_error", "{k: 0}", "  range: 1\n"), r":5: effects\[0\].range: expected one of effect, par"),
        (effect("gyro_scale_error", "{k: 0}", "  provenance: {a: [1]}\n"), r"provenance.a: expected a text, got a li"),
        ("effects: {effect: gyro_lag}\n", r":1: effects: expected a list of effects or null, got a section"),
        ("effects: []\neffects: []\n", r":2: effects: expected each key once"),
        ("provenance: text\n", r":1: provenance: expected a section of keys"),
        ("tread_m: -1\n", r":1: tread_m: expected a number in m"),
        ("track_m: 1\n", r":1: track_m: expected one of"),
        ("- 1\n", r"expected a section of keys"),
        ("effects: [", r"expected YAML"),
    ],
)  # fmt: skip
def test_what_cannot_be_used_is_named(text: str, expected: str) -> None:
    with pytest.raises(ConfigError, match=expected):
        loads_model(text)


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"none.yaml: .*No such file"):
        load_model(tmp_path / "none.yaml")


PIECES = [
    "effects:", "tread_m:", "wheel:", "- effect:", "effect:", "parameters:", "seen:", "provenance:", "k:", "value:",
    "std:", "unit:", "side:", "yaw_rate:", "gyro_scale_error", "gyro_bias_step", "tyre_deflation", "left", "0.1", "-1",
    "1e-3", ".nan", ".inf", "null", "~", "yes",
    "{", "}", "[", "]", ",", ":", "\n", "\n  ", "\n    ", " ", "'", '"', "&a", "*a",
    "<<: ", "!!int", "!!python/object:os.system", "? ", "| ", "\x07", "\ud800", "9" * 400, "\t", "#", "---\n",
]  # fmt: skip


@settings(deadline=None, max_examples=400)
@given(st.lists(st.sampled_from(PIECES) | st.text(max_size=6), max_size=40).map("".join))
def test_no_text_brings_anything_but_a_model_or_a_config_error(text: str) -> None:
    try:
        model = loads_model(text)
    except ConfigError:
        return
    assert isinstance(model, Model)


ANY = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=4) | st.sampled_from(list(catalogue())),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(
            st.sampled_from(["effects", "effect", "parameters", "seen", "provenance", "k", "value", "unit", "speed"]),
            inner,
            max_size=4,
        )
    ),
    max_leaves=15,
)


@settings(deadline=None, max_examples=300)
@given(ANY)
def test_no_tree_brings_anything_but_a_model_or_a_config_error(tree: Any) -> None:
    text = yaml.safe_dump(tree)
    for form in (text, "effects:\n" + "".join(f"  {line}\n" for line in text.splitlines())):
        try:
            loads_model(form)
        except ConfigError:
            continue


# What people write; PyYAML does not keep the control character U+0085.
TEXT = st.text(st.characters(codec="utf-8", exclude_categories=("C", "Zl", "Zp")), max_size=20)


def amounts(q: Parameter) -> st.SearchStrategy[Amount | str]:
    if q.choices:
        return st.sampled_from(q.choices)
    low = q.low if q.low > 0.0 else -q.high
    return st.builds(Amount, st.floats(low, q.high), st.just(0.0) | st.floats(0.0, q.high))


@st.composite
def terms(draw: st.DrawFn) -> Term:
    chosen = draw(st.sampled_from(list(catalogue().values())))
    ends = st.tuples(st.floats(-1e6, 1e6), st.floats(1e-3, 1e6)).map(lambda e: (e[0], e[0] + e[1]))
    texts = st.dictionaries(st.text("abc_", min_size=1, max_size=5), TEXT, max_size=2)
    return Term(
        chosen,
        {q.name: draw(amounts(q)) for q in chosen.parameters},
        draw(st.dictionaries(st.sampled_from(list(COVARIATES)), ends, max_size=2)),
        draw(texts),
    )


@settings(deadline=None, max_examples=60)
@given(st.lists(terms(), max_size=4), st.floats(0.01, 50.0), st.dictionaries(TEXT, TEXT, max_size=3))
def test_a_saved_model_is_read_as_the_same(
    tmp_path_factory: pytest.TempPathFactory, found: list[Term], tread_m: float, provenance: dict[str, str]
) -> None:
    file = tmp_path_factory.mktemp("model") / "model.yaml"
    robot = loads_model(yaml.safe_dump({"tread_m": tread_m, "wheel": {"counts_per_revolution": None}})).robot
    save_model(file, Model(tuple(found), robot, provenance), "made\nby a test")
    read = load_model(file)
    assert read.terms == tuple(found)
    assert dict(read.stated()) == {"wheel.counts_per_revolution": None, "tread_m": tread_m}
    assert read.provenance == provenance


def test_every_covariate_of_the_catalogue_has_a_range_or_cannot_have_one() -> None:
    assert {e.covariate for e in catalogue().values()} - set(COVARIATES) == {"heading", "wheel_phase", "place"}


def test_what_does_not_last_holds_only_where_it_was_found() -> None:
    model = loads_model(EXAMPLE)
    ids = {name: [t.effect.id for t in model.holds_in(name)[0]] for name in ("run_07", "run_09", None)}
    assert ids["run_07"] == ["gyro_scale_error", "gyro_bias_step"]  # of the step nobody says where it was found
    assert ids["run_09"] == ["gyro_scale_error", "gyro_bias_step", "wheel_eccentricity"]
    assert ids[None] == ["gyro_scale_error"]
    assert "is it this one?" in model.holds_in("run_07")[1][0]


def test_what_cannot_be_taken_off_is_said() -> None:
    model = make_model([{"effect": "gyro_saturation", "parameters": {"limit": 40}}])
    assert model.holds_in(None)[1] == ["gyro_saturation cannot be corrected: all rates beyond the limit read the same"]


# ---- estimator -------------------------------------------------------------------------------------------------


def estimator(*effects: dict[str, Any], text: str = NO_BIAS) -> Estimator:
    config = loads(text, Config).value
    model = Compensation(make_model(effects).terms, config.robot, config.fog.protocol != "none")
    return Estimator(config, compensation=model)


SCALE: dict[str, Any] = {"effect": "gyro_scale_error", "parameters": {"k": 0.02}}
OFFSET: dict[str, Any] = {"effect": "rotation_centre_offset", "parameters": {"a": 0.1}}
TREAD: dict[str, Any] = {"effect": "tread_error", "parameters": {"k": 0.02}}


def test_a_model_without_effects_changes_no_bit() -> None:
    plain, empty = Estimator(loads(NO_BIAS, Config).value), estimator()
    assert feed(plain, drive(20)) == feed(empty, drive(20))


def test_the_pose_is_that_of_a_robot_without_the_effects() -> None:
    def wrong(sample: Any) -> Any:
        if isinstance(sample, GyroSample):
            return sample._replace(rate_rad_s=1.02 * sample.rate_rad_s)
        apart = 0.02 * 0.5 * (sample.right_m - sample.left_m)
        return sample._replace(left_m=sample.left_m - apart, right_m=sample.right_m + apart)

    true = feed(Estimator(loads(NO_BIAS, Config).value), drive(20))[-1]
    blind = feed(estimator(), [(t, wrong(s)) for t, s in drive(20)])[-1]
    found = feed(estimator(SCALE, TREAD), [(t, wrong(s)) for t, s in drive(20)])[-1]
    assert (found.x_m, found.y_m) == pytest.approx((true.x_m, true.y_m), abs=1e-6)
    assert found.heading_rad == pytest.approx(true.heading_rad, abs=1e-7)
    assert abs(blind.y_m - true.y_m) > 0.01


def test_the_health_says_where_the_model_ends_and_does_not_flap() -> None:
    e = estimator({**SCALE, "seen": {"yaw_rate": [-10.0, 10.0]}})
    poses = feed(e, drive(30))  # a slalom of 23 deg/s
    texts = {r.text for p in poses for r in p.reasons if r.source == "model"}
    assert texts == {"outside the range in which the model's effects were observed"}
    changes = [bool(a.reasons) != bool(b.reasons) for a, b in pairwise(poses)]
    assert sum(changes) == 1
    assert poses[-1].validity is Validity.DEGRADED
    assert e.counters["outside_model"] > 100
    later = feed(e, [(t, s) for t, s in drive(10, speed_m_s=0.0, stand_s=20.0, start_s=30.0)])
    assert not later[-1].reasons


def test_a_late_gyro_is_compared_with_the_wheels_of_its_own_time() -> None:
    late_s = 0.2
    late = [(t, s._replace(t_ns=s.t_ns + round(late_s * S)) if isinstance(s, GyroSample) else s) for t, s in drive(20)]
    e = estimator({"effect": "gyro_latency", "parameters": {"delay": late_s}})
    arrived = sorted(((t + late_s if isinstance(s, GyroSample) else t), i, s) for i, (t, s) in enumerate(late))
    feed(e, [(t, s) for t, _, s in arrived])
    plain = Estimator(loads(NO_BIAS, Config).value)
    feed(plain, drive(20))
    assert e.counters["late_gyro"] == 0
    assert e.counters["rejected"] == 0
    assert e.filter.nominal.gyro_heading_rad == pytest.approx(plain.filter.nominal.gyro_heading_rad, abs=0.02)
    assert e.filter.nominal.gyro_scale == pytest.approx(1.0, abs=1e-6)


def test_delays_of_the_model_are_no_silence() -> None:
    e = estimator({"effect": "encoder_latency", "parameters": {"delay": 0.4}})
    poses = feed(e, drive(10))
    for k in range(20):
        e.tick(T0 + round((10.0 + 0.01 * k) * S))
    assert not e.reasons.has("encoders")
    assert [p.t_ns for p in poses] == [T0 + round((i * 0.05 - 0.4) * S) for i in range(1, 201)]


def test_robots_without_gyro_and_without_wheels_have_models_too() -> None:
    text = NO_BIAS + "fog: {protocol: none}\n"
    alone = estimator(TREAD, text=text)
    poses = feed(alone, [(t, s) for t, s in drive(10) if isinstance(s, WheelSample)])
    assert poses[-1].heading_rad == pytest.approx(0.5 * (1 - math.cos(8.0)) / 1.02, rel=1e-3)
    still = estimator(SCALE)
    feed(still, [(t, s) for t, s in drive(10) if isinstance(s, GyroSample)])
    assert still.counters["outside_model"] == 0


def test_the_bodys_own_sideways_way_is_in_the_pose() -> None:
    """In a slalom about a point 0.1 m behind the reported one, this one is 0.1 m ahead along the heading."""
    plain, found = (feed(e, drive(20))[-1] for e in (estimator(), estimator(OFFSET)))
    c, s = math.cos(found.heading_rad), math.sin(found.heading_rad)
    moved = (found.x_m - plain.x_m, found.y_m - plain.y_m)
    assert found.heading_rad == pytest.approx(plain.heading_rad)
    assert moved == pytest.approx((0.1 * (c - 1.0), 0.1 * s), abs=4e-3)


# ---- replay ----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def tour(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return long_drive(tmp_path_factory.mktemp("tour"))


def test_an_empty_list_of_effects_changes_no_bit_of_a_replay(tour: Recording, tmp_path: Path) -> None:
    file = tmp_path / "model.yaml"
    file.write_text("effects: []\n")
    assert replay_folder(with_model(tour, file)).digest() == replay_folder(tour).digest()


def test_effects_come_off_in_a_replay_and_the_summary_says_what_does_not(tour: Recording, tmp_path: Path) -> None:
    assert tour.fog is not None
    wrong = dataclasses.replace(
        tour, fog=dataclasses.replace(tour.fog, rate_rad_s=tour.fog.rate_rad_s * 1.03), sha256=tour.sha256
    )
    file = tmp_path / "model.yaml"
    save_model(file, make_model([{**SCALE, "parameters": {"k": 0.03}}, {
        "effect": "gyro_deadband", "parameters": {"band": 0.01}}]))  # fmt: skip
    true, blind, found = (replay_folder(r) for r in (tour, wrong, with_model(wrong, file)))
    heading = [r.poses[-1].heading_rad for r in (true, blind, found)]
    assert abs(heading[2] - heading[0]) < 0.01 * abs(heading[1] - heading[0])
    assert any("gyro_deadband cannot be corrected" in note for note in found.notes)
    assert str(file) in found.inputs


def test_a_model_named_in_a_configuration_is_used(tour: Recording, tmp_path: Path) -> None:
    save_model(tmp_path / "effects.yaml", make_model([SCALE], {"tread_m": 0.5}))
    config = tmp_path / "robot.yaml"
    text = "robot: {{wheel_radius_m: 0.1, tread_m: {}}}\nencoders: {{counts_per_revolution: 4000}}\n"
    config.write_text(text.format(0.5) + "model: {file: effects.yaml}\n")
    plain = tmp_path / "plain.yaml"
    plain.write_text(text.format(0.5))
    with_file = with_model(tour, tmp_path / "effects.yaml")
    assert replay_folder(tour, config).digest() == replay_folder(with_file, plain).digest()
    assert replay_folder(tour, config).digest() != replay_folder(tour, plain).digest()
    config.write_text(text.format(0.6) + "model: {file: effects.yaml}\n")
    with pytest.raises(ConfigError, match=r"effects.yaml:1: tread_m: expected 0.6, the configuration's robot.tread_m"):
        replay_folder(tour, config)


@pytest.mark.parametrize(("shift_s", "jumps_at_s"), [(0.0, 2.0), (-1.0, 2.0), (20.0, None), (1000.0, 1002.0)])
def test_time_counts_from_the_recordings_zero_if_it_begins_near_it(
    tmp_path: Path, shift_s: float, jumps_at_s: float | None
) -> None:
    short = short_drive(tmp_path)
    assert short.fog is not None
    moved = dataclasses.replace(
        short,
        fog=dataclasses.replace(short.fog, time_s=short.fog.time_s + shift_s),
        wheels=dataclasses.replace(short.encoders, time_s=short.encoders.time_s + shift_s),
        terms=make_model([{"effect": "gyro_bias_step", "parameters": {"b": 1.0, "t0": 2.0}}]).terms,
    )
    first_s = float(min(moved.fog.time_s[0], moved.encoders.time_s[0])) if moved.fog else 0.0
    zero_ns = FIRST_NS - round(first_s * S)
    model = compensation(moved.terms, moved.fog, moved.encoders, replay_folder(short).config)
    assert model is not None
    times_s = np.arange(first_s, first_s + 4.0, 0.1)
    rates = [
        model.gyro(CalibratedRate(zero_ns + round(t * S), 0.1, 0.0, 0.0), math.nan, 0.0, False).rate_rad_s
        for t in times_s.tolist()
    ]
    jumped = [t for t, rate in zip(times_s.tolist(), rates, strict=True) if rate != 0.0]
    assert jumped[0] == pytest.approx(first_s if jumps_at_s is None else jumps_at_s, abs=0.11)


# ---- the daemon's configuration --------------------------------------------------------------------------------

DAEMON = "robot: {wheel_radius_m: 0.1, tread_m: 0.5}\nencoders: {counts_per_revolution: 4000}\nmodel: {file: m.yaml}\n"


def test_the_daemon_loads_the_same_file_and_says_what_it_leaves_alone(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "daemon.yaml").write_text(DAEMON)
    (tmp_path / "m.yaml").write_text(EXAMPLE.replace("0.55", "0.5").replace("0.11", "0.1"))
    loaded = load_config(tmp_path / "daemon.yaml")
    pipeline = Pipeline(loaded.value, tmp_path, lambda *_: None)
    assert pipeline.model is not None
    assert len(pipeline.model.terms) == 3
    assert len(pipeline.model_notes) == 2
    assert "gyro_bias_step is not applied" in caplog.text
    assert files_in_force(loaded, tmp_path)[MODEL] == (tmp_path / "m.yaml").read_bytes()


def test_a_model_of_another_robot_is_refused(tmp_path: Path) -> None:
    (tmp_path / "daemon.yaml").write_text(DAEMON)
    (tmp_path / "m.yaml").write_text(EXAMPLE)
    with pytest.raises(ConfigError, match=r"m.yaml:2: wheel.radius_m: expected 0.1, the configuration's"):
        Pipeline(load_config(tmp_path / "daemon.yaml").value, tmp_path, lambda *_: None)


def test_a_model_that_is_not_there_is_refused(tmp_path: Path) -> None:
    (tmp_path / "daemon.yaml").write_text(DAEMON)
    with pytest.raises(ConfigError, match=r"m.yaml: .*No such file"):
        Pipeline(load_config(tmp_path / "daemon.yaml").value, tmp_path, lambda *_: None)


def test_a_recorded_run_with_a_model_is_replayed_to_the_bit_and_with_another_one_is_not(tmp_path: Path) -> None:
    save_model(tmp_path / "m.yaml", make_model([SCALE, TREAD]))
    d = recorded_drive.drive(tmp_path, "flush_s: 0.1")
    (tmp_path / "robot.yaml").write_text((tmp_path / "robot.yaml").read_text() + "model: {file: m.yaml}\n")
    d.loaded = load_config(tmp_path / "robot.yaml")
    recorder = d.start()
    d.run(10.0)
    assert recorder.close(5.0)
    (file,) = recorded_drive.recordings(tmp_path)
    live = digest(d.poses)
    save_model(tmp_path / "other.yaml", make_model([{**SCALE, "parameters": {"k": -0.02}}]))
    (tmp_path / "m.yaml").unlink()  # it is in the recording
    assert replay_mcap(file).digest() == live
    assert "repeated to the bit" in replay_mcap(file).notes[0]
    changed = replay_mcap(file, model=tmp_path / "other.yaml")
    assert changed.digest() != live
    assert str(tmp_path / "other.yaml") in changed.inputs
