"""The stages of the diagnosis: a later one imports earlier ones, never the other way."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

import drd_tools.diagnose

ROOT = Path(drd_tools.diagnose.__path__[0])
STAGES = ("observe", "error_model", "regression", "select", "conclude", "combine", "validate", "advise", "report")
WORDS = ("results", "series", "selected", "files")  # what all stages speak of
MOST_PARAMETERS = 9


def stage_of(module: str) -> str:
    """The first part of a module's name below drd_tools.diagnose; "" for the package itself."""
    return module.removeprefix("drd_tools.diagnose").removeprefix(".").partition(".")[0]


def imported(file: Path) -> Iterator[str]:
    """The modules of the diagnosis that a file imports, wherever in it."""
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module is not None:
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        else:
            continue
        yield from (stage_of(name) for name in names if name.startswith("drd_tools.diagnose"))


def test_each_package_is_a_stage() -> None:
    assert {folder.parent.name for folder in ROOT.glob("*/__init__.py")} == set(STAGES)


@pytest.mark.parametrize("stage", STAGES)
def test_a_stage_imports_earlier_ones_only(stage: str) -> None:
    allowed = {*WORDS, *STAGES[: STAGES.index(stage) + 1]}
    wrong = {
        f"{file.name} imports {name}"
        for file in (ROOT / stage).rglob("*.py")
        for name in imported(file)
        if name not in allowed
    }
    assert not wrong


def test_words_import_no_stage() -> None:
    assert {name for word in WORDS for name in imported(ROOT / f"{word}.py")} <= set(WORDS)


@pytest.mark.parametrize("stage", STAGES)
def test_a_stage_says_in_one_sentence_what_it_is(stage: str) -> None:
    said = ast.get_docstring(ast.parse((ROOT / stage / "__init__.py").read_text(encoding="utf-8")))
    assert said is not None
    assert said.endswith(".")
    assert "\n" not in said


def test_no_function_has_many_parameters() -> None:
    found = [
        f"{file.name}: {node.name}"
        for file in ROOT.rglob("*.py")
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        if isinstance(node, ast.FunctionDef)
        and len(node.args.posonlyargs + node.args.args + node.args.kwonlyargs) > MOST_PARAMETERS
    ]
    assert not found
