"""A self-contained HTML page of sentences, tables and pictures, in a single file."""

import base64
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from drd import __version__


@dataclass(frozen=True, kw_only=True)
class Part:
    """A part of the page; the template defines the look of each kind."""

    kind: str
    text: str = ""
    png: str = ""
    markup: Markup | None = None
    header: Sequence[str] = ()
    rows: Sequence[Sequence[str]] = ()
    chosen: Collection[int] = ()
    wide: Collection[int] = ()


class Page:
    """Builder of a page, which collects parts in order and writes the file. All text is escaped, except `markup`."""

    def __init__(self, title: str, lead: Iterable[str]):
        """Begin a page; `lead` is a summary in a few sentences."""
        self._title, self._lead = title, list(lead)
        self._parts: list[Part] = []

    def heading(self, text: str) -> None:
        """Begin a section."""
        self._parts.append(Part(kind="heading", text=text))

    def text(self, *texts: str) -> None:
        """Add paragraphs, leaving out empty ones."""
        self._parts += [Part(kind="text", text=text) for text in texts if text]

    def code(self, text: str) -> None:
        """Add lines as they are, in a monospaced font."""
        self._parts.append(Part(kind="code", text=text))

    def picture(self, file: Path, caption: str) -> None:
        """Embed a PNG; its caption is also the alternative text. Raises OSError."""
        png = base64.b64encode(file.read_bytes()).decode("ascii")
        self._parts.append(Part(kind="picture", text=caption, png=png))

    def table(
        self,
        header: Sequence[str],
        rows: Iterable[Sequence[Any]],
        caption: str = "",
        chosen: Collection[int] = (),
        text_columns: Collection[int] = (),
    ) -> None:
        """Add a table; `chosen` are the rows to emphasise, `text_columns` those (besides the first) that hold text."""
        cells = [[str(cell) for cell in row] for row in rows]
        part = Part(kind="table", text=caption, header=header, rows=cells, chosen=chosen, wide=text_columns)
        self._parts.append(part)

    def markup(self, markup: Markup) -> None:
        """Add HTML made by the caller's template, which must escape its input."""
        self._parts.append(Part(kind="markup", markup=markup))

    def inputs(self, sha256: Mapping[str, str]) -> None:
        """Add a table of the input files and their digests."""
        self.table(("input", "SHA-256"), list(sha256.items()), text_columns=(1,))

    def save(self, file: Path) -> None:
        """Write the page. Raises OSError."""
        footer = f"drd {__version__}, {datetime.now(UTC):%Y-%m-%d %H:%M UTC}"
        values = {"title": self._title, "lead": self._lead, "parts": self._parts, "footer": footer}
        file.write_text(rendered("drd_tools.report", "page.html.j2", values), encoding="utf-8")


def rendered(package: str, template: str, values: Mapping[str, Any]) -> str:
    """Render a template from a package, escaping its values."""
    environment = Environment(
        loader=PackageLoader(package, "."), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    return environment.get_template(template).render(values)
