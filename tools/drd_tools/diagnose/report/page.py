"""HTML page of a diagnosis, with its pictures, from its files."""

from pathlib import Path
from typing import Final

from tqdm import tqdm

from drd_tools.diagnose import files
from drd_tools.diagnose.report import pictures
from drd_tools.diagnose.report import text as report_text
from drd_tools.diagnose.report.verdict import lead, title
from drd_tools.diagnose.results import Result
from drd_tools.diagnose.series import Series
from drd_tools.report.page import Page

PICTURES: Final = ("finding_*.png", "scatter_*.png", "residual.png", "held_out.png")  # not in every diagnosis


def write_report(folder: Path) -> list[Path]:
    """Draw `report.html` and its pictures into `folder`, from its diagnosis.json and series.json; return the files.

    Raises ConfigError if one of the two is missing or malformed, OSError if the folder cannot be written.
    """
    d, s = files.load(folder)
    for old in (file for pattern in PICTURES for file in folder.glob(pattern)):
        old.unlink(missing_ok=True)  # of an earlier diagnosis
    page = Page(title(d, [r.name for r in s.recordings]), lead(d, s))
    if d.cut:
        page.text(f"Incomplete: {d.cut}.")
    for note in d.notes or ():
        page.text(f"{note}.")
    drawn: list[Path] = []
    _findings_table(page, d, s)
    _paths(page, d, s, folder, drawn)
    _findings(page, d, s, folder, drawn)
    _residual(page, d, s, folder, drawn)
    _held_out(page, d, s, folder, drawn)
    _classes(page, d)
    _ruled_out(page, d)
    _detectable(page, d)
    _not_observable(page, d)
    _next_drive(page, d)
    page.save(folder / "report.html")
    return [folder / "report.html", *drawn]


def _findings_table(page: Page, d: Result, s: Series) -> None:
    if not d.findings:
        return
    page.table(report_text.WHAT_HEADER, report_text.what_rows(d.findings), text_columns=(1, 2))
    rows = report_text.evidence_rows(d.findings, _duration_s(s))
    page.table(report_text.EVIDENCE_HEADER, rows, text_columns=report_text.EVIDENCE_TEXT)
    page.text(report_text.LEGEND)


def _paths(page: Page, d: Result, s: Series, folder: Path, drawn: list[Path]) -> None:
    page.heading("Path")
    recordings = s.recordings
    windows = [w for f in d.findings for w in report_text.windows(f, _duration_s(s))] if len(recordings) == 1 else []
    drawn.append(folder / "path.png")
    pictures.paths_picture(drawn[-1], recordings, windows)
    hidden = len(recordings) - pictures.MOST_PATHS
    corrected = any(r.path.corrected is not None for r in recordings)
    page.picture(
        drawn[-1],
        "Dead reckoning with the nominal model"
        + (", and corrected for the findings." if corrected else ".")
        + (" Ring: start; dots: ends.")
        + (f" The first {pictures.MOST_PATHS} recordings; {hidden} more are in series.json." if hidden > 0 else ""),
    )


def _findings(page: Page, d: Result, s: Series, folder: Path, drawn: list[Path]) -> None:
    pairs = list(zip(d.findings, s.findings, strict=True))
    for k, (finding, series) in enumerate(tqdm(pairs, desc="drawing", leave=False, disable=None), 1):
        page.heading(f"{k}. {finding.effect}" if len(pairs) > 1 else finding.effect)
        page.text(report_text.in_words(finding).replace("+-", "±"))
        curve, evidence = series.curve, series.evidence
        if curve is None and not evidence.time_s.size:
            continue
        drawn.append(folder / f"finding_{k}.png")
        alone = s.recordings[0].path if len(s.recordings) == 1 else None
        windows = report_text.windows(finding, _duration_s(s)) if alone else []
        path = (alone.reference or alone.nominal) if alone else None
        pictures.finding_picture(drawn[-1], curve, evidence, windows, path)
        page.picture(drawn[-1], report_text.picture_caption(curve, evidence, bool(windows)))


def _residual(page: Page, d: Result, s: Series, folder: Path, drawn: list[Path]) -> None:
    page.heading("Residual")
    has_findings = bool(d.findings)
    residual = s.residual
    if residual.time_s.size:
        drawn.append(folder / "residual.png")
        pictures.residual_picture(drawn[-1], residual, has_findings)
        before, after = map(report_text.rms, (residual.before, residual.after))
        figures = "" if before is None or after is None else f" All blocks: {before:.2f}." if not has_findings else f" All blocks: {before:.2f} before, {after:.2f} after."  # fmt: skip  # noqa: E501
        page.picture(drawn[-1], f"Rms of the whitened residual, by block; noise alone gives 1.{figures}")
    else:
        page.text("The recording is too short to be divided into blocks.")
    if rows := report_text.fit_rows(d):
        page.table(report_text.FIT_HEADER, rows, "drd's own estimate on the fitted data", text_columns=(1,))
    if sentence := report_text.noise_sentence(s):
        page.text(sentence)
    _scatter(page, d, s, folder, drawn)


def _scatter(page: Page, d: Result, s: Series, folder: Path, drawn: list[Path]) -> None:
    for sentence in report_text.scatter_sentences(d):
        page.text(sentence)
    for noise, spread in zip(d.scatter, s.scatter, strict=True) if len(s.recordings) == 1 else ():
        if spread.time_s.size:
            drawn.append(folder / f"scatter_{noise.channel}.png")
            pictures.scatter_picture(drawn[-1], noise, spread)
            page.picture(drawn[-1], f"Noise of the {report_text.CHANNELS[noise.channel]}, relative to the stated one.")


def _held_out(page: Page, d: Result, s: Series, folder: Path, drawn: list[Path]) -> None:
    page.heading("Validation on unseen data")
    if not s.held_out:
        page.text(
            "There is no model to validate: nothing was found."
            if not d.findings
            else "No other recording was given for validation (--held-out). The e-value above is from blocks of this "
            "recording that were not used in the fit."
        )
        return
    drawn.append(folder / "held_out.png")
    pictures.held_out_picture(drawn[-1], s.held_out)
    names = list(dict.fromkeys(row.name for row in s.held_out))
    many = len(names) > pictures.MOST_BARRED
    source = f"{len(names)} recordings" if many else report_text.listed(names)
    page.picture(drawn[-1], f"Before and after ({source}): data that were not used in the fit.")
    if many:
        page.table(report_text.HELD_OUT_HEADER, report_text.held_out_rows(s.held_out), text_columns=(1, 2))


def _classes(page: Page, d: Result) -> None:
    page.heading("Effects that this recording cannot distinguish")
    if not d.classes:
        page.text("All effects that would be visible in it can be distinguished from each other.")
        return
    page.text("The effects on each line would look the same in this recording:")
    rows = [(str(k), ", ".join(names)) for k, names in enumerate(d.classes, 1)]
    page.table(("class", "effects"), rows, text_columns=(1,))


def _ruled_out(page: Page, d: Result) -> None:
    page.heading("Effects ruled out, and why")
    if d.ruled_out:
        page.table(report_text.RULED_OUT_HEADER, report_text.ruled_out_rows(d), text_columns=(1, 2))
    else:
        page.text("Nothing could be ruled out.")


def _detectable(page: Page, d: Result) -> None:
    page.heading("Smallest detectable effects")
    if not d.detectable:
        page.text("Not computed.")
        return
    page.text("A smaller effect may still be present. The plausible range is what occurs in practice.")
    page.table(report_text.DETECTABLE_HEADER, report_text.detectable_rows(d), text_columns=(1, 3, 5))


def _not_observable(page: Page, d: Result) -> None:
    rows = [(r.effect, r.because) for r in d.unobservable]
    if rows:
        page.heading("Effects not observable in this recording")
        page.table(("effect", "reason"), rows, text_columns=(1,))


def _next_drive(page: Page, d: Result) -> None:
    page.heading("What to drive next")
    for sentence in report_text.next_drive_sentences(d):
        page.text(sentence)
    if d.next_drive is not None and d.next_drive.segments:
        page.table(report_text.SEGMENT_HEADER, report_text.segment_rows(d.next_drive))
        page.table(report_text.SETTLED_HEADER, report_text.settled_rows(d.next_drive))


def _duration_s(s: Series) -> float:
    return float(max(r.duration_s for r in s.recordings))
