import csv
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from drd.cli import main
from drd_tools.emulate.hardware import Emulator


@pytest.fixture
def config(tmp_path: Path) -> Path:
    file = tmp_path / "robot.yaml"
    file.write_text(
        f"""
        robot: {{wheel_radius_m: 0.1, tread_m: 0.6}}
        fog: {{port: "{tmp_path}/run/fog"}}
        encoders: {{interface: slcan, channel: "{tmp_path}/run/can", counts_per_revolution: 1000}}
        """
    )
    return file


def test_it_says_where_the_hardware_is_and_what_was_sent_and_keeps_the_truth(
    config: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    truth = tmp_path / "truth.csv"
    assert main(["emulate", str(config), "--seconds", "0.6", "--seed", "3", "--truth", str(truth)]) == 0
    out = capsys.readouterr().out.splitlines()
    assert out[0].startswith(f"FOG: {tmp_path}/run/fog -> /dev/pts/")
    assert out[1].startswith(f"CAN: {tmp_path}/run/can -> /dev/pts/")
    assert out[2].startswith("fog_packets=")
    rows = list(csv.reader(truth.read_text(encoding="utf-8").splitlines()))
    assert rows[0] == ["t_ns", "x_m", "y_m", "heading_rad", "left_m", "right_m"]
    assert 1 < len(rows) <= 13
    assert int(rows[2][0]) - int(rows[1][0]) == 50_000_000
    assert list((tmp_path / "run").iterdir()) == []


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_it_in_order_and_the_handlers_come_back(
    config: Path, tmp_path: Path, number: signal.Signals
) -> None:
    before = signal.getsignal(number)

    def send_once_it_runs() -> None:
        while not (tmp_path / "run/can").is_symlink():
            time.sleep(0.01)
        os.kill(os.getpid(), number)

    sender = threading.Thread(target=send_once_it_runs)
    sender.start()
    assert main(["emulate", str(config), "--path", "square", "--seconds", "60"]) == 0
    sender.join()
    assert signal.getsignal(number) is before
    assert list((tmp_path / "run").iterdir()) == []


def test_as_a_process_it_ends_on_sigterm(config: Path, tmp_path: Path) -> None:
    code = "import sys; from drd.cli import main; sys.exit(main(['emulate', *sys.argv[1:]]))"
    with subprocess.Popen([sys.executable, "-c", code, str(config)], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline().startswith("FOG: ")
        assert process.stdout.readline().startswith("CAN: ")
        process.terminate()
        assert process.wait(20) == 0
        assert "can_dropped=" in process.stdout.read()
    assert list((tmp_path / "run").iterdir()) == []


def test_a_path_that_is_taken_ends_it_with_code_2_and_a_reason(
    config: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "run").mkdir()
    (tmp_path / "run/can").write_text("precious")
    assert main(["emulate", str(config)]) == 2
    assert "encoders.channel: expected a path where nothing is yet" in capsys.readouterr().err
    assert [path.name for path in (tmp_path / "run").iterdir()] == ["can"]


def test_a_bad_configuration_ends_it_with_code_2_and_the_key(config: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config.write_text("robot: {wheel_radius_m: 0.1, tread_m: wide}")
    assert main(["emulate", str(config)]) == 2
    assert "robot.tread_m: expected a number" in capsys.readouterr().err
    assert main(["emulate", str(config.with_name("absent.yaml"))]) == 2


def test_a_truth_file_that_cannot_be_written_is_reported_before_the_drive(
    config: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["emulate", str(config), "--seconds", "0.1", "--truth", str(tmp_path / "no/where.csv")]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert "no/where.csv: expected a file to write to, got No such file or directory" in err


def test_an_emulator_that_fails_ends_it_with_code_1(config: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Emulator, "is_running", False)
    assert main(["emulate", str(config)]) == 1


@pytest.mark.parametrize("option", [*(f"--seconds={s}" for s in ("0", "-1", "nan", "inf", "1e9", "soon")), "--seed=-1"])
def test_a_senseless_number_is_a_usage_error(config: Path, option: str) -> None:
    with pytest.raises(SystemExit) as refused:
        main(["emulate", str(config), option])
    assert refused.value.code == 2


def test_help_names_every_option(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["emulate", "--help"])
    text = capsys.readouterr().out
    for option in ("CONFIG", "--seconds", "--seed", "--path", "--truth", "--real-bus"):
        assert option in text
