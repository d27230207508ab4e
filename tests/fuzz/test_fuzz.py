"""Every parser withstands the corpus, and some seconds of a coverage-guided fuzzer (see run.py for longer)."""

import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest
from fuzz.targets import TARGETS

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


@pytest.mark.skipif(find_spec("atheris") is None, reason="atheris is not installed: no wheel for this Python")
def test_the_fuzzer_finds_nothing_in_two_seconds_each(tmp_path: Path) -> None:
    command = [sys.executable, str(HERE / "run.py"), "all", "--seconds", "2"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False)
    left = [f"{file.name}: {file.read_bytes()!r}" for file in tmp_path.iterdir()]
    assert done.returncode == 0, "\n".join([done.stderr[-3000:], *left])
    assert done.stdout.splitlines() == [f"fuzzed {name}: nothing found" for name in TARGETS]
    assert done.stderr.count("stat::number_of_executed_units") == len(TARGETS)
