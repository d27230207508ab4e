"""Terminal output, pictures and HTML page from a saved comparison."""

from pathlib import Path

from tqdm import tqdm

from drd_tools.compare import text
from drd_tools.compare.pictures import channel_picture, overview_picture
from drd_tools.compare.results import Comparison
from drd_tools.report.page import Page
from drd_tools.report.terminal import print_table


def print_comparison(c: Comparison) -> None:
    """Print sentences and tables."""
    print(*text.lead(c), "", sep="\n")
    print_table(text.HEADER, text.rows(c), {0, *text.TEXT_COLUMNS})
    print()
    for channel in c.channels:
        print(f"- {text.sentence(channel)}")
    header, body = text.share_rows(c)
    if len(header) > 1:
        print("\nShare that one covariate alone predicts; * p <= 0.01 over all of the table\n")
        print_table(header, body)
    for note in (c.bias, assumed(c), *c.notes):
        if note:
            print(f"\n{note}")


def assumed(c: Comparison) -> str:
    """Sentence on the noise figures that are assumed, not stated by robot.yaml."""
    names = [name for name, _, source in c.noise if source.startswith("assumed")]
    if not names:
        return ""
    return (
        f"robot.yaml does not state {', '.join(names)}: usual values stand in, and sigmas are no better than they are."
    )


def write_report(c: Comparison, folder: Path) -> list[Path]:
    """Draw everything into `folder`; return the files. Raises OSError."""
    lead = list(text.lead(c))
    page = Page(f"Recorded against simulated: {Path(c.recording).name}", lead)
    files = [folder / "report.html", folder / "overview.png"]
    overview_picture(files[1], c)
    page.picture(files[1], f"Left: how far each channel is from what noise alone makes. Right: {text.SHARES}")
    page.table(text.HEADER, text.rows(c), "All channels; ± is one sigma of noise alone", text_columns=text.TEXT_COLUMNS)
    page.text(assumed(c))
    for channel in tqdm(c.channels, desc="drawing", leave=False, disable=None):
        page.heading(channel.title[0].upper() + channel.title[1:])
        page.text(text.sentence(channel))
        files.append(folder / f"{channel.id}.png")
        channel_picture(files[-1], c, channel)
        page.picture(
            files[-1],
            f"{channel.text[0].upper()}{channel.text[1:]}. Bands: noise alone. Curves: the mismatch as a curve of one "
            "covariate alone, with one sigma by the scatter; above each its cross-validated share. Map: each block.",
        )
    page.heading("How")
    page.text(text.METHOD)
    page.table(text.NOISE_HEADER, c.noise, "Noise of the nominal model", text_columns=(2,))
    if rows := text.reference_rows(c):
        caption = "Reference errors, estimated from each channel and corrected; an effect of the robot may be in them"
        page.table(("channel", "reference", "fitted"), rows, caption, text_columns=(1,))
    page.text(c.bias, *c.notes)
    page.inputs(c.sha256)
    page.save(files[0])
    return files
