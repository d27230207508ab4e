"""`drd import` of a gyro's bytes: times by the packets' places, whatever was lost or damaged."""

import gzip
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drd.cli import main
from drd.config.file import load_config
from drd_tools.emulate.fog_packets import make_encoder

CONFIG = """\
robot: {name: scout, wheel_radius_m: 0.1, tread_m: 0.5}
fog: {protocol: dsp3000, rate_hz: 10, positive: clockwise, full_scale_deg_s: 375}
encoders: {layout: agilex, rate_hz: 20}
"""


def run(*words: Any) -> int:
    return main(["import", *map(str, words)])


def test_bytes_of_a_gyro(tmp_path: Path) -> None:
    config = tmp_path / "robot.yaml"
    config.write_text(CONFIG)
    rates = [0.5, 1.0, -2.0, 3.25]
    path = tmp_path / "fog.bin"
    path.write_bytes("".join(f"{rate:11.6f}  1\r\n" for rate in rates).encode())
    assert run(path, "--config", config, "--gyro", "fog", "--output", tmp_path / "out") == 0
    written = np.loadtxt(tmp_path / "out" / "fog.csv", delimiter=",", skiprows=1)
    assert written[:, 1] == pytest.approx([-rate for rate in rates])  # fog.positive is clockwise
    assert np.diff(written[:, 0]) == pytest.approx(0.1)


@pytest.mark.parametrize("mode", ["rate", "integrated"])
def test_a_damaged_line_takes_a_beat(tmp_path: Path, mode: str) -> None:
    config, path, angles = tmp_path / "robot.yaml", tmp_path / "fog.bin", 2.0 * np.arange(100)
    config.write_text(CONFIG.replace("clockwise", f"counterclockwise, dsp3000: {{mode: {mode}}}"))
    values = angles if mode == "integrated" else np.full(100, 20.0)
    lines = [f"{value:11.6f}  1\r\n" for value in values]
    lines[40], lines[60] = lines[40].replace(".", "!"), lines[60][2:7] + lines[60][8:]
    path.write_bytes("".join(lines).encode())
    assert run(path, "--config", config, "--gyro", "fog", "--output", tmp_path / "out") == 0
    time_s, rate_deg_s = np.loadtxt(tmp_path / "out" / "fog.csv", delimiter=",", skiprows=1).T
    assert rate_deg_s == pytest.approx(20.0)
    # The first integrated angle is no turn yet, but the one after a damaged line holds its turn.
    whole = mode == "integrated"
    assert (len(time_s), time_s[-1] - time_s[0]) == (99 if whole else 98, pytest.approx(9.8 if whole else 9.9))


def test_a_damaged_packet_without_a_count_takes_a_beat(tmp_path: Path) -> None:
    config, path = tmp_path / "robot.yaml", tmp_path / "fog.bin"
    config.write_text(CONFIG.replace("protocol: dsp3000", "protocol: ecore"))
    encoder = make_encoder(load_config(config).value.fog)
    packets = [encoder.encode(0.1 * k, 0.1, 25.0) for k in range(100)]
    packets[40], packets[60] = packets[40][:-1] + bytes([packets[40][-1] ^ 1]), packets[60][:3] + packets[60][4:]
    path.write_bytes(b"".join(packets))
    assert run(path, "--config", config, "--gyro", "fog", "--output", tmp_path / "out") == 0
    time_s = np.loadtxt(tmp_path / "out" / "fog.csv", delimiter=",", skiprows=1)[:, 0]
    assert (len(time_s), time_s[-1] - time_s[0]) == (98, pytest.approx(9.9))


@pytest.mark.parametrize("packed", [False, True])
def test_a_packet_that_was_delivered_twice_counts_once(tmp_path: Path, packed: bool) -> None:
    config, path = tmp_path / "robot.yaml", tmp_path / ("fog.bin.gz" if packed else "fog.bin")
    config.write_text(CONFIG.replace("protocol: dsp3000, rate_hz: 10", "protocol: dsp17xx, rate_hz: 1000"))
    encoder = make_encoder(load_config(config).value.fog)
    packets = [encoder.encode(0.001 * k, 0.001, 25.0) for k in range(200)]
    data = b"".join([*packets[:50], packets[49], *packets[50:]])
    path.write_bytes(gzip.compress(data) if packed else data)
    assert run(path, "--config", config, "--gyro", "fog", "--output", tmp_path / "out") == 0
    written = np.loadtxt(tmp_path / "out" / "fog.csv", delimiter=",", skiprows=1)
    assert np.diff(written[:, 0]) == pytest.approx(0.001)
    assert len(written) == 200
