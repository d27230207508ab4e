"""An update analyses what is new or has changed, and nothing else; what fails or is interrupted stops nothing."""

import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
from fleet_stub import fleet, recording, rows, stubbed

from drd.config.schema import ConfigError
from drd_tools.fleet import update as update_module
from drd_tools.fleet.engine import Engine
from drd_tools.fleet.labels import Rule
from drd_tools.fleet.store import Store
from drd_tools.fleet.task import Rows, Task
from drd_tools.fleet.update import Updated, update


class Here:
    """In place of an engine, in this process; interrupted after so many results."""

    def __init__(self, most: int = 1000):
        self.most, self.done = most, list[str]()

    def results(self, call: Any, tasks: Sequence[Task], _: Any) -> Iterator[tuple[Task, Rows | None]]:
        for task in tasks:
            if len(self.done) == self.most:
                raise KeyboardInterrupt
            self.done.append(task.recording)
            yield task, call(task)


def updated(folder: Path, store: Path, *rules: Rule, engine: Any = None) -> tuple[Updated, list[str]]:
    here: Any = engine or Here()
    return update([folder], Store(store), rules, here, stubbed), here.done


def value(store: Path, name: str) -> float:
    rows = Store(store).table("constants").to_pylist()
    (found,) = {row["value"] for row in rows if row["recording"] == name}
    return float(found)


def test_only_what_is_new_or_changed_is_analysed(tmp_path: Path) -> None:
    runs, store = fleet(tmp_path / "runs", 4), tmp_path / "store"
    assert len(updated(runs, store)[1]) == 4
    assert updated(runs, store) == (Updated(4, 0, 0, 0, []), [])
    recording(runs / "run_001", "100")
    recording(runs / "more" / "run_009", "81")
    made, done = updated(runs, store)
    assert (made.analysed, sorted(done)) == (2, ["more/run_009", "run_001"])
    assert (value(store, "run_001"), value(store, "more/run_009"), value(store, "run_003")) == (10.0, 9.0, 3.0**0.5)


def test_files_that_are_touched_but_not_changed_are_looked_at_once(tmp_path: Path) -> None:
    runs, store = fleet(tmp_path / "runs", 3), tmp_path / "store"
    updated(runs, store)
    os.utime(runs / "run_001" / "fog.csv", (1, 1))
    assert updated(runs, store) == (Updated(3, 0, 1, 0, []), ["run_001"])
    assert updated(runs, store) == (Updated(3, 0, 0, 0, []), [])
    assert value(store, "run_001") == 1.0


def test_another_build_analyses_all_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    runs, store = fleet(tmp_path / "runs", 3), tmp_path / "store"
    updated(runs, store)
    monkeypatch.setattr(update_module, "build", lambda: "another")
    assert len(updated(runs, store)[1]) == 3
    assert updated(runs, store)[1] == []
    assert set(Store(store).table("recordings")["build"].to_pylist()) == {"another"}


def test_other_labels_need_no_analysis(tmp_path: Path) -> None:
    runs, store = fleet(tmp_path / "runs", 3), tmp_path / "store"
    updated(runs, store)
    rule = Rule(["*_001"], robot="7", place="yard", start_in_name=r"(?P<day>1)$", batch="b")
    with pytest.raises(ConfigError, match="groups that make a date"):
        updated(runs, store, rule)
    rule = Rule(["*_001"], robot="7", place="yard")
    assert updated(runs, store, rule) == (Updated(3, 0, 1, 0, []), [])
    for table in ("recordings", "constants", "products"):
        of = Store(store).table(table, ["7"])
        assert set(of["recording"].to_pylist()) == {"run_001"}
        assert set(of["place"].to_pylist()) == {"yard"}
    assert updated(runs, store)[0].relabelled == 1  # without the rule it is again as the recording has it
    assert Store(store).table("recordings", ["7"]).num_rows == 0


def test_a_recording_that_fails_is_listed_and_stops_nothing(tmp_path: Path) -> None:
    runs, store = fleet(tmp_path / "runs", 3), tmp_path / "store"
    recording(runs / "run_001", "fails")
    made, _ = updated(runs, store)
    assert made.failures == [("run_001", "ValueError: no number")]
    assert Store(store).table("errors")["uri"].to_pylist() == [str(runs / "run_001")]
    made, done = updated(runs, store)
    assert (made.failures, done) == ([("run_001", "ValueError: no number")], [])
    recording(runs / "run_001", "49")
    assert updated(runs, store)[0].failures == []
    assert (value(store, "run_001"), Store(store).table("errors").num_rows) == (7.0, 0)


@pytest.mark.parametrize("most", [0, 1, 5])
def test_an_interrupted_update_goes_on_where_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, most: int) -> None:
    monkeypatch.setattr(update_module, "MOST_PENDING", 3)
    runs, store = fleet(tmp_path / "runs", 8), tmp_path / "store"
    with pytest.raises(KeyboardInterrupt):
        updated(runs, store, engine=Here(most))
    assert Store(store).table("recordings").num_rows == most
    made, done = updated(runs, store)
    assert (made.found, made.analysed, len(done)) == (8, 8 - most, 8 - most)
    updated(runs, tmp_path / "whole")
    for file in (tmp_path / "whole").rglob("*.parquet"):
        assert (store / file.relative_to(tmp_path / "whole")).read_bytes() == file.read_bytes()


def test_recordings_of_one_name_are_kept_apart(tmp_path: Path) -> None:
    store = tmp_path / "store"
    one, two = recording(tmp_path / "a" / "run", "1"), recording(tmp_path / "b" / "run", "4")
    assert update([one, two], Store(store), engine=Here(), call=stubbed).analysed == 2  # type: ignore[arg-type]
    names = sorted(Store(store).table("recordings")["recording"].to_pylist())
    assert names[0] == "run"
    assert names[1].startswith("run~")
    assert update([two, one], Store(store), engine=Here(0), call=stubbed).analysed == 0  # type: ignore[arg-type]


def test_a_run_that_goes_on_is_one_recording(tmp_path: Path) -> None:
    def call(task: Task) -> Rows:
        return rows(task.recording, task.seen.uri, float(len(task.seen.files)), signature=task.seen.signature)

    for part in (1, 2):
        (tmp_path / f"bot-20260314T071500Z-1f0c9a55-000{part}.mcap").touch()
        update([tmp_path], Store(tmp_path / "store"), engine=Here(), call=call)  # type: ignore[arg-type]
        table = Store(tmp_path / "store").table("constants").to_pylist()
        assert {row["recording"]: row["value"] for row in table} == {"bot-20260314T071500Z-1f0c9a55": part}


def test_no_recordings_at_all_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="expected recordings"):
        update([tmp_path], Store(tmp_path / "store"), engine=Engine())
    with pytest.raises(ConfigError, match="nothing there"):
        update([tmp_path / "missing"], Store(tmp_path / "store"))
