"""EQUATIONS.md is numbered in the order of reading, and code and numbers agree."""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
# A citation is a number in brackets after a blank, a quote or another bracket: "# (7)", "is (11), (27)"; not notify(3).
CITED = re.compile(r"(?<=[ #(\"\n])\((\d{1,3})\)(?:(?: to |-)\((\d{1,3})\))?")
# Comments, docstrings, and the sources that effects state.
TEXTS = re.compile(r'#[^\n]*|""".*?"""|source = "[^"\n]*"', re.DOTALL)


def text() -> str:
    return (ROOT / "drd" / "EQUATIONS.md").read_text()


def defined() -> list[int]:
    return [int(n) for n in re.findall(r"^\*\*\((\d+)\)\*\*", text(), re.MULTILINE)]


def numbers(part: str) -> set[int]:
    ends = [(int(a), int(b or a)) for a, b in CITED.findall(part)]
    return {n for a, b in ends for n in range(a, b + 1)}


def cited(*folders: str) -> dict[int, list[str]]:
    found: dict[int, list[str]] = {}
    for folder in folders:
        for file in sorted((ROOT / folder).rglob("*.py")):
            if file == Path(__file__):
                continue
            for number in {n for part in TEXTS.findall(file.read_text()) for n in numbers(part)}:
                found.setdefault(number, []).append(str(file.relative_to(ROOT)))
    return found


def test_numbers_rise_by_one_in_the_order_of_reading() -> None:
    assert defined() == list(range(1, len(defined()) + 1))


def test_each_cited_number_is_defined() -> None:
    assert {n: files for n, files in cited("drd", "tools", "tests").items() if n not in defined()} == {}
    assert numbers(text()) <= set(defined())


def test_each_number_is_cited() -> None:
    assert set(defined()) - set(cited("drd", "tools", "tests")) == set()


def test_the_filter_cites_the_papers_equations() -> None:
    assert {7, 8, 9, 10, 11, 12, 13, 14} <= set(cited("drd"))


def test_the_diagnosis_cites_its_method() -> None:
    method = text().split("\n## Diagnosis\n")[1].split("\n## ")[0]
    wanted = {int(n) for n in re.findall(r"^\*\*\((\d+)\)\*\*", method, re.MULTILINE)}
    assert wanted <= set(cited("tools/drd_tools/diagnose", "tools/drd_tools/trial"))


def test_the_monitor_cites_its_method() -> None:
    method = text().split("\n## Monitor\n")[1].split("\n## ")[0]
    wanted = {int(n) for n in re.findall(r"^\*\*\((\d+)\)\*\*", method, re.MULTILINE)}
    assert wanted <= set(cited("drd/monitor"))


def test_the_fleet_cites_its_method() -> None:
    method = text().split("\n## Fleet\n")[1].split("\n## ")[0]
    wanted = {int(n) for n in re.findall(r"^\*\*\((\d+)\)\*\*", method, re.MULTILINE)}
    assert wanted <= set(cited("tools/drd_tools/fleet"))
