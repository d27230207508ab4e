from html.parser import HTMLParser
from pathlib import Path

from drd_tools.report.page import Page
from drd_tools.report.style import make_figure, styled, tidy


class Reader(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.sources: list[str] = []
        self.words: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.sources += [value or "" for name, value in attrs if name in {"src", "href"}]

    def handle_data(self, data: str) -> None:
        self.words.append(data.strip())


def test_a_page_is_one_file_with_all_its_parts_escaped(tmp_path: Path) -> None:
    with styled():
        figure = make_figure()
        axes = figure.subplots()
        axes.plot([0, 1], [0, 1])
        tidy(axes, "a line")
        figure.savefig(tmp_path / "line.png")
    page = Page("1 < 2 & 3", ["The <first> sentence."])
    page.heading("Numbers")
    page.text("a & b")
    page.code("x: 1\ny: 2")
    page.table(["name", "value"], [["one", 1.5], ["<two>", 2]], "two rows", chosen={1}, text_columns={1})
    page.picture(tmp_path / "line.png", 'a "line"')
    page.save(tmp_path / "page.html")
    reader = Reader()
    reader.feed((tmp_path / "page.html").read_text(encoding="utf-8"))
    assert {"1 < 2 & 3", "The <first> sentence.", "Numbers", "a & b", "<two>", "1.5", "two rows"} <= set(reader.words)
    assert reader.tags.count("tr") == 3
    assert len(reader.sources) == 1
    assert reader.sources[0].startswith("data:image/png;base64,iVBOR")
    assert "link" not in reader.tags
    assert "script" not in reader.tags
