"""What is written is what was simulated: the folder, the daemon's recording, and the live hardware."""

import os
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from drd.config.file import load_config
from drd.config.keys import Config
from drd.config.schema import ConfigError, Loaded
from drd.effects.catalogue import catalogue
from drd.effects.model import make_model
from drd.fog.stream import FogStream
from drd_tools.emulate.raw import drive_live, write_mcap
from drd_tools.recordings.folder import Recording, read_recording
from drd_tools.replay.folder_source import replay_folder
from drd_tools.replay.mcap_source import replay_mcap
from drd_tools.replay.nominal import configuration
from drd_tools.simulate.conditions import Conditions, Reference
from drd_tools.simulate.files import CHANGES, read_true_motion, read_truth, write_folder
from drd_tools.simulate.missions import make_drive
from drd_tools.simulate.robot import DEFAULT
from drd_tools.simulate.sensors import Effects
from drd_tools.simulate.simulator import Simulated, simulate
from drd_tools.simulate.truth import make_truth

ABOUT = {"mission": "eights", "temperature": "warmup"}
EFFECTS: Effects = (
    (catalogue()["gyro_scale_error"], {"k": 0.004}),
    (catalogue()["wheel_eccentricity"], {"side": "right", "e": 0.01, "phase": 1.0}),
)


def simulated(conditions: Conditions | None = None) -> Simulated:
    return simulate(make_truth(make_drive("eights", 40.0)), DEFAULT, EFFECTS, conditions, seed=3)


def assert_equal(a: Recording, b: Recording) -> None:
    assert a.nominal == b.nominal
    for log in ("encoders", "fog", "reference"):
        one, other = getattr(a, log), getattr(b, log)
        assert (one is None) == (other is None)
        for name in [f for f in one.__dataclass_fields__ if getattr(one, f) is not None] if one is not None else ():
            # Degrees in files, radians in memory: one rounding apart.
            np.testing.assert_allclose(getattr(one, name), getattr(other, name), rtol=0, atol=1e-14 * 400)


@pytest.mark.parametrize("counts", [20000.0, None])
def test_the_folder_reads_as_the_recording_in_memory(tmp_path: Path, counts: float | None) -> None:
    robot = replace(DEFAULT, counts_per_revolution=counts)
    made = simulate(make_truth(make_drive("eights", 40.0)), robot, EFFECTS, seed=3)
    write_folder(made, tmp_path / "run", ABOUT)
    read = read_recording(tmp_path / "run")
    if counts is None:
        made = replace(made, recording=replace(made.recording, wheels=read.encoders))
    assert_equal(read, made.recording)
    assert replay_folder(read).digest() == replay_folder(read_recording(tmp_path / "run")).digest()


def test_the_same_arguments_give_the_same_bytes(tmp_path: Path) -> None:
    for name in ("a", "b"):
        write_folder(simulated(), tmp_path / name, ABOUT, simulated())
    for file in (tmp_path / "a").iterdir():
        assert file.read_bytes() == (tmp_path / "b" / file.name).read_bytes(), file.name


def test_the_truth_beside_it_says_what_is_true(tmp_path: Path) -> None:
    made = simulated()
    plain = simulate(make_truth(make_drive("eights", 40.0)), DEFAULT, seed=3)
    write_folder(made, tmp_path, ABOUT, plain)
    about, columns = read_truth(tmp_path), read_true_motion(tmp_path)
    # The effects are in a model file's form.
    terms = make_model(about["effects"]).terms
    assert [term.effect for term in terms] == [effect for effect, _ in EFFECTS]
    for term, (_, values) in zip(terms, EFFECTS, strict=True):
        assert term.values() == pytest.approx(values)
    np.testing.assert_allclose(columns["x_m"], made.truth.x_m[::10], atol=1e-6)
    turning = np.abs(columns["rate_deg_s"]) > 5.0
    np.testing.assert_allclose(columns[CHANGES[0]][turning], 0.004 * columns["rate_deg_s"][turning], atol=0.004 + 0.02)
    assert not columns["left_change_m"].any()
    assert 0.0011 < np.abs(columns["right_change_m"]).max() < 0.0022  # once and twice the radius times e


def test_files_of_an_earlier_simulation_go(tmp_path: Path) -> None:
    write_folder(simulated(), tmp_path, ABOUT)
    write_folder(simulated(conditions=Conditions(reference=Reference(is_there=False))), tmp_path, ABOUT)
    assert read_recording(tmp_path).reference is None


def test_another_recording_is_not_written_over(tmp_path: Path) -> None:
    (tmp_path / "robot.yaml").write_text("tread_m: 1\n")
    with pytest.raises(ConfigError, match="another recording"):
        write_folder(simulated(), tmp_path, ABOUT)
    assert (tmp_path / "robot.yaml").read_text() == "tread_m: 1\n"


def test_truth_csv_of_somebody_else_is_refused(tmp_path: Path) -> None:
    (tmp_path / "truth.csv").write_text("a,b\n1,2\n")
    (tmp_path / "truth.yaml").write_text("[]\n")
    with pytest.raises(ConfigError, match=r"truth\.csv:1: header: expected time_s,x_m"):
        read_true_motion(tmp_path)
    with pytest.raises(ConfigError, match="drd simulate wrote"):
        read_truth(tmp_path)


def test_the_daemons_recording_replays_to_the_bit_and_is_the_same_each_time(tmp_path: Path) -> None:
    recording = simulated().recording
    config = Loaded(configuration(recording), {})
    for name in ("a.mcap", "b.mcap"):
        poses = write_mcap(tmp_path / name, recording, config, Path())
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()
    replayed = replay_mcap(tmp_path / "a.mcap")
    assert poses == len(replayed.poses) > 700
    assert any("repeated to the bit" in note for note in replayed.notes)
    # It is the folder's run: the gyro's packets have other roundings, and its times are estimated.
    folder = replay_folder(recording)
    a, b = replayed.poses[-1], folder.poses[-1]
    assert np.hypot(a.x_m - b.x_m, a.y_m - b.y_m) < 0.05
    assert a.heading_rad == pytest.approx(b.heading_rad, abs=0.01)


def test_without_counts_there_are_no_frames(tmp_path: Path) -> None:
    robot = replace(DEFAULT, counts_per_revolution=None)
    recording = simulate(make_truth(make_drive("eights", 20.0)), robot).recording
    with pytest.raises(ConfigError, match="counts_per_revolution"):
        write_mcap(tmp_path / "a.mcap", recording, Loaded(configuration(simulated().recording), {}), Path())
    assert not (tmp_path / "a.mcap").exists()


LIVE = """\
robot: {{wheel_radius_m: 0.11, tread_m: 0.52}}
fog: {{protocol: ecore, port: {folder}/fog, positive: counterclockwise}}
encoders: {{layout: cia406, interface: slcan, channel: {folder}/can, counts_per_revolution: 20000}}
"""


def test_live_it_is_the_hardware(tmp_path: Path) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text(LIVE.format(folder=tmp_path))
    config: Config = load_config(file).value
    recording = simulate(make_truth(make_drive("spins", 2.0, stand_s=0.0)), DEFAULT, seed=1).recording
    heard, sentences = bytearray(), []
    ready = threading.Event()

    def listen() -> None:
        ready.wait(5.0)
        line = os.open(tmp_path / "fog", os.O_RDONLY | os.O_NOCTTY)
        try:
            while piece := os.read(line, 4096):
                heard.extend(piece)
        except OSError:  # unplugged
            pass
        finally:
            os.close(line)

    thread = threading.Thread(target=listen)
    thread.start()
    for sentence in drive_live(recording, config, tmp_path):
        sentences.append(sentence)
        ready.set()
    thread.join(5.0)
    samples = FogStream(config.fog, 1e3).feed(bytes(heard), 10**12)
    assert recording.fog is not None
    got, sent = np.array([s.rate_rad_s for s in samples]), recording.fog.rate_rad_s
    assert len(got) >= 15
    count = np.radians(100.0) / 32768.0
    assert np.abs(got - sent[-len(got) :]).max() <= count  # the packets' resolution
    assert "lost" in sentences[-1]
    assert not (tmp_path / "fog").is_symlink()


def test_robot_yaml_says_nothing_that_is_not_known(tmp_path: Path) -> None:
    robot = replace(DEFAULT, name="with: colon", reference_heading_sigma_deg=None)
    write_folder(simulate(make_truth(make_drive("eights", 20.0)), robot), tmp_path, ABOUT)
    assert read_recording(tmp_path).nominal == robot
    assert "heading_sigma_deg" not in yaml.safe_load((tmp_path / "robot.yaml").read_text())["reference"]
