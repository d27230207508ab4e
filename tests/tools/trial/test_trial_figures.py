"""The figures that trial/README.md quotes are those of the page that a trial has written."""

from pathlib import Path

from drd_tools.trial.page import BEGIN, END

TRIAL = Path(__file__).resolve().parents[3] / "tools/drd_tools/trial"


def test_the_readme_quotes_the_page() -> None:
    _, _, rest = (TRIAL / "README.md").read_text(encoding="utf-8").partition(BEGIN)
    block, end, _ = rest.partition(END)
    assert end
    origin, *rows = [line for line in block.splitlines() if line]
    assert origin.startswith("Made by `drd trial`, seed ")
    assert any(row.startswith("| nothing is missing, something is reported |") for row in rows)
    page = (TRIAL / "FIGURES.md").read_text(encoding="utf-8")
    assert [line for line in page.splitlines() if line][1 : 2 + len(rows)] == [origin, *rows]
