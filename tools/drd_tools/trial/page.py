"""The pages of figures, and the short table that a README quotes: generated, never typed."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from drd.config.schema import ConfigError
from drd_tools.report.page import Page
from drd_tools.trial.figures import Figures, markdown
from drd_tools.trial.pictures import draw_effects, draw_methods
from drd_tools.trial.store import Head
from drd_tools.trial.text import failures

PAGE: Final = "trial.html"
QUOTED: Final = "figures.md"
BEGIN, END = "<!-- figures of drd trial -->", "<!-- end of figures -->"


def write_page(figures: Figures, arguments: Sequence[str], head: Head, folder: Path) -> list[Path]:
    """Write trial.html with its pictures, and figures.md, into `folder`; return the files. Raises ConfigError."""
    files = [folder / PAGE, folder / QUOTED, folder / "methods.png", folder / "effects.png"]
    drives = f"drives of {head['minutes'][0]:g} to {head['minutes'][1]:g} min, seed {head['seed']}"
    page = Page(
        "Trial of the diagnosis",
        [
            f"{len(figures.pairs)} recordings whose answer was hidden; drawn ones: {drives}.",
            "d is an effect's visibility: the norm of its signature, whitened by the noise, nuisances projected out.",
        ],
    )
    quoted = figures.quoted()
    try:
        page.table(quoted.header, quoted.rows)
        if draw_methods(files[2], figures):
            caption = "The diagnosis beside sparse regressions of the same library on the same recordings."
            page.picture(files[2], caption)
        if draw_effects(files[3], figures):
            caption = "Each effect alone: the name itself (dots, with 95 % Wilson intervals) and as a class (rings)."
            page.picture(files[3], caption)
        for table in figures.tables():
            page.heading(table.caption.partition(" (")[0])
            page.table(table.header, table.rows, table.caption)
        page.heading("Failures, and how to make each alone")
        page.code("\n".join(failures(figures, arguments)).strip() or "none")
        page.save(files[0])
        files[1].write_text(_markdown_page(figures, arguments, head), encoding="utf-8")
    except OSError as error:
        raise ConfigError(str(folder), "", "a folder to write to", str(error.strerror)) from error
    return [f for f in files if f.exists()]


def _markdown_page(figures: Figures, arguments: Sequence[str], head: Head) -> str:
    """The same page for a repository."""
    parts = ["# Trial of the diagnosis", _origin(figures, head), markdown(figures.quoted())]
    for table in figures.tables():
        title, more, _ = table.caption.partition(" (")
        parts += [f"## {title}", *([f"{table.caption}."] if more else []), markdown(table)]
    failed = "\n".join(failures(figures, arguments)).strip() or "none"
    parts += ["## Failures, and how to make each alone", f"```\n{failed}\n```"]
    return "\n\n".join(part.strip() for part in parts) + "\n"


def _origin(figures: Figures, head: Head) -> str:
    low, high = head["minutes"]
    return (
        f"Made by `drd trial`, seed {head['seed']}: {len(figures.pairs)} recordings whose answer was hidden, drives of "
        f"{low:g} to {high:g} minutes, build {head['build']} of the diagnosis."
    )


def quote(figures: Figures, head: Head, file: Path) -> None:
    """Put the short table between the marks BEGIN and END of a file. Raises ConfigError."""
    try:
        text = file.read_text(encoding="utf-8")
        before, begin, rest = text.partition(BEGIN)
        _, end, after = rest.partition(END)
        if not begin or not end:
            raise ConfigError(str(file), "", f"the marks {BEGIN} and {END}", "a file without them")
        block = f"{_origin(figures, head)}\n\n{markdown(figures.quoted())}"
        file.write_text(f"{before}{begin}\n{block}{end}{after}", encoding="utf-8")
    except OSError as error:
        raise ConfigError(str(file), "", "a file to quote the figures in", str(error.strerror)) from error
