import copy
import json
import math
import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import diagnosis_files
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drd.config.schema import ConfigError
from drd.effects.catalogue import catalogue
from drd_tools.diagnose.files import load
from drd_tools.diagnose.report.page import write_report
from drd_tools.diagnose.report.pictures import end_to_end
from drd_tools.diagnose.report.text import detectable_rows, percent, power, ruled_out_rows, with_sigma
from drd_tools.diagnose.report.verdict import lead


class Reader(HTMLParser):
    """Headings, cells, sources and all text of a page."""

    def __init__(self, file: Path):
        super().__init__()
        self.headings: list[str] = []
        self.sources: list[str] = []
        self.text = ""
        self._tag = ""
        self.feed(file.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self._tag = tag
        self.sources += [value or "" for name, value in attrs if name in {"src", "href"}]

    def handle_data(self, data: str) -> None:
        if self._tag in {"h1", "h2"} and data.strip():
            self.headings.append(data)
        self.text += data.replace("\N{NO-BREAK SPACE}", " ")


def report(folder: Path, made: diagnosis_files.Made) -> tuple[Reader, list[str]]:
    files = write_report(diagnosis_files.write(folder, made))
    assert all(file.is_file() for file in files)
    return Reader(files[0]), [file.name for file in files]


def test_one_finding_reads_from_verdict_to_next_drive(tmp_path: Path) -> None:
    page, files = report(tmp_path, diagnosis_files.one_finding())
    assert files == ["report.html", "path.png", "finding_1.png", "residual.png", "held_out.png"]
    assert page.headings == [
        "Diagnosis of case_001: explained",
        "Path",
        "gyro_scale_error",
        "Residual",
        "Validation on unseen data",
        "Effects that this recording cannot distinguish",
        "Effects ruled out, and why",
        "Smallest detectable effects",
        "What to drive next",
    ]
    for text in (
        "leaves out one effect: gyro_scale_error (k = 0.01200 ± 0.00030).",
        "This is confirmed; if nothing were missing, such a finding would occur in 0.1 % of recordings.",
        "It explains 93 % of the mismatch and leaves 7 %; the path still ends 12 cm off; "
        "on unseen data the position rms falls from 1.31 to 0.14 m.",
        catalogue()["gyro_scale_error"].sentence,
        "wheel_radius_error, bump_counts",
        "Turns on the spot, both ways, for 3 minutes, to distinguish tread_error from turn_scrub.",
        "no counter stood still while the other turned",
    ):
        assert text in page.text


def test_the_page_is_one_file(tmp_path: Path) -> None:
    page, files = report(tmp_path, diagnosis_files.two_and_unknown())
    assert len(page.sources) == len(files) - 1
    assert all(source.startswith("data:image/png;base64,") for source in page.sources)


def test_several_findings_of_two_recordings(tmp_path: Path) -> None:
    page, files = report(tmp_path, diagnosis_files.two_and_unknown())
    assert [name for name in files if name.startswith("finding")] == ["finding_1.png", "finding_2.png", "finding_3.png"]
    assert page.headings[0] == "Diagnosis of morning_run and 1 more: partly explained"
    assert page.headings[2:5] == ["1. surface_slip", "2. gyro_warmup", "3. unknown"]
    for text in (
        "gyro_warmup (or gyro_bias_temperature or gyro_bias_temperature_rate, which fits equally well)",
        "something outside the catalogue acts on the gyro and depends on place",
        "surface_slip is supported, gyro_warmup is confirmed and the unknown one is suspected",
        "would occur in at most 3.1 % of recordings",
        "301 to 359 s",
        "30 s of standing still; then two manoeuvres.",
        "gyro_warmup or gyro_bias_temperature_rate",
        "all 2 together",
        "Mismatch with the nominal model, by place",
    ):
        assert text in page.text


@pytest.mark.parametrize(("count", "is_table"), [(12, False), (13, True), (1000, True)])
def test_of_many_held_out_recordings_a_table_has_the_numbers(tmp_path: Path, count: int, is_table: bool) -> None:
    diagnosis, series = diagnosis_files.one_finding()
    row = {"quantity": "position rms", "unit": "m", "before": 1.25}
    after = [None, 0.75, *(2.0 + i for i in range(count - 2))]
    series["held_out"] = [{**row, "name": f"run_{i}", "after": after[i]} for i in range(count)]
    page, files = report(tmp_path, (diagnosis, series))
    assert "held_out.png" in files
    assert (f"({count} recordings)" in page.text) == is_table
    for text in ("run_0positionrmsm1.25-", "run_1positionrmsm1.250.75", "run_9positionrmsm1.259"):
        assert (text in "".join(page.text.split())) == is_table


def test_nothing_missing_without_reference(tmp_path: Path) -> None:
    page, files = report(tmp_path, diagnosis_files.nothing_missing())
    assert files == ["report.html", "path.png", "residual.png"]
    assert page.headings[0] == "Diagnosis of case_042: nothing is missing"
    for text in (
        "Over 12 minutes and 468 m the recording agrees with the nominal model",
        "Without a reference",
        "There is no model to validate",
        "There is no open question",
    ):
        assert text in page.text
    assert "e-value" not in page.text


def test_an_unknown_cause_without_curve_or_proof(tmp_path: Path) -> None:
    page, files = report(tmp_path, diagnosis_files.only_unknown())
    assert page.headings[0].endswith("a cause outside the catalogue")
    assert "held_out.png" not in files
    assert "acts on the wheels and depends on none of the variables tried." in page.text
    assert "No other recording was given" in page.text


def test_an_unknown_cause_with_a_curve_of_its_own_and_no_evidence_over_time(tmp_path: Path) -> None:
    diagnosis, series = diagnosis_files.two_and_unknown()
    for finding in series["findings"]:
        finding["evidence"] = {"time_s": [], "nats": []}
    series["findings"][2]["curve"] |= {key: [] for key in ("fit_x", "fit", "low", "high", "y")}
    page, files = report(tmp_path, (diagnosis, series))
    assert "finding_1.png" not in files
    assert "finding_3.png" in files
    assert "as a smooth curve" in page.text


def test_pictures_of_an_earlier_diagnosis_are_removed(tmp_path: Path) -> None:
    report(tmp_path, diagnosis_files.two_and_unknown())
    _, files = report(tmp_path, diagnosis_files.nothing_missing())
    assert sorted(file.name for file in tmp_path.glob("*.png")) == sorted(files[1:])


def test_all_numbers_may_be_missing(tmp_path: Path) -> None:
    diagnosis, series = diagnosis_files.one_finding()
    finding = diagnosis["findings"][0]
    finding |= {"explains": None, "evidence": dict.fromkeys(finding["evidence"]), "driver": None}
    finding["parameters"] = {
        "side": "left",
        "k": {"value": 0.1, "std": None, "unit": "1"},
        "j": {"value": None, "std": None, "unit": "1"},
    }
    diagnosis["unexplained"] = dict.fromkeys(diagnosis["unexplained"])
    for row in series["held_out"]:
        row["after"] = None
    page, _ = report(tmp_path, (diagnosis, series))
    assert "How much of the mismatch this explains is not known." in page.text
    assert "side = left, k = 0.1, j = not known" in page.text


@pytest.mark.parametrize("made", [diagnosis_files.one_finding, diagnosis_files.two_and_unknown, diagnosis_files.nothing_missing, diagnosis_files.only_unknown])  # fmt: skip  # noqa: E501
def test_the_verdict_has_at_most_three_sentences(tmp_path: Path, made: Any) -> None:
    sentences = lead(*load(diagnosis_files.write(tmp_path, made())))
    assert 1 <= len(sentences) <= 3
    for sentence in sentences:
        assert re.fullmatch(r"[A-Z].*[^.]\.", sentence)
        assert ". " not in sentence


def test_the_sentence_about_the_mismatch_adds_up_what_the_findings_explain(tmp_path: Path) -> None:
    diagnosis, series = diagnosis_files.one_finding()
    diagnosis["findings"].append(diagnosis["findings"][0] | {"effect": "tread_error", "explains": 0.04})
    diagnosis["unexplained"]["share_of_residual"] = 0.0
    series["findings"].append(series["findings"][0] | {"effect": "tread_error"})
    text = " ".join(lead(*load(diagnosis_files.write(tmp_path, (diagnosis, series)))))
    assert "Together they explain 97 % of the mismatch and leave 3 %" in text


def test_what_was_ruled_out_begins_where_a_finding_acts(tmp_path: Path) -> None:
    result, _ = load(diagnosis_files.write(tmp_path, diagnosis_files.one_finding()))
    channels = [row[1] for row in ruled_out_rows(result)]
    assert channels == sorted(channels, key=lambda channel: channel != "gyro")
    assert set(channels) == {"gyro", "wheels"}


def test_what_only_an_implausible_size_would_show_is_marked(tmp_path: Path) -> None:
    result, _ = load(diagnosis_files.write(tmp_path, diagnosis_files.nothing_missing()))
    rows = {row[0]: row for row in detectable_rows(result)}
    assert rows["wheel_eccentricity"][-1] == rows["gyro_saturation"][-1] == "not detectable here"
    assert rows["gyro_scale_error"][-1] == ""
    assert [row for row in catalogue() if row in rows] == list(rows)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    diagnosis_files.write(tmp_path, diagnosis_files.one_finding())
    (tmp_path / "series.json").unlink()
    with pytest.raises(ConfigError, match=r"series\.json.*readable"):
        write_report(tmp_path)


@pytest.mark.parametrize("content", [b"", b"{", b"\xff\xfe", b"[" * 100_000, b"3", b'{"schema": 2}'])
def test_a_broken_file_is_named(tmp_path: Path, content: bytes) -> None:
    diagnosis_files.write(tmp_path, diagnosis_files.one_finding())
    (tmp_path / "diagnosis.json").write_bytes(content)
    with pytest.raises(ConfigError, match=r"diagnosis\.json"):
        write_report(tmp_path)


def test_errors_name_the_place(tmp_path: Path) -> None:
    diagnosis, series = diagnosis_files.one_finding()
    diagnosis["findings"][0]["status"] = "certain"
    diagnosis_files.write(tmp_path, (diagnosis, series))
    with pytest.raises(ConfigError, match=r"findings\[0\]\.status: expected one of suspected, .*, got \"certain\""):
        write_report(tmp_path)


def test_lists_of_different_length_and_findings_of_another_diagnosis_are_refused(tmp_path: Path) -> None:
    diagnosis, series = diagnosis_files.one_finding()
    series["residual"]["after"].pop()
    diagnosis_files.write(tmp_path, (diagnosis, series))
    with pytest.raises(ConfigError, match="residual: expected time_s, before, after of one length"):
        write_report(tmp_path)
    diagnosis_files.write(tmp_path, (diagnosis_files.nothing_missing()[0], diagnosis_files.one_finding()[1]))
    with pytest.raises(ConfigError, match=r"the findings of diagnosis\.json"):
        write_report(tmp_path)


BOTH = diagnosis_files.two_and_unknown()


@given(data=st.data())
@settings(deadline=None, max_examples=60)
def test_whatever_is_cut_or_replaced_there_is_no_other_error(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    """The form is read, or refused with a ConfigError; the sentences then hold."""
    made = copy.deepcopy(BOTH)
    node: Any = data.draw(st.sampled_from(made))
    while True:
        keys = list(node) if isinstance(node, dict) else list(range(len(node)))
        key = data.draw(st.sampled_from(keys))
        child = node[key]
        if not isinstance(child, dict | list) or not child or data.draw(st.integers(0, 3)) == 0:
            break
        node = child
    if data.draw(st.booleans()):
        del node[key]
    else:
        node[key] = data.draw(st.sampled_from([None, 0, -1.5, "", "x", [], {}, True, [None], {"a": 1}]))
    folder = tmp_path_factory.mktemp("cut")
    for name, content in zip(("diagnosis.json", "series.json"), made, strict=True):
        (folder / name).write_text(json.dumps(content), encoding="utf-8")
    try:
        result, series = load(folder)
    except ConfigError:
        return
    assert 1 <= len(lead(result, series)) <= 3


@given(value=st.floats(-1e9, 1e9), std=st.floats(1e-12, 1e9))
@settings(deadline=None)
def test_a_value_is_shown_as_finely_as_its_uncertainty(value: float, std: float) -> None:
    shown = with_sigma(value, std, "1")
    scaled = re.fullmatch(r"\((.*) ± (.*)\) \N{MULTIPLICATION SIGN} 10([⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+)", shown)
    plain = re.fullmatch(r"(\S*) ± (\S*)", shown)
    match = scaled or plain
    assert match
    factor = 1.0
    if scaled:
        factor = 10.0 ** int(scaled[3].translate(str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")))
    assert math.isclose(float(match[2]) * factor, std, rel_tol=0.051)
    assert abs(float(match[1]) * factor - value) <= 0.051 * std + 1e-12 * abs(value)


def test_numbers_as_humans_write_them() -> None:
    assert with_sigma(0.0016, 0.0001, "1") == "0.00160 ± 0.00010"
    assert with_sigma(139.0, 11.0, "s") == "139 ± 11 s"
    assert with_sigma(1.6e-6, 1e-7, "1/degC") == "(1.60 ± 0.10) \N{MULTIPLICATION SIGN} 10⁻⁶ 1/°C"
    assert with_sigma(0.0, 0.0, "deg/s") == "0 deg/s (not\N{NO-BREAK SPACE}fitted)"
    assert [percent(share) for share in (0.031, 0.001, 0.93, 0.0999)] == ["3.1 %", "0.1 %", "93 %", "10 %"]
    assert [power(value) for value in (12.3, 1e12, math.inf)] == ["12.3", "10¹²", "over 10¹⁰⁰"]


def test_recordings_are_laid_end_to_end() -> None:
    time_s, seams = end_to_end(np.array([1.0, 2.0, 3.0, 1.0, 2.0, 0.5]))
    assert time_s.tolist() == [1.0, 2.0, 3.0, 4.0, 5.0, 5.5]
    assert seams == [3.0, 5.0]
