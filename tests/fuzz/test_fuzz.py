"""Every parser withstands the corpus, and some seconds of a coverage-guided fuzzer (see run.py for longer)."""

import json
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest
from fuzz.campaign import NO_FIGURES, collecting
from fuzz.targets import TARGETS

from drd.state.saved import decoded

HERE = Path(__file__).resolve().parent


@pytest.mark.parametrize(
    "file", sorted((HERE / "corpus").glob("*/*")), ids=lambda file: f"{file.parent.name}/{file.name}"
)
def test_the_parser_withstands_what_the_corpus_keeps(file: Path) -> None:
    TARGETS[file.parent.name](file.read_bytes())


def test_each_target_has_seeds_and_the_corpus_is_small() -> None:
    files = [file for file in (HERE / "corpus").glob("*/*") if file.is_file()]
    assert {file.parent.name for file in files} == TARGETS.keys()
    assert sum(file.stat().st_size for file in files) < 40_000


def test_the_seed_of_the_state_is_of_the_version_that_is_read() -> None:
    assert decoded((HERE / "corpus" / "state" / "whole").read_bytes()).robot == "fuzz"


def test_a_campaign_goes_on_after_a_finding_and_keeps_the_first_input_of_each_place(tmp_path: Path) -> None:
    def target(data: bytes) -> None:
        if data:
            raise ValueError(data)

    collect = collecting(target, tmp_path)
    for data in (b"", b"first", b"second"):
        collect(data)
    (found,) = [file for file in tmp_path.iterdir() if file.suffix != ".txt"]
    assert found.read_bytes() == b"first"
    assert "ValueError: b'first'" in found.with_suffix(".txt").read_text()


@pytest.mark.skipif(find_spec("atheris") is None, reason="atheris is not installed: no wheel for this Python")
def test_executions_of_campaigns_add_up_and_the_corpus_stays(tmp_path: Path) -> None:
    before = {"pose_request": NO_FIGURES | {"executions": 10**9, "turns": 1}}
    (tmp_path / "figures.json").write_text(json.dumps(before))
    command = [sys.executable, str(HERE / "run.py"), "--all", "--hours", "0.0003", "--workers", "1"]
    command += ["--output", str(tmp_path), "pose_request"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=800, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    figures = json.loads((tmp_path / "figures.json").read_text())["pose_request"]
    assert figures["executions"] > 10**9
    assert figures["edges"] > 0
    assert figures["turns"] == 2
    assert f"{figures['executions']:,}" in done.stdout
    assert list((tmp_path / "pose_request" / "corpus").iterdir())


@pytest.mark.skipif(find_spec("atheris") is None, reason="atheris is not installed: no wheel for this Python")
def test_the_fuzzer_finds_nothing_in_two_seconds_each(tmp_path: Path) -> None:
    command = [sys.executable, str(HERE / "run.py"), "all", "--seconds", "2"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=800, check=False)
    left = [f"{file.name}: {file.read_bytes()!r}" for file in tmp_path.iterdir()]
    assert done.returncode == 0, "\n".join([done.stderr[-3000:], *left])
    assert done.stdout.splitlines() == [f"fuzzed {name}: nothing found" for name in TARGETS]
    assert done.stderr.count("stat::number_of_executed_units") == len(TARGETS)
