"""The daemon's MCAP as a recording: the same samples, robot and answer as the folder of the same drive."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from diagnosis_drives import SLALOM, selected, simulated
from diagnosis_runs import diagnosed, names
from recorded_daemon import daemon_log
from recorded_drive import drive, recordings

from drd.cli import main
from drd.config.schema import ConfigError, Loaded
from drd.estimation.calibration import load_calibration
from drd.pipeline import Pipeline
from drd.recording.file import RecordingFile
from drd.recording.in_force import files_in_force
from drd.recording.topics import Message
from drd.samples import GyroSample
from drd.units import NS_PER_S
from drd_tools.emulate.raw import START_NS, START_WALL_NS
from drd_tools.recordings.daemon_log import read, reference_file
from drd_tools.recordings.mcap_file import open_mcap
from drd_tools.replay.folder_source import replay_folder
from drd_tools.replay.mcap_source import replay_mcap
from drd_tools.replay.nominal import configuration

SHORT = ("slalom", 30.0)
SCALE = selected("gyro_scale_error", k=0.003)


def test_the_folder_and_the_daemons_file_of_a_drive_say_the_same(tmp_path: Path) -> None:
    run = simulated(SHORT, 1)
    made, told = run.recording, read(daemon_log(tmp_path / "run.mcap", run))
    assert (told.name, told.notes) == ("run", ())
    assert told.fog is not None
    assert made.fog is not None
    assert told.fog.temperature_c is not None
    assert told.fog.time_s == pytest.approx(made.fog.time_s, abs=1e-3)  # the daemon estimates its packets' times
    assert told.fog.rate_rad_s == pytest.approx(made.fog.rate_rad_s, abs=5e-5)  # half a count of the packets
    assert told.encoders.time_s == pytest.approx(made.encoders.time_s, abs=1e-9)
    assert made.encoders.left_counts is not None
    assert told.encoders.left_counts is not None
    assert np.array_equal(told.encoders.left_counts, made.encoders.left_counts - made.encoders.left_counts[0])
    for name in ("wheel_radius_m", "counts_per_revolution", "tread_m", "standstill_at_start_s"):
        assert getattr(told.nominal, name) == getattr(made.nominal, name)
    for name in ("gyro_angle_random_walk_deg_per_sqrt_h", "gyro_bias_repeatability_deg_s", "gyro_rate_hz"):
        assert getattr(told.nominal, name) == pytest.approx(getattr(made.nominal, name))
    assert told.reference is not None
    assert sorted(told.sha256) == ["run.mcap", "run.reference.csv"]


def test_samples_are_those_that_the_estimator_had(tmp_path: Path) -> None:
    file = daemon_log(tmp_path / "run.mcap", simulated(SHORT, 2))
    live, again = replay_mcap(file).poses, replay_folder(read(file)).poses
    assert len(again) == pytest.approx(len(live), abs=2)
    a, b = live[-1], again[-1]
    # Live, the wheels' frame may come before the gyro's packet of the same time: the newest step is extrapolated then.
    assert math.hypot(a.x_m - b.x_m, a.y_m - b.y_m) < 0.01
    assert a.heading_rad == pytest.approx(b.heading_rad, abs=1e-2)


@pytest.mark.parametrize("epoch", [False, True])
def test_the_references_times_count_from_the_start_or_from_1970(tmp_path: Path, epoch: bool) -> None:
    file = daemon_log(tmp_path / "run.mcap", simulated(SHORT, 1), reference=False)
    begin = START_WALL_NS / NS_PER_S if epoch else 0.0
    reference_file(file).write_text(f"time_s,x_m,y_m,heading_deg\n{begin + 1.5:.3f},0,0,0\n{begin + 20:.3f},1,0,0\n")
    reference = read(file).reference
    assert reference is not None
    assert reference.time_s == pytest.approx([1.5, 20.0], abs=1e-6)


def test_calibration_and_scales_are_the_nominal_robots(tmp_path: Path) -> None:
    """With a lost port, commands, and a gap in which the wheels' travel is not known."""
    d = drive(tmp_path)
    recorder = d.start()
    d.run(20.0)
    assert recorder.close(5.0)
    (file,) = recordings(tmp_path)
    calibration = load_calibration(tmp_path / "calibration.yaml")
    (tmp_path / "calibration.yaml").unlink()  # all that is needed is in the recording
    told = read(file)
    assert told.fog is not None
    rows = [m.value() for m in open_mcap(file).messages("/fog")]
    raw = [GyroSample(r["monotonic_ns"], r["interval_s"], r["rate_rad_s"], r["temperature_c"]) for r in rows]
    assert told.fog.rate_rad_s.tolist() == [calibration.correct(sample).rate_rad_s for sample in raw]
    assert told.config is not None
    assert told.config.calibration.file is None
    scaled = simulated(SHORT, 1)
    config = configuration(scaled.recording)
    config = replace(config, robot=replace(config.robot, left_scale=1.01))
    plain, other = (
        read(daemon_log(tmp_path / f"{name}.mcap", scaled, config=c)).wheel_angles_rad()
        for name, c in (("plain", None), ("scaled", config))
    )
    # The emulated wheel is of the configured size, so its counts are fewer; the travel stays.
    assert other[0][-1] == pytest.approx(plain[0][-1], rel=1e-3)
    assert other[1][-1] == plain[1][-1]


def test_travel_is_by_the_configuration_at_the_start(tmp_path: Path) -> None:
    """A radius, a scale and a direction that are put right by a reload are no change of the robot's."""

    def turned(folder: Path, reloaded_at: int) -> tuple[list[float], tuple[str, ...]]:
        folder.mkdir()
        d = drive(folder)
        recorder, config = d.start(), d.loaded.value
        other = replace(
            config,
            robot=replace(config.robot, wheel_radius_m=0.121, left_scale=1.02),
            encoders=replace(config.encoders, right=replace(config.encoders.right, reversed=True)),
        )
        files = {name: data.decode() for name, data in files_in_force(Loaded(other, {}), folder).items()}

        def put_in_force(tick: int) -> None:
            if tick == reloaded_at:
                d.pipeline.reload(50_000_000 * (tick - 1), Pipeline(other, folder, lambda *_: None), files)

        d.run(20.0, put_in_force)
        assert recorder.close(5.0)
        told = read(recordings(folder)[0])
        log = told.encoders
        begin, end = np.searchsorted(log.time_s - log.time_s[0], (11.0, 19.0))
        assert log.left_counts is not None
        assert log.right_counts is not None
        return [float(c[end] - c[begin]) for c in (log.left_counts, log.right_counts)], told.notes

    (as_it_is, silent), (changed, notes) = turned(tmp_path / "a", 0), turned(tmp_path / "b", 200)
    assert changed == pytest.approx(as_it_is, abs=0.01)
    assert silent == ()
    (note,) = notes
    assert note.startswith("a new configuration was put in force at ")
    assert note.endswith(" s: robot and travel are those of the first one")


def test_a_turn_over_lost_lines_is_kept(tmp_path: Path) -> None:
    found = open_mcap(daemon_log(tmp_path / "run.mcap", simulated(SHORT, 1), reference=False))
    spanned = tmp_path / "spanned.mcap"
    out = RecordingFile(spanned, found.information, found.attachments, START_WALL_NS)
    turn_rad = 0.0
    for number, m in enumerate(found.messages("/fog")):
        value = m.value()
        turn_rad += value["rate_rad_s"] * value["interval_s"]
        if number % 10 == 1:  # lost; the next angle holds its turn, too
            lost = value
            continue
        if number % 10 == 2:
            value["rate_rad_s"] = 0.5 * (value["rate_rad_s"] + lost["rate_rad_s"])
            value["interval_s"] += lost["interval_s"]
        out.add(Message(m.topic, m.log_ns, json.dumps(value).encode()), m.number, m.log_ns, m.log_ns)
    out.finish({})
    fog = read(spanned).fog
    assert fog is not None
    step_s = np.diff(fog.time_s)
    assert step_s.max() < 1.2 * np.median(step_s)
    assert float(fog.rate_rad_s[1:] @ step_s) == pytest.approx(turn_rad, abs=2e-3)


def test_what_was_not_seen_of_the_wheels_is_marked(tmp_path: Path) -> None:
    file = daemon_log(tmp_path / "run.mcap", simulated(SHORT, 1), reference=False)
    found = open_mcap(file)
    cut = tmp_path / "cut.mcap"
    out = RecordingFile(cut, found.information, found.attachments, START_WALL_NS)
    for m in found.messages("/wheels"):
        value = m.value()
        if 15.0 < (value["monotonic_ns"] - START_NS) / NS_PER_S < 17.0:
            continue
        if 17.0 <= (value["monotonic_ns"] - START_NS) / NS_PER_S < 17.04:
            value["lost_s"] = 2.0
        out.add(Message(m.topic, m.log_ns, json.dumps(value).encode()), m.number, m.log_ns, m.log_ns)
    out.finish({})
    log = read(cut).encoders
    assert log.is_lost is not None
    assert log.time_s[log.is_lost] == pytest.approx([16.95], abs=0.06)
    assert read(cut).fog is None
    assert read(file).encoders.is_lost is not None
    assert not np.any(read(file).encoders.is_lost)


def test_a_file_that_was_cut_reads_to_its_last_chunk(tmp_path: Path) -> None:
    file = daemon_log(tmp_path / "run.mcap", simulated(SLALOM, 1))
    whole = read(file)
    file.write_bytes(file.read_bytes()[: file.stat().st_size * 2 // 3])
    told = read(file)
    assert 40.0 < told.encoders.time_s[-1] < 100.0
    assert "cut" in told.notes[0]
    count = len(told.encoders.time_s)
    assert told.encoders.time_s.tolist() == whole.encoders.time_s[:count].tolist()


def test_an_effect_is_found_in_the_daemons_file_and_held_out_in_another(tmp_path: Path) -> None:
    file, other = (daemon_log(tmp_path / f"{n}.mcap", simulated(SLALOM, n, SCALE)) for n in (1, 2))
    found = diagnosed(file, tmp_path / "out", "--held-out", str(other))
    assert names(found) == ["gyro_scale_error"]
    held = found["fit"]["held_out"]
    assert held["after"]["2"]["heading_rms_deg"] < 0.8 * held["before"]["2"]["heading_rms_deg"]
    assert main(["replay", str(other), "--model", str(tmp_path / "out/model.yaml")]) == 0


def test_without_a_reference_nothing_is_made_up(tmp_path: Path) -> None:
    file = daemon_log(tmp_path / "run.mcap", simulated(SLALOM, 1), reference=False)
    assert names(diagnosed(file, tmp_path / "out")) == []
    assert main(["compare", str(file), "--output", str(tmp_path / "compared")]) == 0


def test_other_files_are_one_clear_error(tmp_path: Path) -> None:
    file = tmp_path / "run.mcap"
    with pytest.raises(ConfigError, match="No such file"):
        read(file)
    file.write_bytes(b"")
    with pytest.raises(ConfigError, match="configuration-in-force"):
        read(file)
    RecordingFile(tmp_path / "bare.mcap", {}, {}, START_WALL_NS).finish({})
    with pytest.raises(ConfigError, match="configuration-in-force"):
        read(tmp_path / "bare.mcap")
    daemon_log(file, simulated(SHORT, 1))
    reference_file(file).write_text("time_s,x_m\n")
    with pytest.raises(ConfigError, match=r"run\.reference\.csv:1: header"):
        read(file)


@pytest.mark.parametrize(
    "payload",
    [
        b'{"monotonic_ns": 1, "left_m": "far"}',
        # Found by the fuzzer.
        b'{"monotonic_ns": Infinity, "interval_s": 1, "left_m": 0, "right_m": 0, "lost_s": 0}',
        b'{"monotonic_ns": 1, "interval_s": 1, "left_m": ' + b"9" * 400 + b', "right_m": 0, "lost_s": 0}',
        b"[" * 2000,
    ],
)
def test_a_sample_that_drd_did_not_write_is_refused(tmp_path: Path, payload: bytes) -> None:
    found = open_mcap(daemon_log(tmp_path / "good.mcap", simulated(SHORT, 1), reference=False))
    out = RecordingFile(tmp_path / "odd.mcap", found.information, found.attachments, START_WALL_NS)
    out.add(Message("/wheels", START_WALL_NS, payload), 1, START_WALL_NS, START_WALL_NS)
    out.finish({})
    with pytest.raises(ConfigError, match="what drd writes there"):
        read(tmp_path / "odd.mcap")
