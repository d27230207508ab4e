"""`drd check --live` on emulated hardware, over a real pty and a real SLCAN line."""

import os
import signal
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import serial
from harness import CONFIG

from drd.cli import main
from drd.config.file import load_config
from drd_tools.emulate.hardware import Emulator
from drd_tools.simulate.missions import demo_drive


@pytest.fixture
def config(tmp_path: Path) -> Path:
    file = tmp_path / "robot.yaml"
    file.write_text(CONFIG.format(folder=tmp_path, bias_s=1.0, endpoint="tcp/127.0.0.1:0"))
    return file


@pytest.fixture
def emulator(config: Path) -> Iterator[Emulator]:
    with Emulator(load_config(config).value, config.parent, demo_drive(30.0, stand_s=1.0), seed=1) as made:
        yield made


def changed(config: Path, old: str, new: str) -> str:
    """The path of a configuration that is wrong in one place."""
    file = config.with_name("wrong.yaml")
    text = config.read_text()
    assert old in text
    file.write_text(text.replace(old, new))
    return str(file)


def unwrapped(capsys: pytest.CaptureFixture[str]) -> str:
    """The output without its line ends: where they fall depends on how far the robot came."""
    return " ".join(capsys.readouterr().out.split())


def test_an_inverted_gyro_is_found_and_ctrl_c_ends_the_watching(
    emulator: Emulator, config: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    wrong = changed(config, "protocol: ecore", "protocol: ecore, positive: counterclockwise")
    began_s = time.monotonic()
    # A busy machine loses frames, and only seconds without a hole are judged: time for some.
    threading.Timer(12.0, os.kill, (os.getpid(), signal.SIGINT)).start()
    assert main(["check", "--live", wrong, "--seconds", "600", "--drove", "forward"]) == 1
    assert time.monotonic() - began_s < 60.0
    found, _, summary = unwrapped(capsys).rpartition("checks:")
    assert "FAULT" in found
    assert "gyro and wheels turn in opposite directions" in found
    assert "1 FAULT" in summary
    assert emulator.is_running


def test_a_dead_encoder_is_found(emulator: Emulator, config: Path, capsys: pytest.CaptureFixture[str]) -> None:
    emulator.left_slip = -1.0
    assert main(["check", "--live", str(config), "--seconds", "5", "--drove", "forward"]) == 1
    assert "the left counter does not count although you drove" in unwrapped(capsys)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("protocol: ecore", "protocol: dsp3000", "bytes came on"),
        ("modulus_counts: 65536", "modulus_counts: 65536, left: {node: 7}", "the left side never reported"),
        ("/can", "/none", "No such file or directory"),
    ],
)
def test_a_sensor_without_samples_is_explained_by_how_far_its_data_came(
    emulator: Emulator, config: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, words: str
) -> None:
    assert main(["check", "--live", changed(config, old, new), "--seconds", "1"]) == 1
    assert words in unwrapped(capsys)
    assert emulator.is_running


def test_a_port_that_the_daemon_holds_is_told(
    emulator: Emulator, config: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with serial.Serial(emulator.places["FOG"].split(" -> ")[0], exclusive=True):
        assert main(["check", "--live", str(config), "--seconds", "1"]) == 1
    assert "stop the daemon first" in unwrapped(capsys)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--seconds", "5"], "--seconds goes with --live"),
        (["--live", "--seconds", "0"], "from 1 to 86400, got '0'"),
        (["--live", "--distance", "nan"], "from 0.1 to 100000, got 'nan'"),
        (["--live", "--turned", "around"], "invalid choice: 'around'"),
    ],
)
def test_bad_usage_is_told(config: Path, arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(["check", str(config), *arguments])
    assert words in capsys.readouterr().err
