"""What is kept of a recording, from the command to the tables: a simulated drive with known constants."""

import csv
import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnosis_drives import selected, simulated
from diagnosis_runs import written
from recorded_daemon import daemon_log, in_parts

from drd.cli import main
from drd.effects.catalogue import catalogue
from drd.units import S_PER_NS
from drd_tools.diagnose.observe import parts as parts_module
from drd_tools.emulate.raw import START_WALL_NS
from drd_tools.fleet.analysis import analysed
from drd_tools.fleet.discover import discover
from drd_tools.fleet.labels import Rule
from drd_tools.fleet.store import Store
from drd_tools.fleet.task import Task
from drd_tools.fleet.update import update

LEFT, TREAD = -0.006, 0.01


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder: Path = tmp_path_factory.mktemp("fleet")
    planted = selected("wheel_radius_error", left=LEFT, right=0.0), selected("tread_error", k=TREAD)
    written(folder / "runs" / "yard" / "run_1", *planted, drive=("square-cw", 120.0))
    (folder / "runs" / "yard" / "run_1" / "fleet.yaml").write_text("{robot: 7, batch: B, start: 2026-03-12}")
    (folder / "runs" / "broken").mkdir()
    (folder / "runs" / "broken" / "fog.csv").write_text("no header")
    (folder / "runs" / "broken" / "fleet.yaml").write_text("robot: 8")
    (folder / "robots.yaml").write_text("[{recordings: ['yard/*'], place: yard}]")
    (folder / "log.csv").write_text("date,robot,what\n2026-03-01,7,left tyre changed\n")
    assert _update(folder) == 0
    return folder / "store"


def _update(folder: Path) -> int:
    files = ["--robots", str(folder / "robots.yaml"), "--maintenance", str(folder / "log.csv")]
    return main(["fleet", "update", str(folder / "runs"), "--store", str(folder / "store"), "--jobs", "1", *files])


def test_the_constants_are_there_whatever_was_found(store: Path) -> None:
    table = Store(store).table("constants").to_pylist()
    assert {(row["recording"], row["robot"], row["place"], row["batch"]) for row in table} == {
        ("yard/run_1", "7", "yard", "B")
    }
    found = {row["name"]: (row["value"], row["sigma"]) for row in table}
    true = {"radius_left": LEFT, "radius_right": 0.0, "tread": TREAD, "lag_s": 0.0, "gyro_scale": 0.0}
    for name, value in true.items():
        assert found[name][0] == pytest.approx(value, abs=4.0 * found[name][1]), name
    assert found["radius_left"][1] < 0.002
    assert found["tread"][1] < 0.01


def test_score_and_information_give_the_sizes_again(store: Path) -> None:
    """One question of a population, with one recording: the nominal model and radii, beside the nuisances."""
    rows = Store(store).table("products").to_pylist()
    information = np.array([row["information"] for row in rows])
    assert information.shape == (len(rows), len(rows))
    assert np.array_equal(information, information.T)
    assert {row["kind"] for row in rows} == {"effect", "nuisance"}
    wanted = [
        i for i, r in enumerate(rows) if r["kind"] == "nuisance" or r["effect"] in ("wheel_radius_error", "tread_error")
    ]
    G = information[np.ix_(wanted, wanted)]
    G = G + np.diag([float(rows[i]["kind"] == "nuisance") for i in wanted])
    x = np.linalg.solve(G, np.array([rows[i]["score"] for i in wanted]))
    sigma = np.sqrt(np.diag(np.linalg.inv(G)))
    sizes = {(rows[i]["effect"], rows[i]["parameter"]): (x[j], sigma[j]) for j, i in enumerate(wanted)}
    for key, value in ((("wheel_radius_error", "left"), LEFT), (("tread_error", "k"), TREAD)):
        assert sizes[key][0] == pytest.approx(value, abs=4.0 * sizes[key][1])
    effects = {row["effect"] for row in rows if row["kind"] == "effect"}
    assert effects <= set(catalogue())
    assert len(effects) > 12
    assert 0.5 < (rows[0]["square"] - x @ [rows[i]["score"] for i in wanted]) / rows[0]["rows"] < 2.0


def test_findings_and_figures_of_the_pose(store: Path) -> None:
    findings = Store(store).table("findings").to_pylist()
    radius = [row for row in findings if row["effect"] == "wheel_radius_error" and row["parameter"] == "left"]
    assert len(radius) == 1
    assert radius[0]["value"] == pytest.approx(LEFT, abs=4.0 * radius[0]["sigma"])
    names = [row["parameter"] for row in findings if row["number"] == radius[0]["number"]]
    assert radius[0]["covariance"][names.index("left")] == pytest.approx(radius[0]["sigma"] ** 2)
    figures = {(r["model"], r["figure"]): r["value"] for r in Store(store).table("pose").to_pylist()}
    assert figures["found", "position_rms_m"] < figures["nominal", "position_rms_m"]


def test_what_fails_is_listed(store: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (row,) = Store(store).table("errors").to_pylist()
    assert (row["recording"], row["robot"]) == ("broken", "8")
    assert "robot.yaml: expected this file in the folder" in row["error"]
    assert _update(store.parent) == 0
    text = capsys.readouterr().out
    assert "2 recordings: 0 analysed, 2 as they were" in text
    assert "1 failed:\n    broken: ConfigError: " in text


def query(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    assert main(["fleet", "query", *arguments]) == 0
    return capsys.readouterr().out


def test_a_query_prints_tables(store: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = query(capsys, str(store)).split("\n")
    assert ["errors", "1"] in map(str.split, lines)
    assert ["maintenance", "1"] in map(str.split, lines)
    assert "left tyre changed" in query(capsys, str(store), "maintenance", "--robot", "7")
    text = query(capsys, str(store), "findings", "--effect", "wheel_radius_error", "--csv")
    assert {row["effect"] for row in csv.DictReader(io.StringIO(text))} == {"wheel_radius_error"}
    assert len(query(capsys, str(store), "findings", "--robot", "none", "--csv").splitlines()) == 1
    row: dict[str, Any] = json.loads(query(capsys, str(store), "recordings", "--robot", "7", "--json"))
    assert (row["recording"], row["start_utc"][:10]) == ("yard/run_1", "2026-03-12")
    sql = "select c.name from constants c join maintenance m using (robot) where c.name = 'tread'"
    assert query(capsys, str(store), "--sql", sql, "--csv").split() == ['"name"', '"tread"']


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["missing"], "a store of `drd fleet update`"),
        (["{store}", "--sql", "select nothing"], "a query that returns a table"),
        (["{store}", "pose", "--effect", "x"], "pose has no column effect"),
        (["{store}", "pose", "--sql", "select 1"], "names its tables"),
    ],
)
def test_a_query_that_makes_no_sense_is_refused(
    store: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], said: str
) -> None:
    try:
        code = main(["fleet", "query", *(a.format(store=store) for a in arguments)])
    except SystemExit as left:
        code = int(str(left.code))
    assert code == 2
    assert said in capsys.readouterr().err


def test_the_own_files_are_all_a_part_of_the_recording(store: Path) -> None:
    found = {seen.name: seen.files for seen in discover([store.parent / "runs"])}
    assert found["yard/run_1"] == ("encoders.csv", "fleet.yaml", "fog.csv", "reference.csv", "robot.yaml")


def test_the_parts_of_a_run_are_one_recording(tmp_path: Path) -> None:
    run = simulated(("square-cw", 60.0), 1)
    daemon_log(tmp_path / "whole" / "run.mcap", run)
    parts = in_parts(daemon_log(tmp_path / "parts" / "x.mcap", run), "mybot-20260314T071500Z-1f0c9a55", 3)
    (tmp_path / "parts" / "fleet.yaml").touch()  # it is of folders
    parts[1].with_suffix(".fleet.yaml").write_text("{place: yard}")  # and the run has gone on since
    argv = ["--store", str(tmp_path / "store"), "--jobs", "1"]
    assert main(["fleet", "update", str(tmp_path / "whole"), str(tmp_path / "parts"), *argv]) == 0
    store = Store(tmp_path / "store")
    about = {row["recording"]: row for row in store.table("recordings").to_pylist()}
    name = parts[-1].stem.removesuffix("-0003")
    assert sorted(about) == [name, "run"]
    told = about[name]
    assert (told["error"], told["place"], str(told["start_utc"])) == (None, "yard", "2026-03-14 07:15:00+00:00")
    assert about["run"]["start_utc"].timestamp() == START_WALL_NS * S_PER_NS  # whatever the file is called
    assert (told["duration_s"], told["verdict"]) == (about["run"]["duration_s"], about["run"]["verdict"])
    constants = store.table("constants").to_pylist()
    values = {one: {r["name"]: r["value"] for r in constants if r["recording"] == one} for one in about}
    assert values["run"] == values[name] != {}


class Here:
    """In place of an engine, in this process."""

    def results(self, call: Any, tasks: list[Task], _: Any) -> Any:
        return [(task, call(task)) for task in tasks]


def test_each_part_of_a_long_recording_has_a_start_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parts_module, "MOST_STEPS", 250)
    folder, store = written(tmp_path / "runs" / "day_20260501", drive=("square-cw", 60.0)), tmp_path / "store"
    (folder / "fleet.yaml").write_text("{robot: 7, start: 2026-03-12T07:00:00Z}")
    here: Any = Here()

    def starts(*rules: Rule) -> list[str]:
        update([tmp_path / "runs"], Store(store), rules, here, analysed)
        of = {name: Store(store).table(name).to_pylist() for name in ("recordings", "constants")}
        start_of = {name: {(r["recording"], r["start_utc"]) for r in rows} for name, rows in of.items()}
        assert start_of["constants"] == start_of["recordings"]
        return [f"{start:%m-%d %H:%M:%S}" for _, start in sorted(start_of["recordings"])]

    assert starts() == ["03-12 07:00:00", "03-12 07:00:20", "03-12 07:00:40"]
    named = Rule(["*"], start_in_name=r"_(?P<year>\d{4})(?P<month>\d\d)(?P<day>\d\d)")
    assert starts(named) == ["05-01 00:00:00", "05-01 00:00:20", "05-01 00:00:40"]
    assert update([tmp_path / "runs"], Store(store), [named], here, analysed).relabelled == 0
