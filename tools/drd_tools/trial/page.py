"""Generate the page of figures, and the short table that a README quotes."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

from drd.commands import writing
from drd.config.schema import ConfigError
from drd_tools.report.page import Page
from drd_tools.trial.figures import Figures, Table, markdown
from drd_tools.trial.pictures import draw_effects, draw_methods
from drd_tools.trial.results import Head

PAGE: Final = "trial.html"
QUOTED: Final = "figures.md"
BEGIN, END = "<!-- figures of drd trial -->", "<!-- end of figures -->"


class Content(NamedTuple):
    """Contents of a page: its origin, tables, and lines under a title. `figures`: those to be drawn, if any."""

    origin: str
    tables: Sequence[Table]
    title: str
    lines: Sequence[str]
    figures: Figures | None = None


def write_page(content: Content, folder: Path) -> list[Path]:
    """Write trial.html with its pictures, and figures.md, into `folder`; return the files. Raises ConfigError."""
    files = [folder / PAGE, folder / QUOTED, folder / "methods.png", folder / "effects.png"]
    about = "d is an effect's detectability: the norm of its whitened sensitivity, nuisances projected out."
    page = Page("Trial of the diagnosis", [content.origin, about])
    figures, listed = content.figures, "\n".join(content.lines).strip() or "none"
    parts = ["# Trial of the diagnosis", content.origin]
    with writing(folder):
        if figures is not None:
            page.table(figures.quoted().header, figures.quoted().rows)
            parts.append(markdown(figures.quoted()))
            if draw_methods(files[2], figures):
                caption = "The diagnosis beside sparse regressions of the same library on the same recordings."
                page.picture(files[2], caption)
            if draw_effects(files[3], figures):
                caption = (
                    "Each effect alone: the name itself (dots, with 95 % Wilson intervals) and as a class (rings)."
                )
                page.picture(files[3], caption)
        for table in content.tables:
            title, more, _ = table.caption.partition(" (")
            page.heading(title)
            page.table(table.header, table.rows, table.caption)
            parts += [f"## {title}", *([f"{table.caption}."] if more else []), markdown(table)]
        if figures is not None and (drives := figures.drives()).rows:
            page.heading(drives.caption.partition(" (")[0])
            page.table(drives.header, drives.rows, drives.caption, text_columns=(1, 3, 7))
        page.heading(content.title)
        page.code(listed)
        page.save(files[0])
        parts += [f"## {content.title}", f"```\n{listed}\n```"]
        files[1].write_text("\n\n".join(part.strip() for part in parts) + "\n", encoding="utf-8")
    return [f for f in files if f.exists()]


def origin(figures: Figures, head: Head) -> str:
    """Sentence on the origin of the figures of simulated and given recordings."""
    low, high = head.minutes
    return (
        f"Made by `drd trial`, seed {head.seed}: {len(figures.pairs)} recordings whose answer was hidden, drives of "
        f"{low:g} to {high:g} minutes, build {head.build} of the diagnosis."
    )


def quote(figures: Figures, head: Head, file: Path) -> None:
    """Put the short table between the marks BEGIN and END of a file. Raises ConfigError."""
    with writing(file, "a file to quote the figures in"):
        text = file.read_text(encoding="utf-8")
        before, begin, rest = text.partition(BEGIN)
        _, end, after = rest.partition(END)
        if not begin or not end:
            raise ConfigError(str(file), "", f"the marks {BEGIN} and {END}", "a file without them")
        block = f"{origin(figures, head)}\n\n{markdown(figures.quoted())}"
        file.write_text(f"{before}{begin}\n{block}{end}{after}", encoding="utf-8")
