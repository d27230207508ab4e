"""A pipeline that goes on with another configuration, input by input."""

import math
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import pytest
from recorded_drive import Drive, drive

from drd.config.keys import Config
from drd.config.schema import loads
from drd.pipeline import Pipeline
from drd.samples import Pose, Validity

ROBOT = "robot: {wheel_radius_m: 0.1, tread_m: 0.5}\n"
ENCODERS = """{layout: dbc, interface: slcan, channel: /nowhere/can, counts_per_revolution: 1000,
  dbc: {file: robot.dbc}, left: {message: WHEELS, signal: LEFT}, right: {message: WHEELS, signal: RIGHT}}"""
TICK = 200  # of 50 ms; the robot drives circles and its bias has been measured


def run(
    folder: Path,
    change: Callable[[str], str] | None,
    tick: int = TICK,
    seconds: float = 20.0,
    notes: list[str] | None = None,
    model: str = "",
) -> Drive:
    """A drive, with a reload of the changed configuration after a tick; None: without."""
    d = drive(folder)
    if model:
        (folder / "model.yaml").write_text(model)
        text = (folder / "robot.yaml").read_text() + "model: {file: model.yaml}\n"
        (folder / "robot.yaml").write_text(text)
        d = Drive(loads(text, Config, str(folder / "robot.yaml")), folder)
    recorder = d.start()

    def between(count: int) -> None:
        if count == tick and change is not None:
            text = change((folder / "robot.yaml").read_text())
            fresh = Pipeline(loads(text, Config).value, folder, lambda *_: None)
            found = d.pipeline.reload(d.poses[-1].t_ns, fresh, {})
            if notes is not None:
                notes.extend(found)

    d.run(seconds, between)
    assert recorder.close(5.0)
    return d


def test_what_decoding_does_not_depend_on_does_not_interrupt_it(tmp_path: Path) -> None:
    def moved(text: str) -> str:
        text = text.replace("channel: /nowhere/can", "channel: /elsewhere, queue_frames: 500, silent_after_s: 0.4")
        return text.replace("port: /nowhere/fog", "port: /elsewhere/fog, baud: 19200, silent_after_s: 0.6")

    runs = []
    for name, change in (("a", moved), ("b", None)):
        (tmp_path / name).mkdir()
        runs.append(run(tmp_path / name, change))
    for a, b in zip(as_rows(runs[0].poses), as_rows(runs[1].poses), strict=True):
        assert a == pytest.approx(b, rel=1e-9, abs=1e-12)


DBC = """\
VERSION ""
BU_: ROBOT
BO_ 256 WHEELS: 8 ROBOT
 SG_ LEFT : 0|16@1+ (1,0) [0|0] "" ROBOT
 SG_ RIGHT : 16|16@1+ (1,0) [0|0] "" ROBOT
"""


@pytest.mark.parametrize("other", [DBC.replace("256", "300"), DBC.replace("0|16", "32|16"), DBC])
def test_a_dbc_file_that_was_edited_in_place_is_another_layout_and_its_name_tells_nothing(
    tmp_path: Path, other: str
) -> None:
    text = ROBOT + f"fog: {{port: /nowhere/fog}}\nencoders: {ENCODERS}\n"

    def made(name: str) -> Pipeline:
        return Pipeline(loads(text.replace("robot.dbc", name), Config).value, tmp_path, lambda *_: None)

    (tmp_path / "robot.dbc").write_text(DBC)
    (tmp_path / "other.dbc").write_text(other)
    pipeline = made("robot.dbc")
    before, fresh = pipeline.encoders, made("other.dbc")
    anew = pipeline.reload(1, fresh, {})
    assert (pipeline.encoders is before) is (other == DBC)
    assert (anew == []) is (other == DBC)
    assert pipeline.encoders.can_ids == fresh.encoders.can_ids


def test_a_port_that_is_opened_anew_leaves_no_half_of_a_packet(tmp_path: Path) -> None:
    text = ROBOT + "fog: {protocol: dsp3000, port: /nowhere/fog}\nencoders: {layout: agilex, channel: /nowhere/can}\n"
    pipeline = Pipeline(loads(text, Config).value, tmp_path, lambda *_: None)
    assert pipeline.fog is not None
    pipeline.port_state("fog.port", None, 1)
    pipeline.on_fog_bytes(b"   19.99", 2)
    pipeline.port_state("fog.port", None, 3)  # a reload opens the ports again, and none was lost
    pipeline.on_fog_bytes(b"0000 1\r\n", 4)
    assert pipeline.fog.counters["frames"] == 0


MODEL = """\
effects:
  - {effect: gyro_warmup, parameters: {b: 0.05, tau: 20}}
  - {effect: wheel_radius_error, parameters: {left: 0.01}}
  - {effect: gyro_latency, parameters: {delay: 0.03}}
"""


def test_a_model_that_stays_goes_on_where_it_was(tmp_path: Path) -> None:
    runs = []
    for name, change in (("a", lambda text: text), ("b", None), ("c", lambda text: text + "realtime: {}\n")):
        (tmp_path / name).mkdir()
        runs.append(run(tmp_path / name, change, model=MODEL))
    for other in (runs[0], runs[2]):
        for a, b in zip(as_rows(other.poses), as_rows(runs[1].poses), strict=True):
            assert a == pytest.approx(b, rel=1e-9, abs=1e-12)


def as_rows(poses: list[Pose]) -> list[tuple[float, ...]]:
    return [(p.t_ns, p.sequence, p.x_m, p.y_m, p.heading_rad, p.speed_m_s, *p.covariance) for p in poses]


@pytest.mark.parametrize("tick", [10, 100, 105, 155, 165, TICK, 251])
def test_the_same_configuration_again_changes_nothing(tmp_path: Path, tick: int) -> None:
    """In a measurement of the bias, with a lost port, after commands. A measurement that is under way begins anew."""
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    with_it, without = (run(tmp_path / f, c, tick) for f, c in (("a", lambda text: text), ("b", None)))
    assert len(with_it.poses) == len(without.poses)
    if tick in (10, 165):
        return
    for a, b in zip(as_rows(with_it.poses), as_rows(without.poses), strict=True):
        assert a == pytest.approx(b, rel=1e-9, abs=1e-12)
    assert [p.reasons for p in with_it.poses] == [p.reasons for p in without.poses]
    assert with_it.pipeline.counters() == without.pipeline.counters()


CHANGES: dict[str, Callable[[str], str]] = {
    "calibration off": lambda text: text.replace("calibration.yaml", "null"),
    "gyro off": lambda text: text.replace("protocol: ecore", "protocol: none"),
    "other counts": lambda text: text.replace("20000", "20010"),
    "other tread": lambda text: text.replace("tread_m: 0.6", "tread_m: 0.61"),
    "gyro's heading": lambda text: text.replace("{static", "{heading: gyro, static"),
    "paper's noise": lambda text: text.replace("{static", "{profile: paper, static"),
    "other radius": lambda text: text.replace("0.11", "0.111"),
    "no bias measurement": lambda text: text.replace("duration_s: 2,", "duration_s: 0,"),
}


@pytest.mark.parametrize("name", CHANGES)
def test_whatever_changes_the_pose_goes_on_and_claims_no_more(tmp_path: Path, name: str) -> None:
    notes: list[str] = []
    (tmp_path / "unchanged").mkdir()
    unchanged = {p.t_ns: p for p in run(tmp_path / "unchanged", None, 220, 12.0).poses}
    d = run(tmp_path, CHANGES[name], 220, 12.0, notes)
    poses = d.poses
    at = len(poses) - 20
    top = max(p.speed_m_s for p in poses)
    for a, b in pairwise(poses[at - 10 :]):
        dt_s = (b.t_ns - a.t_ns) * 1e-9
        assert b.sequence == a.sequence + 1
        assert 0.0 < dt_s < 0.3
        assert math.hypot(b.x_m - a.x_m, b.y_m - a.y_m) <= 1.2 * top * max(dt_s, 0.05)
        assert abs(b.heading_rad - a.heading_rad) < 0.1
        assert b.position_bound_m >= 0.99 * min(a.position_bound_m, unchanged[b.t_ns].position_bound_m)
    assert {p.validity for p in poses[at:]} <= {Validity.VALID, Validity.DEGRADED}
    anew = {
        "calibration off",
        "gyro off",
        "other counts",
        "other tread",
        "other radius",
        "gyro's heading",
        "paper's noise",
    }
    assert (len(notes) > 0) is (name in anew)
    sources = {r.source for r in poses[-1].reasons}
    if name == "gyro off":
        assert sources == set()
    # Nobody but what is there may have a say.
    assert not sources & {"calibration", "model"}
