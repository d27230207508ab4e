"""Terminal output, pictures and HTML page from a saved explanation."""

from collections.abc import Sequence
from pathlib import Path

from drd_tools.explain import text
from drd_tools.explain.pictures import budget_picture, parts_picture
from drd_tools.explain.results import Explanation
from drd_tools.limit import text as limit_text
from drd_tools.report.page import Page
from drd_tools.report.terminal import columns


def print_explanation(e: Explanation) -> None:
    """Print sentences and tables."""
    print(f"{e.recording}\n")
    for sentence in text.lead(e):
        print(f"- {sentence}")
    print("\nError budget at the end (1 sigma, in the robot's axes there)\n")
    _print_summed(text.HEADER, text.budget_rows(e))
    for sentence in (text.silent_groups(e), text.delay_sentence(e)):
        if sentence:
            print(f"\n{sentence}")
    if e.actual is not None and text.fits(e.actual):
        print(f"\n{text.parts_caption(e.actual)}\n")
        _print_summed(text.PARTS_HEADER, text.parts_rows(e.actual))
    for note in e.notes:
        print(f"\n{note}")


def _print_summed(header: Sequence[str], rows: list[list[str]]) -> None:
    lines = columns([header, *rows])
    print(*lines[:-1], f"  {'-' * (max(map(len, lines)) - 2)}", lines[-1], sep="\n")


def write_report(e: Explanation, folder: Path) -> list[Path]:
    """Draw everything into `folder`; return the files. Raises OSError."""
    name = Path(e.recording).name
    page = Page(f"Error budget of {name}", list(text.lead(e)))
    files = [folder / "report.html", folder / "budget.png"]
    budget_picture(files[1], e)
    actual = " Black: the actual error against the reference." if e.actual is not None else ""
    page.picture(
        files[1],
        "The whole height is one sigma of the error counted from the interval's begin, by the filter's own account; "
        f"each colour has its cause's share of the variance.{actual}",
    )
    caption = "Error budget at the end, 1 sigma, in the robot's axes there"
    page.table(text.HEADER, text.budget_rows(e), caption, chosen=(0,))
    page.text(text.silent_groups(e), text.delay_sentence(e))
    page.heading("Each cause")
    page.table(text.HEADER, text.budget_rows(e, detailed=True), "The same, with each group's parts")
    if e.actual is not None:
        page.heading("The actual error")
        if not text.fits(e.actual):
            page.text(
                "The known causes cannot bring this error, so the table below shares it out among the wrong ones: it "
                "is given for completeness."
            )
        files.append(folder / "parts.png")
        parts_picture(files[2], e.actual)
        page.picture(files[2], "Most likely part of each cause in the actual error; bars are two sigma.")
        page.table(text.PARTS_HEADER, text.parts_rows(e.actual), text.parts_caption(e.actual))
        if e.actual.inseparable:
            pairs = "; ".join(" and ".join(pair) for pair in e.actual.inseparable)
            page.text(f"Not distinguished by this error (where one is larger the other is smaller): {pairs}.")
    else:
        (folder / "parts.png").unlink(missing_ok=True)  # from an earlier explanation
    if e.limit is not None:
        page.heading("The limit")
        for table in limit_text.tables(e.limit):
            page.table(*table)
    page.heading("What it was made from")
    page.text(*e.notes)
    page.inputs(e.sha256)
    page.text(f"Digest of the poses: {e.digest}.")
    page.save(files[0])
    return files
