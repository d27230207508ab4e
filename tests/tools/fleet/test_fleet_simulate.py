"""A fleet whose history is known: the same for the same seed, and as real recordings."""

import json
from pathlib import Path

import pytest

pytest.importorskip("fsspec", reason="needs the extra fleet")

from drd.cli import main
from drd_tools.fleet.discover import discover
from drd_tools.fleet.histories import Happening, draw, maintenance_rows, summaries, table
from drd_tools.fleet.labels import Labels, read_maintenance, read_rules, ruled
from drd_tools.fleet.store import Store
from drd_tools.recordings.folder import read_recording
from drd_tools.trial import fleet as trial


def test_happenings_over_time() -> None:
    step = Happening("robot", "a", "tread", "step", 3.0, 0.02, until=7.0)
    assert [step.at(day) for day in (2.9, 3.0, 6.9, 7.0)] == [0.0, 0.02, 0.02, 0.0]
    creep = Happening("robot", "a", "radius_left", "creep", 2.0, -0.01, until=12.0)
    assert [creep.at(day) for day in (1.0, 7.0, 12.0)] == pytest.approx([0.0, -0.005, 0.0])


def test_a_seed_is_a_history() -> None:
    assert draw(5, 20, 3) == draw(5, 20, 3) != draw(5, 20, 4)
    fleet = draw(5, 20, 3)
    assert table(summaries(fleet, 1)) == table(summaries(fleet, 1))
    assert {d.robot for d in fleet.drives} == set(fleet.batch)


def test_recordings_with_their_labels(tmp_path: Path) -> None:
    folder = tmp_path / "fleet"
    argv = ["fleet", "simulate", "--robots", "2", "--days", "2", "--seconds", "30", "--jobs", "1"]
    assert main([*argv, "--output", str(folder)]) == 0
    truth = json.loads((folder / "truth.json").read_text())
    found, rules = discover([folder / "recordings"]), read_rules(str(folder / "robots.yaml"))
    assert len(found) == len(truth["recordings"]) > 0
    for seen in found:
        [true] = [r for r in truth["recordings"] if r["folder"] == seen.name]
        labels = ruled(rules, seen.name, Labels())
        assert (labels.robot, labels.place, labels.batch) == (true["robot"], true["place"], true["batch"])
        assert labels.start is not None
        assert read_recording(Path(seen.uri)).nominal.name == true["robot"]
    read_maintenance(str(folder / "maintenance.csv"))
    assert main([*argv, "--output", str(folder)]) == 2  # there is one already


def test_summaries_are_a_store(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    argv = ["fleet", "simulate", "--robots", "6", "--days", "30", "--seed", "1", "--summaries", "--output"]
    assert main([*argv, str(tmp_path / "fleet")]) == 0
    fleet, store = draw(6, 30, 1), Store(tmp_path / "fleet" / "store")
    assert len(store.index()) == len(fleet.drives)
    assert len(store.table("constants")) == 6 * len(fleet.drives)
    assert len(store.table("maintenance")) == len(maintenance_rows(fleet))
    assert main(["fleet", "report", str(tmp_path / "fleet" / "store"), "--output", str(tmp_path / "out")]) == 0
    assert (tmp_path / "out" / "fleet.html").exists()
    model = tmp_path / "prior" / "model.yaml"
    assert main(["fleet", "prior", str(tmp_path / "fleet" / "store"), "--robot", "robot1", "--output", str(model)]) == 0
    assert model.exists()
    assert "left tyre" in capsys.readouterr().out


def test_the_blind_trial_counts_what_was_found_and_what_is_not_there() -> None:
    row = trial.judged(1, robots=6, days=30)
    assert [c.name for c in row.changes if c.after is None] == []
    assert all(c.is_own and abs(c.off or 0) <= 1 for c in row.changes)
    [found, rest] = trial.tables([row])
    assert found.rows[0][:3] == ["a radius by 0.5 %", "4", "1.000"]
    assert len(trial.lines([row])) >= len(row.false)
    assert rest.rows[1][1].startswith(f"{len(row.false)}:")
