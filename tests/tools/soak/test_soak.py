import contextlib
import json
import math
from pathlib import Path

import pytest
from soak import __main__ as command
from soak.faults import FAULTS
from soak.ledger import Ledger, Row
from soak.monitor import Cost, Monitored
from soak.run import Soak, rounds_for, soak
from soak.text import as_json, failures, table
from soak.world import EPOCH_NS

from drd.config.keys import Config
from drd.config.schema import loads
from drd.estimation import pose_maker
from drd.samples import CanFrame, GyroSample, WheelSample


@pytest.fixture(scope="module")
def once(tmp_path_factory: pytest.TempPathFactory) -> Soak:
    """Every fault once: 76 minutes of simulated time."""
    return soak(tmp_path_factory.mktemp("soak"), len(FAULTS), seed=1)


def test_each_fault_once_is_named_in_time_and_no_valid_pose_is_beyond_its_bound(once: Soak) -> None:
    assert failures(once) == []
    assert len(once.found) >= 21
    named = [f for f in once.found if f.fault.named and not f.fault.unseen]
    assert len(named) >= 20
    for found in named:
        assert found.detected_s[0] <= found.fault.within_s
        assert found.beyond == 0


def test_every_counter_says_what_was_sent(once: Soak) -> None:
    assert once.drifted == []
    expected = {row.name: row.expected for row in once.rows}
    never = [name for name, count in expected.items() if not count and not name.endswith("restarts")]
    assert never in ([], ["encoders.right_jumps"])  # each counter has had something to count
    assert expected["encoders.frames"] > 2 * 20 * 0.95 * once.seconds * 0.9


def test_the_table_has_a_line_for_each_fault_and_the_file_holds_the_same(once: Soak) -> None:
    text, content = table(once), json.loads(as_json(once))
    for found, row in zip(once.found, content["found"], strict=True):
        assert f"\n{found.fault.name} " in text
        assert row["fault"] == found.fault.name
        assert all(s is None or math.isfinite(s) for s in row["detected_s"])
    assert "all was shown" in text
    assert content["failures"] == []


def test_a_pose_that_claims_too_much_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pose_maker, "position_bound_m", lambda _: 0.01)
    result = soak(tmp_path, 1, seed=1)
    assert result.beyond > 0.1 * result.valid
    assert any("beyond their bound" in text for text in failures(result))


def test_a_lost_frame_shows_as_a_counter_that_drifts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    frame, seen = Ledger.frame, []

    def forgetful(self: Ledger, given: CanFrame) -> None:
        seen.append(given)
        if len(seen) != 100:
            frame(self, given)

    monkeypatch.setattr(Ledger, "frame", forgetful)
    result = soak(tmp_path, 1, seed=1)
    assert [row.name for row in result.drifted] == ["encoders.frames"]


def test_what_was_not_shown_is_said() -> None:
    result = Soak(76, rows=[Row("fog.frames", 1, 2)], blocks=[10, 90_000], resident_mib=[50.0, 90.0], early={"fog"})
    text = "\n".join(failures(result))
    for part in (
        "fog.frames says 1, 2 were sent",
        "89990 more blocks",
        "40.0 MiB more",
        "while nothing was wrong: fog",
    ):
        assert part in text


def test_the_monitors_process_gets_every_sample() -> None:
    with contextlib.closing(Monitored(loads("robot: {wheel_radius_m: 0.11, tread_m: 0.6}", Config).value)) as monitored:
        for k in range(1, 700):
            monitored.gyro(GyroSample(EPOCH_NS + k * 50_000_000, 0.05, 0.0, 20.0))
            monitored.wheels(WheelSample(EPOCH_NS + k * 50_000_000, 0.05, 0.05, 0.05, 0.0))
    assert monitored.cost.reports > 5
    assert monitored.cost.judging == monitored.cost.reports
    assert monitored.cost.gaps == 0


def test_a_monitor_that_grows_or_costs_too_much_is_said() -> None:
    cost = Cost([80.0, 80.0, 90.0, 170.0, 160.0, 170.0, 99.0, 98.0], [200.0 * k for k in range(1, 9)], 10, 9, 2)
    text = "\n".join(failures(Soak(38, monitor=cost)))
    for part in ("2 gaps", "162.1 MiB", "17.2 MiB more", "5.6 % of a core"):
        assert part in text


def test_hours_are_whole_rounds() -> None:
    assert rounds_for(0.01) == len(FAULTS)
    assert rounds_for(24.0) % len(FAULTS) == 0
    assert abs(rounds_for(24.0) * 120.0 / 3600.0 - 24.0) < 1.0


def test_the_command_writes_its_table_and_tells_a_failure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    done = Soak(38, seconds=3600.0, took_s=10.0, rows=[Row("fog.frames", 1, 2)])
    monkeypatch.setattr(command, "soak", lambda *_: done)
    assert command.main(["--hours", "1", "--output", str(tmp_path / "out")]) == 1
    assert "NOT SHOWN" in capsys.readouterr().out
    assert (tmp_path / "out" / "soak.txt").read_text() == f"{table(done)}\n"
    with pytest.raises(SystemExit):
        command.main(["--hours", "0", "--output", str(tmp_path)])
