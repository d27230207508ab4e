"""`drd diagnose` as its users call it: files, sentences and exit codes."""

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest
from diagnosis_runs import SCALE, diagnosed, written
from msgspec import UNSET
from threadpoolctl import threadpool_info, threadpool_limits

from drd.cli import main
from drd.config.schema import ConfigError
from drd.effects.model import load_model
from drd_tools.diagnose import run
from drd_tools.diagnose.analysis import Analysis, analyse
from drd_tools.diagnose.combine.expected import Expected
from drd_tools.diagnose.files import load
from drd_tools.diagnose.results import HeldOut
from drd_tools.diagnose.run import run_all
from drd_tools.recordings.daemon_log import read
from drd_tools.recordings.folder import Recording

STAMP = re.compile(r"\d{4}-\d\d-\d\d \d\d:\d\d UTC")  # when a report was written


def test_nothing_is_said_of_the_nominal_robot(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = diagnosed(written(tmp_path / "run"), tmp_path / "out")
    assert found["verdict"] == "nothing_missing"
    assert load_model(tmp_path / "out/model.yaml").terms == ()
    told = capsys.readouterr().out
    assert "run: nothing is missing" in told
    assert "report.html" in told


def test_an_effect_is_named_with_its_size_and_the_model_helps_another_day(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, other = written(tmp_path / "run", SCALE), written(tmp_path / "day_2", SCALE, seed=9)
    found = diagnosed(folder, tmp_path / "out", "--held-out", str(other))
    assert found["verdict"] == "explained"
    finding = found["findings"][0]
    assert (finding["effect"], finding["status"], finding["acts_on"]) == ("gyro_scale_error", "confirmed", "gyro")
    k = finding["parameters"]["k"]
    assert abs(k["value"] - 0.003) < 4.0 * k["std"] < 0.001
    assert "gyro_scale_error" in capsys.readouterr().out
    for name in ("train", "held_out"):
        before, after = found["fit"][name]["before"], found["fit"][name]["after"]
        if name == "held_out":
            before, after = before["day_2"], after["day_2"]
        assert after["heading_rms_deg"] < 0.8 * before["heading_rms_deg"]


def test_one_thread_computes_whatever_numpy_was_loaded_with(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    threads: list[int] = []

    def seen(recording: Recording, expected: Sequence[Expected]) -> Analysis:
        threads.extend(pool["num_threads"] for pool in threadpool_info())
        return analyse(recording, expected)

    monkeypatch.setattr(run, "analyse", seen)
    with threadpool_limits(limits=2):
        diagnosed(written(tmp_path / "run"), tmp_path / "out")
    assert threads
    assert set(threads) == {1}


def test_several_recordings_have_a_folder_each_the_same_to_the_bit_for_any_jobs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The slow one first: what is said comes in the order given. Only what holds in all is validated on another."""
    runs = [str(written(tmp_path / n, SCALE, drive=("slalom", s))) for n, s in (("b", 60.0), ("a", 25.0))]
    other = str(written(tmp_path / "c", SCALE, seed=9))
    told = []
    for jobs in ("1", "2"):
        out = tmp_path / f"out_{jobs}"
        assert main(["diagnose", *runs, "--held-out", other, "--jobs", jobs, "--output", str(out)]) == 0
        told.append(capsys.readouterr().out.replace(str(out), ""))
    assert told[0] == told[1]
    assert told[0].index("b: ") < told[0].index("\na: ") < told[0].index("b, a: ")
    files = ("diagnosis.json", "series.json", "model.yaml", "report.html")
    for name in (*files, *(f"{folder}/{f}" for folder in "ab" for f in files)):
        one, two = (STAMP.sub("", (tmp_path / out / name).read_text()) for out in ("out_1", "out_2"))
        assert one == two, name
    of_all, of_one = (load(tmp_path / "out_1" / name)[0] for name in ("", "b"))
    assert isinstance(of_all.findings[0].held_out, HeldOut)
    assert of_one.findings[0].held_out is UNSET
    assert ("c" in of_all.fit.held_out.after, "c" in of_one.fit.held_out.after) == (True, False)


def test_one_recording_is_the_same_to_the_bit_for_any_jobs(tmp_path: Path) -> None:
    run, other = (str(written(tmp_path / n, SCALE, seed=s)) for n, s in (("a", 1), ("c", 9)))
    for jobs in ("1", "2"):
        out = str(tmp_path / f"out_{jobs}")
        assert main(["diagnose", run, "--held-out", other, "--jobs", jobs, "--output", out]) == 0
    for name in ("diagnosis.json", "series.json", "model.yaml"):
        assert (tmp_path / "out_1" / name).read_bytes() == (tmp_path / "out_2" / name).read_bytes()


def test_what_is_wrong_with_one_of_several_comes_back_from_its_process(tmp_path: Path) -> None:
    good = read(written(tmp_path / "a", drive=("slalom", 30.0)))
    alone = replace(good, fog=None, reference=None)
    with pytest.raises(ConfigError, match="wheels alone"):
        list(run_all([good, alone], [], tmp_path / "out", 2, "a, b"))


def test_bad_input_is_one_clear_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder, out = written(tmp_path / "run", drive=("slalom", 30.0)), str(tmp_path / "out")

    def told(*arguments: str) -> str:
        assert main(["diagnose", *arguments]) == 2
        captured = capsys.readouterr()
        assert captured.out == ""
        assert captured.err.count("\n") == 1
        assert captured.err.startswith("drd diagnose: ")
        return captured.err

    assert "nowhere" in told(str(tmp_path / "nowhere"), "--output", out)
    assert "nowhere" in told(str(folder), "--held-out", str(tmp_path / "nowhere"), "--output", out)
    assert "more than once" in told(str(folder), str(folder), "--output", out)
    assert "other recordings" in told(str(folder), "--held-out", str(folder), "--output", out)
    (tmp_path / "taken").write_text("")
    assert "taken" in told(str(folder), "--output", str(tmp_path / "taken"))
    (folder / "fog.csv").write_text("time_s,rate_deg_s\n0.1,fast\n")
    assert "fog.csv:2" in told(str(folder), "--output", out)
    (folder / "robot.yaml").unlink()
    assert "robot.yaml" in told(str(folder), "--output", out)


@pytest.mark.parametrize("arguments", [[], ["run"], ["--output", "out"], ["run", "--output", "out", "--jobs", "0"]])
def test_missing_arguments_are_bad_usage(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["diagnose", *arguments])
    assert ended.value.code == 2
    assert "usage: drd diagnose" in capsys.readouterr().err


def test_rows_that_are_left_out_are_told_in_the_report_too(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = written(tmp_path / "run", drive=("slalom", 60.0))
    header, *rows = (folder / "fog.csv").read_text().splitlines()
    cells = [row.split(",", 1) for row in rows]
    lost = [i for i, (time_s, _) in enumerate(cells) if 30.0 < float(time_s) < 34.0]
    repeated = [f"{time_s},{cells[lost[0]][1] if i in lost else rest}" for i, (time_s, rest) in enumerate(cells)]
    (folder / "fog.csv").write_text("\n".join([header, *repeated]) + "\n")
    (note,) = diagnosed(folder, tmp_path / "out")["notes"]
    assert note.startswith("fog.csv repeats one reading from 30.")
    assert note in capsys.readouterr().out
    assert note in (tmp_path / "out" / "report.html").read_text()
