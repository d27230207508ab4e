"""Files that earlier versions of drd wrote, in tests/golden/VERSION: today's code reads them. See freeze.py."""

import json
import math
import shutil
from pathlib import Path
from typing import Any

import pytest
from recorded_drive import drive

from drd.config.file import load_config
from drd.effects.model import load_model
from drd.estimation.calibration import load_calibration
from drd.state import memory_file, saved
from drd.state.restart import warm_restart
from drd.state.saved import Moment
from drd.state.sealed import StateError
from drd_tools.diagnose import files as diagnosis
from drd_tools.recordings.mcap_file import open_mcap
from drd_tools.replay.mcap_source import replay_mcap

VERSIONS = sorted(f for f in Path(__file__).parent.iterdir() if (f / "expected.json").exists())
pytestmark = pytest.mark.parametrize("golden", VERSIONS, ids=lambda f: f.name)


def expected(golden: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((golden / "expected.json").read_text())
    return found


def test_the_state_is_gone_on_from(golden: Path, tmp_path: Path) -> None:
    then = saved.decoded((golden / "golden.state").read_bytes())
    assert then.robot == "golden"
    assert then.estimate.nominal.x_m == expected(golden)["x_m"]
    d = drive(tmp_path)
    d.start()
    now = Moment(then.moment.wall_ns, then.moment.boottime_ns + 5_000_000_000, then.moment.boot_id)
    restart = warm_restart(then, now, d.loaded.value, d.pipeline, True)
    assert restart.off_s == 5.0
    d.pipeline.resume(0, restart.estimate, restart.bias_known)
    d.run(2.0)
    assert d.recorder.close(5.0)
    assert d.poses


def test_what_the_monitor_remembers_is_known(golden: Path) -> None:
    memory = memory_file.decoded((golden / "golden.memory").read_bytes())
    assert len(memory.days) == expected(golden)["days"]
    assert memory.days[-1].distance_m == 1e3 + 8 / 3


def test_every_key_of_the_configuration_is_still_taken(golden: Path, tmp_path: Path) -> None:
    """All keys are stated: one that was renamed, moved or narrowed would be refused here."""
    for name in ("robot.yaml", "calibration.yaml"):
        shutil.copy(golden / name, tmp_path)
    config = load_config(tmp_path / "robot.yaml").value
    assert (config.robot.name, config.robot.tread_m, config.calibration.file) == ("golden", 0.6, "calibration.yaml")


def test_the_recording_is_replayed(golden: Path) -> None:
    found = open_mcap(golden / "run.mcap")
    counts = dict.fromkeys(expected(golden)["messages"], 0)
    for message in found.messages():
        if message.topic != "/odom":  # CDR, for ROS 2
            message.value()
        counts[message.topic] += 1
    assert counts == expected(golden)["messages"]
    published = [m.value() for m in found.messages("/drd/pose")]
    replayed = replay_mcap(golden / "run.mcap").poses
    assert len(replayed) == pytest.approx(len(published), abs=2)
    was, now = published[-1], replayed[-1]
    assert math.hypot(now.x_m - was["x_m"], now.y_m - was["y_m"]) < was["position_bound_99_m"]


def test_the_calibration_is_the_same(golden: Path) -> None:
    calibration = load_calibration(golden / "calibration.yaml")
    assert calibration.error_deg_s(30.0, 20.0) == pytest.approx(expected(golden)["gyro_error_deg_s"], rel=1e-12)


def test_the_model_has_each_effect(golden: Path) -> None:
    model = load_model(golden / "model.yaml")
    assert {term.effect.id: len(term.parameters) for term in model.terms} == expected(golden)["effects"]


def test_the_diagnosis_is_read(golden: Path) -> None:
    result, series = diagnosis.load(golden)
    assert [f.effect for f in result.findings] == expected(golden)["findings"] == [f.effect for f in series.findings]


def test_a_file_of_a_later_version_is_refused_in_words(golden: Path) -> None:
    for name, decoded in (("golden.state", saved.decoded), ("golden.memory", memory_file.decoded)):
        head, body = (golden / name).read_bytes().split(b" ", 1)
        later = head.split(b"/")[0] + b"/99 " + body
        with pytest.raises(StateError, match="version 99; this drd reads version"):
            decoded(later)
