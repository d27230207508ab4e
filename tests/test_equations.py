"""Every equation number that the code cites stands in EQUATIONS.md, once."""

import re
from pathlib import Path

DRD = Path(__file__).resolve().parents[1] / "drd"
# A citation is a number in brackets after a blank or another bracket: "# (7)", "is (11), (27)"; not notify(3).
CITED = re.compile(r"(?<=[ #(])\((\d{1,2})\)")


def defined() -> list[int]:
    return [int(n) for n in re.findall(r"^\*\*\((\d+)\)\*\*", (DRD / "EQUATIONS.md").read_text(), re.MULTILINE)]


def cited() -> dict[int, list[str]]:
    found: dict[int, list[str]] = {}
    for file in sorted(DRD.rglob("*.py")):
        text = file.read_text()
        for part in re.findall(r"#.*", text) + re.findall(r'""".*?"""', text, re.DOTALL):
            for number in CITED.findall(part):
                found.setdefault(int(number), []).append(file.name)
    return found


def test_each_number_is_defined_once_and_none_is_left_out() -> None:
    numbers = defined()
    assert sorted(numbers) == list(range(1, max(numbers) + 1))


def test_each_cited_number_is_defined() -> None:
    assert {n: files for n, files in cited().items() if n not in defined()} == {}


def test_the_filter_cites_the_papers_equations() -> None:
    assert {7, 11, 13, 14, 17, 18} <= set(cited())
