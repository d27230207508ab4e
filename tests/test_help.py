"""`--help` is the manual page: what, form of the input, examples, exit codes."""

import re

import pytest

from drd.cli import COMMANDS, main
from drd_tools.fleet.command import ACTIONS as FLEET

KINDS = [("calibrate", kind) for kind in ("gyro", "noise", "wheels")]
ACTIONS = [("fleet", action) for action in FLEET]
PAGES = [(name,) for name in COMMANDS if name not in ("calibrate", "fleet")] + KINDS + ACTIONS


def help_of(*command: str, capsys: pytest.CaptureFixture[str]) -> str:
    with pytest.raises(SystemExit) as end:
        main([*command, "--help"])
    assert end.value.code == 0
    return capsys.readouterr().out


@pytest.mark.parametrize("command", PAGES, ids=" ".join)
def test_a_page_has_examples_and_exit_codes(command: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> None:
    page = help_of(*command, capsys=capsys)
    assert page.startswith(f"usage: drd {' '.join(command)} ")
    examples = re.search(r"^examples?:(.*?)(?:\n\n|\Z)", page, re.MULTILINE | re.DOTALL)
    assert examples
    assert f"drd {' '.join(command)}" in examples[1]
    assert re.search(r"exit codes?\b", page, re.IGNORECASE)
    assert max(map(len, page.splitlines())) <= 120


@pytest.mark.parametrize(("command", "kind"), KINDS + ACTIONS)
def test_a_command_lists_its_kinds(command: str, kind: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert re.search(rf"^  {kind} ", help_of(command, capsys=capsys), re.MULTILINE)
