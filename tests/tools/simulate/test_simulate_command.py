"""`drd simulate` as it is used."""

from pathlib import Path

import pytest

from drd.cli import main as drd
from drd_tools.recordings.folder import read_recording

MODEL = """\
effects:
  - effect: gyro_scale_error
    parameters: {k: 0.01}
"""


def test_it_writes_a_folder_and_draws_it_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model, run = tmp_path / "model.yaml", tmp_path / "run"
    model.write_text(MODEL)
    argv = ["--mission", "slalom", "--seconds", "60", "--seed", "2", "--model", str(model), "--ground", "asphalt"]
    assert drd(["simulate", *argv, "--stressed", "--reference", "sparse:5", "--output", str(run)]) == 0
    text = capsys.readouterr().out
    assert "Mission slalom" in text
    assert "cut before the first lap ended" in text
    assert "gyro_scale_error" in text
    recording = read_recording(run)
    assert recording.reference is not None
    assert len(recording.reference.time_s) == 13
    for name in ("simulated.png", "effects.png"):
        assert (run / name).read_bytes()[:4] == b"\x89PNG"
        (run / name).unlink()
    page = (run / "report.html").read_text()
    assert "gyro_scale_error" in page
    assert drd(["simulate", "--draw", str(run)]) == 0
    assert (run / "effects.png").exists()


def test_it_writes_a_recording_of_the_daemon(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "run.mcap"
    assert drd(["simulate", "--mission", "spins", "--seconds", "15", "--noise", "0", "--output", str(file)]) == 0
    assert file.stat().st_size > 10_000
    assert "poses" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("argv", "said"),
    [
        (["--mission", "moon"], "one of square-cw"),
        (["--temperature", "hot"], "--temperature"),
        (["--reference", "sparse:x"], "sparse:SECONDS"),
        (["--model", "nowhere.yaml"], "nowhere.yaml"),
        (["--robot", "nowhere.yaml"], "nowhere.yaml"),
    ],
)
def test_bad_input_is_one_line_and_code_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], argv: list[str], said: str
) -> None:
    assert drd(["simulate", *argv, "--output", str(tmp_path / "run")]) == 2
    error = capsys.readouterr().err
    assert error.startswith("drd simulate: ")
    assert said in error
    assert error.count("\n") == 1
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    "argv",
    [[], ["--output", "a", "--live", "b"], ["--seconds", "0", "--output", "a"], ["--noise", "1,2", "--output", "a"],
     ["--seed", "-1", "--output", "a"], ["--reference-lever", "1", "--output", "a"]],
)  # fmt: skip
def test_bad_usage_is_code_2(argv: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        drd(["simulate", *argv])
    assert caught.value.code == 2
    assert "drd simulate" in capsys.readouterr().err


def test_drawing_what_is_no_simulation_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert drd(["simulate", "--draw", str(tmp_path)]) == 2
    assert "drd simulate wrote" in capsys.readouterr().err
