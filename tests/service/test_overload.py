"""Too much of everything: refused, counted and told once; who does not read harms nobody, not even the end."""

import logging
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from bench.cpu import usage
from bench.crowd import crowd
from harness import Robot

from drd.service.losses import TOLD, Losses

STALLED = 10
# So that a stalled client's connection is full after some poses.
SEND_BUFFER_BYTES = 8192
MAX_GROWTH_BYTES = 20e6


def test_each_loss_is_told_once(caplog: pytest.LogCaptureFixture) -> None:
    losses = Losses()
    none = {"counters": {"encoders.port": {"queue_dropped": 0}, "zenoh": {"full_queues": 0}}, "recording": None}
    losses.look(none)
    assert not caplog.records
    counters: dict[str, dict[str, int]] = {}
    for part, name in TOLD:
        counters.setdefault(part, {})[name] = 7
    recording = counters.pop("recording")
    with caplog.at_level(logging.WARNING):
        for _ in range(3):
            losses.look({"counters": counters, "recording": recording})
    assert [record.getMessage().partition("=")[0] for record in caplog.records] == [".".join(key) for key in TOLD]


@pytest.mark.process
def test_clients_that_stop_reading_cost_no_pose_no_memory_and_one_line_of_log(robot: Robot, tmp_path: Path) -> None:
    text = robot.file.read_text()
    robot.file.write_text(text.replace("]}", f"#so_sndbuf={SEND_BUFFER_BYTES}]}}"))
    robot.emulator.plug_in()
    log = tmp_path / "log"
    with log.open("w") as stderr:
        process = subprocess.Popen([sys.executable, "-m", "drd", "run", str(robot.file)], stderr=stderr)
    try:
        robot.drive()
        with crowd(robot.endpoint, "drd/pose", STALLED) as stalled:
            before = usage(process.pid).resident_bytes
            stalled.stall()
            give_up = time.monotonic() + 30.0
            while not robot.get("health")["counters"]["zenoh"]["full_queues"]:
                assert time.monotonic() < give_up
                time.sleep(0.2)
            robot.wait("poses go on", lambda pose: pose["sequence"] > 0)
            assert usage(process.pid).resident_bytes - before < MAX_GROWTH_BYTES
            time.sleep(2.2)  # two more healths
            assert log.read_text().count("zenoh.full_queues=") == 1
            process.send_signal(signal.SIGTERM)
            assert process.wait(15.0) == 0, log.read_text()
    finally:
        process.kill()
