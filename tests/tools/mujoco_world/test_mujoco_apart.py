"""The second world stands alone, and says what it needs. These tests run without MuJoCo, too."""

import ast
import sys
from pathlib import Path

import pytest

import drd_tools.mujoco_world as package
from drd.cli import main as drd

SOURCES = sorted(Path(package.__file__).parent.glob("*.py"))
# The forms of the recording folder, the errors, the look of pictures; and the sensors with their datasheets, which are
# those of all worlds.
SHARED = {
    "drd.arrays",
    "drd.commands",
    "drd.config.robot",
    "drd.effects.motion",
    "drd.units",
    "drd_tools.recordings.folder",
    "drd_tools.report.style",
    "drd_tools.simulate.conditions",
    "drd_tools.simulate.files",
    "drd_tools.simulate.robot",
    "drd_tools.simulate.sensors",
    "drd_tools.simulate.temperature",
}


def test_its_motion_shares_no_physics_with_the_rest_of_the_project() -> None:
    imported = {
        name
        for file in SOURCES
        for node in ast.walk(ast.parse(file.read_text()))
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("drd")
        for name in (
            [f"{node.module}.{alias.name}" for alias in node.names]
            if node.module == "drd_tools.simulate"
            else [node.module]
        )
    }
    assert {name for name in imported if not name.startswith("drd_tools.mujoco_world")} == SHARED


def test_without_mujoco_it_says_what_to_install(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for file in SOURCES[1:]:  # not __init__
        monkeypatch.delitem(sys.modules, f"{package.__name__}.{file.stem}", raising=False)
        monkeypatch.delattr(package, file.stem, raising=False)
    monkeypatch.setitem(sys.modules, "mujoco", None)
    assert drd(["simulate", "--world", "mujoco", "--output", str(tmp_path / "run")]) == 2
    error = capsys.readouterr().err
    assert "drd[mujoco]" in error
    assert error.count("\n") == 1
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    "argv",
    [["--world", "moon", "--output", "a"], ["--world", "mujoco"], ["--world", "mujoco", "--mission", "moon"],
     ["--world", "mujoco", "--friction", "0", "--output", "a"], ["--world", "mujoco", "--seed", "-1", "--output", "a"],
     ["--world", "mujoco", "--temperature", "cycle", "--output", "a"]],
)  # fmt: skip
def test_bad_usage_is_code_2(argv: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        drd(["simulate", *argv])
    assert caught.value.code == 2
    assert "drd simulate" in capsys.readouterr().err


def test_its_help_is_its_own(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        drd(["simulate", "--world", "mujoco", "--help"])
    assert caught.value.code == 0
    assert "--friction" in capsys.readouterr().out
