"""Recordings are found wherever they lie, and known by whose they are, where and when."""

import os
from datetime import UTC, datetime
from pathlib import Path

import pytest
from fleet_stub import recording

from drd.config.schema import ConfigError
from drd_tools.fleet.discover import contents, discover, fetched
from drd_tools.fleet.labels import Labels, Rule, read_maintenance, read_own, read_rules, ruled, start_of_run

RUN = "mybot-20260314T071500Z-1f0c9a55"


def test_folders_and_runs_of_the_daemon_at_any_depth(tmp_path: Path) -> None:
    recording(tmp_path / "a" / "b" / "run")
    recording(tmp_path / "a" / ".hidden")
    (tmp_path / "a" / "encoders.csv").touch()
    (tmp_path / "a" / "notes.txt").touch()
    for name in (f"{RUN}-0001.mcap", f"{RUN}-0002.mcap", f"{RUN}-0002.reference.csv", "other.mcap", "other.fleet.yaml"):
        (tmp_path / name).touch()
    found = {seen.name: seen for seen in discover([tmp_path, tmp_path / "a"])}
    assert sorted(found) == ["a", "a/b/run", RUN, "other"]
    assert found[RUN].uri == str(tmp_path / f"{RUN}.mcap")
    assert found[RUN].files == (f"{RUN}-0001.mcap", f"{RUN}-0002.mcap", f"{RUN}-0002.reference.csv")
    assert found["other"].files == ("other.mcap", "other.fleet.yaml")
    (alone,) = discover([tmp_path / "other.mcap"])
    assert alone == found["other"]
    assert (found[RUN].labels, alone.labels) == ("", "other.fleet.yaml")
    for name in (f"{RUN}-0001", f"{RUN}-0002", RUN):  # the newest part's, but the run's own before it
        (tmp_path / f"{name}.fleet.yaml").touch()
        assert {seen.name: seen for seen in discover([tmp_path])}[RUN].labels == f"{name}.fleet.yaml"


def test_links_to_folders_are_followed_but_a_folder_is_found_once(tmp_path: Path) -> None:
    recording(tmp_path / "elsewhere" / "run")
    fleet = tmp_path / "fleet"
    recording(fleet / "b" / "run")
    (fleet / "a").symlink_to(fleet / "b")  # sorted before what it leads to
    (fleet / "b" / "up").symlink_to(fleet)
    (fleet / "disk").symlink_to(tmp_path / "elsewhere")
    (fleet / "b" / "disk2").symlink_to(tmp_path / "elsewhere" / "run")
    (fleet / "gone").symlink_to(tmp_path / "nowhere")
    (recording(fleet / "c") / "encoders.csv").symlink_to(tmp_path / "nowhere")
    assert [seen.name for seen in discover([fleet])] == ["b/run", "c", "disk/run"]
    assert [seen.name for seen in discover([fleet / "disk"])] == ["run"]


def test_the_signature_changes_with_size_and_time_and_the_hash_with_contents(tmp_path: Path) -> None:
    folder = recording(tmp_path / "run", "1")
    os.utime(folder / "fog.csv", ns=(0, 1))

    def now() -> tuple[str, str]:
        (seen,) = discover([tmp_path])
        with fetched(seen) as place:
            return seen.signature, contents(place, seen)

    first = now()
    assert now() == first
    os.utime(folder / "fog.csv", ns=(0, 2))
    touched = now()
    assert (touched[0] != first[0], touched[1] == first[1]) == (True, True)
    (folder / "fog.csv").write_text("2")
    os.utime(folder / "fog.csv", ns=(0, 2))
    assert now()[1] != first[1]
    (folder / "fleet.yaml").write_text("robot: 7")
    assert now()[0] != touched[0]


def test_rules_go_over_what_a_recording_brings_and_later_ones_over_earlier(tmp_path: Path) -> None:
    file = tmp_path / "robots.yaml"
    file.write_text(
        """
- recordings: ["yard/*", "other*"]
  robot: 7
  place: yard
  batch: null
- recordings: ["*_2026_*"]
  batch: B12
  place: lawn
  start_in_name: '_(?P<year>\\d+)_(?P<month>\\d+)_(?P<day>\\d+)'
"""
    )
    rules, own = read_rules(str(file)), Labels(robot="own", batch="A", start=datetime(2020, 1, 1))
    assert ruled(rules, "hall/run", own).columns() == {
        "robot": "own", "place": None, "batch": "A", "start_utc": datetime(2020, 1, 1, tzinfo=UTC),
    }  # fmt: skip
    assert ruled(rules, "yard/run_2026_3_12", own).columns() == {
        "robot": "7", "place": "lawn", "batch": "B12", "start_utc": datetime(2026, 3, 12, tzinfo=UTC),
    }  # fmt: skip
    assert Labels().columns()["robot"] == "unknown"
    assert ruled([Rule(["*"], start_in_name=r"(?P<year>\d\d)$")], "run26", own).start == datetime(
        2026, 1, 1, tzinfo=UTC
    )


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("- robot: 7", "missing required field `recordings`"),
        ("- {recordings: ['*'], colour: red}", "colour"),
        ("- {recordings: ['*'], start_in_name: '('}", "unterminated"),
        ("{", "a list of rules"),
        ("text", "a list of rules"),
        ("[{recordings: [a], start_in_name: 'a{99999999999}'}]", "a list of rules"),
        ("[" * 2000, "a list of rules"),
    ],
)
def test_rules_that_make_no_sense_are_refused(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "robots.yaml").write_text(text)
    with pytest.raises(ConfigError, match=said):
        read_rules(str(tmp_path / "robots.yaml"))
    with pytest.raises(ConfigError, match="nothing there"):
        read_rules(str(tmp_path / "missing.yaml"))


def test_a_recording_brings_its_labels(tmp_path: Path) -> None:
    file = tmp_path / "fleet.yaml"
    assert read_own(file) == Labels()
    file.write_text("{robot: 7, place: yard, batch: ~, start: 2026-03-12T07:15:00+01:00}")
    assert read_own(file).columns()["start_utc"] == datetime(2026, 3, 12, 6, 15, tzinfo=UTC)
    assert read_own(file).batch is None
    for text in ("{robots: 7}", "{start: soon}", "{start: 0001-01-01T00:00+23:00}", "7", "{"):
        file.write_text(text)
        with pytest.raises(ConfigError, match="robot, place, batch, start"):
            read_own(file)
    assert start_of_run(f"{RUN}-0002.mcap") == datetime(2026, 3, 14, 7, 15, tzinfo=UTC)
    assert start_of_run("run_07") is None


def test_the_log_of_maintenance(tmp_path: Path) -> None:
    file = tmp_path / "log.csv"
    file.write_text('date,robot,what\n2026-06-02,7,"left tyre, changed"\n\n2026-06-03T10:00+02:00,8,gyro\n')
    assert read_maintenance(str(file)) == [
        {"date": datetime(2026, 6, 2, tzinfo=UTC), "robot": "7", "what": "left tyre, changed"},
        {"date": datetime(2026, 6, 3, 8, tzinfo=UTC), "robot": "8", "what": "gyro"},
    ]
    for text, said in (
        ("", "an empty file"),
        ("date,robot\n", "log.csv:1: header"),
        ("date,robot,what\n0001-01-01T00:00+23:00,7,tyre\n", "log.csv:2: date: expected a date"),
        ("date,robot,what\nyesterday,7,tyre\n", "log.csv:2: date: expected a date"),
        ("date,robot,what\n2026-06-02,7\n", "log.csv:2: .*3 columns"),
    ):
        file.write_text(text)
        with pytest.raises(ConfigError, match=said):
            read_maintenance(str(file))
