"""Recording from an emulated gyro on a pseudo-terminal, at a table and at standstill."""

import io
import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drd.config.file import load_config
from drd.config.keys import Config
from drd.config.schema import ConfigError
from drd_tools.calibrate import fog_recorder
from drd_tools.calibrate.fog_recorder import Progress, RecordingError, SampleFile, record
from drd_tools.calibrate.gyro import live as gyro_live
from drd_tools.calibrate.gyro.live import doubts_about, record_steps
from drd_tools.emulate.hardware import Emulator
from drd_tools.emulate.sensors import SensorErrors
from drd_tools.simulate.missions import make_drive

CONFIG = """\
robot: {{wheel_radius_m: 0.11, tread_m: 0.6}}
fog: {{protocol: {protocol}, port: {folder}/fog, rate_hz: 100, baud: 115200}}
encoders: {{layout: cia406, interface: slcan, channel: {folder}/can, counts_per_revolution: 20000}}
"""
ERRORS = SensorErrors(bias_deg_s=0.02, scale_error=0.0, clock_error_percent=0.0, temperature_c=22.0)


class Bench:
    """A gyro on a table that stands; `fog_offset_deg_s` of its emulator turns the table."""

    def __init__(self, folder: Path, protocol: str = "ecore"):
        self.file, self.folder = folder / "robot.yaml", folder / "steps"
        self.file.write_text(CONFIG.format(folder=folder, protocol=protocol))
        self.config: Config = load_config(self.file).value
        self.emulator = Emulator(self.config, folder, make_drive("stand"), ERRORS, seed=1)


@pytest.fixture
def bench(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Bench]:
    made = Bench(tmp_path, getattr(request, "param", "ecore"))
    with made.emulator:
        yield made


class Operator(io.TextIOBase):
    """Standard input: before each answer, the table is set."""

    def __init__(self, bench: Bench, *answers: tuple[float | None, str]):
        super().__init__()
        self._bench, self._answers = bench, list(answers)

    def readline(self, *_: Any) -> str:  # type: ignore[override]  # as every text stream does
        if not self._answers:
            return ""
        rate_deg_s, answer = self._answers.pop(0)
        if rate_deg_s is not None:
            self._bench.emulator.fog_offset_deg_s = rate_deg_s
        return answer + "\n"


def columns(file: Path) -> dict[str, Any]:
    table = np.genfromtxt(file, delimiter=",", names=True)
    return {name: table[name] for name in table.dtype.names or ()}


def test_each_rate_becomes_a_file(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "stdin", Operator(bench, (20.0, ""), (None, "s"), (-15.0, "")))
    files = record_steps(bench.file, bench.folder, [20.0, 40.0, -15.0], 1.0)
    assert [file.name for file in files] == ["step_01_+20_deg_s.csv", "step_03_-15_deg_s.csv"]
    assert sorted(bench.folder.iterdir()) == files
    for file, rate_deg_s in zip(files, (20.0, -15.0), strict=True):
        assert file.read_text().splitlines()[0] == "time_s,table_rate_deg_s,rate_deg_s,temperature_c"
        table = columns(file)
        assert table["time_s"][0] == 0.0
        assert np.diff(table["time_s"]) == pytest.approx(np.full(len(table["time_s"]) - 1, 0.01), abs=0.009)
        assert table["time_s"][-1] == pytest.approx(0.99, abs=0.05)
        assert (table["table_rate_deg_s"] == rate_deg_s).all()
        # The daemon's sign: counter-clockwise positive, though the gyro counts clockwise.
        assert table["rate_deg_s"].mean() == pytest.approx(rate_deg_s + 0.02, abs=0.03)
        assert table["temperature_c"] == pytest.approx(np.full(len(table["time_s"]), 22.0), abs=0.5)
    said = capsys.readouterr().out
    assert "Set the table to +20 deg/s, wait until it is steady, press Enter" in said
    assert "Warning" not in said


def test_a_table_that_does_not_turn_is_asked_about_and_the_step_repeated(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "stdin", Operator(bench, (0.0, ""), (None, ""), (20.0, "")))
    (file,) = record_steps(bench.file, bench.folder, [20.0], 0.5)
    assert columns(file)["rate_deg_s"].mean() == pytest.approx(20.0, abs=0.1)
    said = capsys.readouterr().out
    assert said.count("is the table turning?") == 1
    assert "Repeat it?" in said


def test_a_doubtful_step_can_be_kept_or_ended(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "stdin", Operator(bench, (-20.0, ""), (None, "k"), (0.0, ""), (None, "q")))
    files = record_steps(bench.file, bench.folder, [20.0, 30.0, 40.0], 0.5)
    assert [file.name for file in files] == ["step_01_+20_deg_s.csv"]
    assert sorted(bench.folder.iterdir()) == files
    said = capsys.readouterr().out
    assert "the other way round" in said
    assert "Ended; 1 of 3 steps were kept." in said


def test_the_end_of_the_input_ends_it(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdin", Operator(bench))
    assert record_steps(bench.file, bench.folder, [20.0], 0.5) == []


@pytest.mark.parametrize("bench", ["dsp3000"], indirect=True)
def test_a_gyro_without_temperature_leaves_it_empty_and_says_so(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "stdin", Operator(bench, (10.0, "")))
    (file,) = record_steps(bench.file, bench.folder, [10.0], 0.3)
    assert all(line.endswith(",") for line in file.read_text().splitlines()[1:])
    assert "cannot be calibrated over temperature" in capsys.readouterr().out


def test_a_port_that_is_not_there_is_said_and_asked_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    bench = Bench(tmp_path)  # not plugged in
    monkeypatch.setattr(sys, "stdin", Operator(bench, (None, ""), (None, "q")))
    assert record_steps(bench.file, bench.folder, [20.0], 0.5) == []
    assert f"cannot open {tmp_path}/fog: No such file or directory" in capsys.readouterr().err
    assert list(bench.folder.iterdir()) == []


def test_a_port_in_use_hints_at_the_daemon(bench: Bench) -> None:
    def record_too(*_: object) -> None:
        with pytest.raises(RecordingError, match="in use by another program: stop the daemon first"):
            _in_thread(lambda: record(bench.config, 0.5, lambda *_: None))

    record(bench.config, 0.02, record_too)


def _in_thread(work: Any) -> None:
    """asyncio.run does not nest: run it in a thread of its own, and hand on what it raises."""
    from concurrent.futures import ThreadPoolExecutor  # noqa: PLC0415  # only here

    with ThreadPoolExecutor(1) as pool:
        pool.submit(work).result()


def test_a_lost_port_ends_the_recording(bench: Bench) -> None:
    def pull(time_s: float, _: object) -> None:
        if time_s > 0.2:
            bench.emulator.fog_silent = True
            _in_thread(bench.emulator.unplug_fog)

    with pytest.raises(RecordingError, match="lost"):
        record(bench.config, 60.0, pull)


@pytest.mark.parametrize(
    ("fault", "text"),
    [
        ({"fog_silent": True}, "no byte has come: is the gyro powered"),
        ({"fog_silent": False, "fog_invalid": True}, "none that can be used: frames="),
    ],
    ids=["silent", "invalid"],
)
@pytest.mark.parametrize("bench", ["dsp3000"], indirect=True)
def test_silence_is_explained(bench: Bench, fault: dict[str, Any], text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fog_recorder, "SILENCE_S", 0.3)
    for name, value in fault.items():
        setattr(bench.emulator, name, value)
    with pytest.raises(RecordingError, match=text):
        record(bench.config, 5.0, lambda *_: None)


def test_a_wrong_protocol_is_guessed(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fog_recorder, "SILENCE_S", 0.3)
    bench.file.write_text(CONFIG.format(folder=bench.file.parent, protocol="dsp17xx"))
    with pytest.raises(RecordingError, match=r"bytes came, but no packet: are fog\.protocol \(dsp17xx\)"):
        record(load_config(bench.file).value, 5.0, lambda *_: None)


def test_a_full_disk_ends_the_recording(bench: Bench) -> None:
    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device")

    with pytest.raises(RecordingError, match="cannot write: No space left on device"):
        record(bench.config, 5.0, fail)


def test_a_robot_without_gyro_and_a_used_folder_are_refused(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    bench.folder.mkdir()
    (bench.folder / "step_01_+20_deg_s.csv").touch()
    with pytest.raises(ConfigError, match="a folder without earlier steps"):
        record_steps(bench.file, bench.folder, [20.0], 1.0)
    bench.file.write_text(CONFIG.format(folder=tmp_path, protocol="none"))
    with pytest.raises(ConfigError, match=r"fog\.protocol: expected a gyro"):
        record_steps(bench.file, tmp_path / "other", [20.0], 1.0)


@pytest.mark.parametrize(("rates", "seconds"), [([], 1.0), ([math.nan], 1.0), ([20.0], 0.0), ([20.0], math.inf)])
def test_impossible_steps_are_refused(tmp_path: Path, rates: list[float], seconds: float) -> None:
    with pytest.raises(ConfigError, match="at least one finite rate"):
        record_steps(Bench(tmp_path).file, tmp_path / "steps", rates, seconds)


def progress_of(mean: float, sigma: float, samples: int) -> Progress:
    squares = samples * mean**2 + (samples - 1) * sigma**2
    return Progress(samples=samples, recorded_s=1.0, sum_deg=samples * mean, sum_squares=squares)


@pytest.mark.parametrize(
    ("made", "doubt"),
    [
        ((20.1, 0.1, 100), None),
        ((24.5, 0.1, 100), "is the table turning"),
        ((-19.0, 0.1, 100), "the other way round"),
        ((20.0, 2.0, 100), "was the table steady"),
        ((20.0, 0.1, 70), "only 70 samples"),
        ((20.0, 0.0, 100), "never changes"),
    ],
)
def test_doubts_about_a_step(made: tuple[float, float, int], doubt: str | None) -> None:
    found = doubts_about(progress_of(*made), 20.0, 1.0, 100.0)
    assert len(found) == (doubt is not None)
    assert doubt is None or doubt in found[0]


def test_at_rest_the_bias_is_no_doubt() -> None:
    assert doubts_about(progress_of(0.05, 0.1, 100), 0.0, 1.0, 100.0) == []
    assert doubts_about(progress_of(3.0, 0.1, 100), 0.0, 1.0, 100.0) != []


def test_a_file_that_cannot_be_made_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="a file that can be written"):
        SampleFile(tmp_path / "no" / "file.csv", gyro_live.HEADER)
