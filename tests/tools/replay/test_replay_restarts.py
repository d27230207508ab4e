"""Runs that began with a warm restart, or were given a new configuration, are repeated to the bit all the same."""

import dataclasses
from pathlib import Path

from recorded_drive import CALIBRATION, Drive, drive, recordings

from drd.config.keys import Config
from drd.config.schema import loads
from drd.pipeline import Pipeline
from drd.recording.in_force import AS_WRITTEN, files_in_force
from drd_tools.replay.mcap_source import replay_mcap
from drd_tools.replay.result import digest


def run(folder: Path, change: tuple[str, str] | None, resume: bool) -> Drive:
    folder.mkdir(exist_ok=True)
    d = drive(folder)
    recorder = d.start()
    if resume:
        kf = d.pipeline.estimator.filter
        kf.nominal.x_m = 1.0 / 3.0
        other = Drive(d.loaded, d.base)
        other.recorder, other.pipeline = recorder, Pipeline(d.loaded.value, d.base, lambda *_: None)
        other.run(6.0)
        estimate = other.pipeline.estimator.estimate()
        assert estimate is not None
        d.pipeline.resume(1, dataclasses.replace(estimate, at_rest=False), True)

    def between(count: int) -> None:
        if count == 200 and change is not None:
            (folder / "calibration.yaml").write_text(CALIBRATION.replace("a0: [0.1,", "a0: [0.2,"))
            loaded = loads((folder / "robot.yaml").read_text().replace(*change), Config, str(folder / "robot.yaml"))
            files = {n: t.decode() for n, t in files_in_force(loaded, folder).items() if n != AS_WRITTEN}
            d.pipeline.reload(d.poses[-1].t_ns, Pipeline(loaded.value, folder, lambda *_: None), files)

    d.run(20.0, between)
    assert recorder.close(5.0)
    return d


def test_a_run_after_a_warm_restart_is_repeated_to_the_bit(tmp_path: Path) -> None:
    d = run(tmp_path, None, True)
    replayed = replay_mcap(recordings(tmp_path)[0])
    assert replayed.digest() == digest(d.poses)
    assert replayed.notes == [f"the {len(d.poses)} poses of the live run are repeated to the bit"]
    assert digest(run(tmp_path / "cold", None, False).poses) != digest(d.poses)


def test_a_run_with_a_reload_is_repeated_to_the_bit(tmp_path: Path) -> None:
    for i, change in enumerate(
        (("tread_m: 0.6", "tread_m: 0.61"), ("20000", "20010"), ("{static", "{gate_sigma: 6, static"))
    ):
        folder = tmp_path / str(i)
        d = run(folder, change, False)
        replayed = replay_mcap(recordings(folder)[0])
        assert replayed.digest() == digest(d.poses)
        assert replayed.counters == d.pipeline.counters()
        assert replayed.notes == [f"the {len(d.poses)} poses of the live run are repeated to the bit"]


def test_with_another_configuration_the_reload_is_left_out_and_told(tmp_path: Path) -> None:
    run(tmp_path, ("tread_m: 0.6", "tread_m: 0.61"), True)
    replayed = replay_mcap(recordings(tmp_path)[0], config=tmp_path / "robot.yaml")
    assert replayed.config.robot.tread_m == 0.6
    assert [note.split(":")[0] for note in replayed.notes] == [
        "the run began with a warm restart",
        "the live run was given a new configuration on the way; here one holds throughout",
    ]
