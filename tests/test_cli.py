import ast
import importlib
import os
import subprocess
import sys
from graphlib import TopologicalSorter
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

import drd
from drd.cli import COMMANDS, main
from drd.config.schema import ConfigError

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "drd"
DEMO = ROOT / "config" / "demo.yaml"


def importing(monkeypatch: pytest.MonkeyPatch, module: Any) -> None:
    """Let every subcommand be `module`; an exception is raised instead."""

    def import_module(_: str) -> Any:
        if isinstance(module, Exception):
            raise module
        return module

    monkeypatch.setattr(importlib, "import_module", import_module)


def command(outcome: int | BaseException, seen: list[list[str]] | None = None) -> SimpleNamespace:
    """A subcommand that ends so; `seen` takes the arguments that it was called with."""

    def run(arguments: list[str]) -> int:
        if seen is not None:
            seen.append(arguments)
        if isinstance(outcome, BaseException):
            raise outcome
        return outcome

    return SimpleNamespace(main=run)


def test_help_lists_every_command_and_what_it_needs(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["--help"])
    assert caught.value.code == 0
    lines = capsys.readouterr().out.splitlines()
    for name, about in COMMANDS.items():
        (line,) = (line for line in lines if line.startswith(f"  {name} "))
        assert about.summary in line
        assert (f"(extra: {about.extra})" in line) == bool(about.extra)


@pytest.mark.parametrize("name", COMMANDS)
def test_each_command_exists_and_explains_itself(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main([name, "--help"])
    assert caught.value.code == 0
    assert capsys.readouterr().out.startswith(f"usage: drd {name}")


def test_without_arguments_the_help_is_printed(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["drd"])
    for arguments in (None, list[str]()):
        assert main(arguments) == 2
        text = capsys.readouterr().err
        assert all(f"\n  {name} " in text for name in COMMANDS)


def test_an_unknown_command_is_told_the_known_ones(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["fly"])
    last = capsys.readouterr().err.splitlines()[-1]
    assert all(name in last for name in ("fly", *COMMANDS))


@pytest.mark.parametrize("arguments", [["fly"], ["--fast", "run"]])
def test_bad_usage_ends_with_2(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(arguments)
    assert caught.value.code == 2
    assert "usage: drd" in capsys.readouterr().err


def test_version_is_the_packages_own(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["--version"])
    assert capsys.readouterr().out == f"drd {drd.__version__}\n"


def test_a_command_gets_its_arguments_and_its_code_comes_back(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[list[str]] = []
    importing(monkeypatch, command(1, seen))
    assert main(["demo", "--seconds", "3", "-h"]) == 1
    assert seen == [["--seconds", "3", "-h"]]


def test_a_missing_package_of_the_workshop_names_its_extra(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    importing(monkeypatch, ModuleNotFoundError("No module named 'matplotlib'", name="matplotlib"))
    assert main(["demo"]) == 2
    error = capsys.readouterr().err
    assert "matplotlib" in error
    assert "pip install 'drd[tools]'" in error


def test_a_missing_package_of_the_daemon_is_an_error_of_the_installation(monkeypatch: pytest.MonkeyPatch) -> None:
    importing(monkeypatch, ModuleNotFoundError("No module named 'zenoh'", name="zenoh"))
    with pytest.raises(ModuleNotFoundError):
        main(["run", str(DEMO)])


def test_a_bad_configuration_ends_with_2_and_names_the_key(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "bad.yaml"
    file.write_text("robot:\n  wheel_radius_m: 99\n")
    for name in ("run", "check"):
        assert main([name, str(file)]) == 2
        assert f"drd {name}: {file}:2: robot.wheel_radius_m: expected a number in m" in capsys.readouterr().err


def test_a_config_error_of_any_command_ends_with_2(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    importing(monkeypatch, command(ConfigError("a.yaml:3", "fog.port", "a path", "'x'")))
    assert main(["emulate"]) == 2
    assert capsys.readouterr().err == "drd emulate: a.yaml:3: fog.port: expected a path, got 'x'\n"


def test_an_interrupt_ends_with_130(monkeypatch: pytest.MonkeyPatch) -> None:
    importing(monkeypatch, command(KeyboardInterrupt()))
    assert main(["watch"]) == 130


def test_a_reader_that_leaves_is_no_error() -> None:
    """As in `drd check FILE | head -1`."""
    program = f"import sys, drd.cli; sys.exit(drd.cli.main(['check', '--explain', {str(DEMO)!r}]))"
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as child:
        assert child.stdout is not None
        assert child.stderr is not None
        child.stdout.close()
        assert child.stderr.read() == b""
    assert child.returncode == 0


def test_check_prints_each_value_with_unit_and_origin(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(DEMO)]) == 0
    lines = capsys.readouterr().out.splitlines()
    rows = {line.split()[0]: line.split()[1:] for line in lines if "." in line.split()[0]}
    assert rows["robot.wheel_radius_m"][:2] == ["0.111", "m"]
    assert rows["robot.wheel_radius_m"][-1].startswith(f"{DEMO}:")
    assert rows["estimation.noise.wheel_scale_per_sqrt_m"] == ["2e-05", "1/sqrt(m)", "default"]
    assert rows["output.commands"][0] == "true"
    assert rows["encoders.dbc.file"][:2] == ["null", "path"]


def test_check_explains_on_request(capsys: pytest.CaptureFixture[str]) -> None:
    main(["check", "--explain", str(DEMO)])
    assert "Rolling radius of the wheels under load" in capsys.readouterr().out


def test_check_looks_at_the_files_that_the_configuration_names(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text("file: absent.yaml".join(DEMO.read_text().rsplit("# file: null", 1)))
    assert main(["check", str(file)]) == 2
    assert str(tmp_path / "absent.yaml") in capsys.readouterr().err


# ---- which module imports which ------------------------------------------------------------------------------------


def module_name(file: Path) -> str:
    return ".".join(file.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


MODULES = {module_name(file): ast.parse(file.read_text()) for file in sorted(PACKAGE.rglob("*.py"))}


def imports_of(tree: ast.AST, top_level_only: bool = False) -> set[str]:
    """Names in import statements; for `from a import b` both a and a.b."""
    found: set[str] = set()
    nodes = tree.body if top_level_only and isinstance(tree, ast.Module) else ast.walk(tree)
    for node in nodes:
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "imports are absolute"
            assert node.module is not None
            found |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return found


@pytest.mark.parametrize("name", MODULES)
def test_the_daemon_never_imports_the_workshop(name: str) -> None:
    foreign = {module.partition(".")[0] for module in imports_of(MODULES[name])} - sys.stdlib_module_names
    assert foreign <= {"drd", "numpy", "serial", "can", "yaml", "msgspec", "zenoh", "cantools", "mcap"}


def test_cantools_is_imported_only_when_it_is_needed() -> None:
    importers = {name for name, tree in MODULES.items() if "cantools" in imports_of(tree, top_level_only=True)}
    assert importers == set()


def test_no_import_of_the_daemon_goes_in_a_circle() -> None:
    graph = {name: imports_of(tree) & MODULES.keys() for name, tree in MODULES.items()}
    assert set(TopologicalSorter(graph).static_order()) == set(MODULES)  # raises CycleError


def test_importing_the_command_line_loads_no_subcommand() -> None:
    program = "import sys, drd.cli; print(*(m for m in ('numpy', 'zenoh', 'can', 'serial') if m in sys.modules))"
    result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == ""


def test_every_command_is_where_the_table_says() -> None:
    for name, about in COMMANDS.items():
        module: ModuleType = importlib.import_module(about.module)
        assert callable(module.main), name
        assert about.module.startswith("drd_tools.") == bool(about.extra)


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ("output: {listen: ['127.0.0.1:7447']}", "output.listen"),
        ("output: {connect: [nonsense]}", "output.connect"),
        ("output: {zenoh_config: missing.json5}", "output.zenoh_config"),
        ("output: {ros2: true, ros2_topic: my odom}", "output.ros2_topic"),
        ("calibration: {file: missing.yaml}", "calibration.file"),
        ("encoders: {layout: cia406, counts_per_revolution: 100, right: {node: 200}}", "encoders.right.node"),
    ],
)
def test_check_finds_what_run_would_refuse_and_says_where(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], change: str, key: str
) -> None:
    file = tmp_path / "robot.yaml"
    layout = "" if "encoders" in change else "encoders: {layout: agilex}\n"
    file.write_text("robot: {wheel_radius_m: 0.1, tread_m: 0.5}\n" + layout + change + "\n")
    assert main(["check", str(file)]) == 2
    line = file.read_text().splitlines().index(change) + 1
    assert f"{file}:{line}: {key}: expected" in capsys.readouterr().err


def test_under_the_journal_messages_carry_their_priority(tmp_path: Path) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text("robot: {wheel_radius_m: -1, tread_m: 0.5}\n")
    texts = []
    extras: tuple[dict[str, str], ...] = ({}, {"JOURNAL_STREAM": "8:1"})
    for extra in extras:
        command = [sys.executable, "-m", "drd", "check", str(file)]
        result = subprocess.run(command, env=os.environ | extra, capture_output=True, text=True, check=False)
        assert result.returncode == 2
        texts.append(result.stderr)
    assert texts[1] == "<3>" + texts[0]
