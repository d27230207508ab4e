"""One self-contained HTML page: sentences, tables and pictures, to be handed to a colleague as a single file."""

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
    """A piece of the page; the template knows how each kind looks."""

    kind: str
    text: str = ""
    png: str = ""
    markup: Markup | None = None
    header: Sequence[str] = ()
    rows: Sequence[Sequence[str]] = ()
    chosen: Collection[int] = ()
    wide: Collection[int] = ()


class Page:
    """Collects the parts in their order, then writes the file. All text is escaped, but for `markup`."""

    def __init__(self, title: str, lead: Iterable[str]):
        """`lead`: the few sentences a reader in a hurry needs."""
        self._title, self._lead = title, list(lead)
        self._parts: list[Part] = []

    def heading(self, text: str) -> None:
        """Begin a section."""
        self._parts.append(Part(kind="heading", text=text))

    def text(self, *texts: str) -> None:
        """Paragraphs; empty ones are left out."""
        self._parts += [Part(kind="text", text=text) for text in texts if text]

    def code(self, text: str) -> None:
        """Lines as they are, in a fixed pitch."""
        self._parts.append(Part(kind="code", text=text))

    def picture(self, file: Path, caption: str) -> None:
        """A PNG, embedded; the caption also serves those who cannot see it. Raises OSError."""
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
        """A table; `chosen` are the rows to emphasise, `text_columns` those (besides the first) that hold text."""
        cells = [[str(cell) for cell in row] for row in rows]
        part = Part(kind="table", text=caption, header=header, rows=cells, chosen=chosen, wide=text_columns)
        self._parts.append(part)

    def markup(self, markup: Markup) -> None:
        """A piece of HTML that a template of the caller's has made, which escapes what it is given."""
        self._parts.append(Part(kind="markup", markup=markup))

    def inputs(self, sha256: Mapping[str, str]) -> None:
        """Which files it was made from, and their digests."""
        self.table(("input", "SHA-256"), list(sha256.items()), text_columns=(1,))

    def save(self, file: Path) -> None:
        """Write the page. Raises OSError."""
        footer = f"drd {__version__}, {datetime.now(UTC):%Y-%m-%d %H:%M UTC}"
        values = {"title": self._title, "lead": self._lead, "parts": self._parts, "footer": footer}
        file.write_text(rendered("drd_tools.report", "page.html.j2", values), encoding="utf-8")


def rendered(package: str, template: str, values: Mapping[str, Any]) -> str:
    """Fill in a template that lies in a package; it escapes what it is given."""
    environment = Environment(
        loader=PackageLoader(package, "."), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    return environment.get_template(template).render(values)
