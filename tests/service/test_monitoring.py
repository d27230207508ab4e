"""The monitor's process beside the daemon: fed, killed, stopped and reloaded, and the pose goes on as without it."""

import asyncio
import math
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Awaitable, Callable, Iterator
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import msgspec
import numpy as np
import pytest
from bench.robot import Circle
from harness import Robot

from drd.config.keys import Config
from drd.config.schema import loads
from drd.estimation.applied import Constant
from drd.estimation.basis import basis_of
from drd.estimation.calibration import Calibration
from drd.monitor.findings import Finding
from drd.monitor.monitor import Monitor
from drd.pipeline import Observer, Pipeline
from drd.samples import GyroSample, WheelSample
from drd.service.monitor_channel import (
    ARGUMENTS,
    BATCH_RECORDS,
    CLOCK,
    FIX,
    GAP,
    GYRO,
    LARGEST_PACKET_BYTES,
    RECORD,
    WHEELS,
    Report,
    Setup,
)
from drd.service.monitor_process import Feed
from drd.service.monitoring import Monitoring
from drd.state.memory_file import MemoryKeeper
from drd_tools.recordings.mcap_file import open_mcap

# The process has the last place for the processor: of a busy machine it gets one hundredth.
PATIENCE_S = 300.0
OFF = "monitor: {enabled: false}"
ROBOT = """
fog: {protocol: ecore, port: /nowhere/fog}
encoders: {layout: cia406, interface: slcan, channel: /nowhere/can, counts_per_revolution: 20000, modulus_counts: 65536}
estimation: {static_bias: {duration_s: 2, minimum_s: 0.5}}
"""


def config_of(text: str = "") -> Config:
    return loads("robot: {wheel_radius_m: 0.11, tread_m: 0.6}\n" + text, Config).value


def put_in_force(monitoring: Monitoring, config: Config) -> None:
    monitoring.put_in_force(config, None, basis_of(config, None, None, True))


def gyro(i: int) -> GyroSample:
    return GyroSample(1_000_000_000 + i * 50_000_000, 0.05, 0.1, 20.0)


def wheels(i: int, lost_s: float = 0.0) -> WheelSample:
    return WheelSample(1_000_000_000 + i * 50_000_000, 0.05, 0.047, 0.053, lost_s)


class Heard:
    """A monitor that only remembers."""

    now_s, is_judging = 0.0, True

    def __init__(self) -> None:
        self.samples: list[Any] = []
        self.gyro = self.wheels = self.samples.append


def packet(*records: tuple[int, Any]) -> bytes:
    return b"".join(
        RECORD.pack(kind, *((s.t_ns, *s[1:4], s.lost_s if kind == WHEELS else 0.0) if s else (0, 0.0, 0.0, 0.0, 0.0)))
        for kind, s in records
    )


def test_samples_go_through_the_channel_to_the_bit() -> None:
    feed, heard = Feed(Setup(config_of(), None)), Heard()
    feed.monitor = heard  # type: ignore[assignment]
    odd = WheelSample(2**62, 1 / 3, -1e-300, 0.1 + 0.2, 0.7)
    cold = GyroSample(7, 0.1, -0.0, float("nan"))
    assert not feed.take(packet((GYRO, cold), (WHEELS, odd)))
    assert repr(heard.samples) == repr([cold, odd])


def test_the_monitor_is_told_of_a_gap() -> None:
    feed, heard = Feed(Setup(config_of(), None)), Heard()
    feed.monitor = heard  # type: ignore[assignment]
    feed.take(packet((WHEELS, wheels(0)), (GAP, None), (GYRO, gyro(9)), (WHEELS, wheels(9)), (WHEELS, wheels(10))))
    assert [s.lost_s > 0.0 for s in heard.samples if isinstance(s, WheelSample)] == [False, True, False]
    assert (feed.gaps, feed.samples) == (1, 4)


def test_the_gyro_is_calibrated_before_the_monitor_has_it() -> None:
    flat = ((0.1, 0.0, 0.0), *((0.0, 0.0, 0.0),) * 3)
    calibration = Calibration(flat, (-90.0, 90.0), (-10.0, 50.0), 0.01, {"who": "a test"})
    setup = msgspec.json.decode(msgspec.json.encode(Setup(config_of(), calibration)), type=Setup)
    assert setup == Setup(config_of(), calibration)
    feed, heard = Feed(setup), Heard()
    feed.monitor = heard  # type: ignore[assignment]
    feed.take(packet((GYRO, gyro(0))))
    assert heard.samples[0].rate_rad_s == pytest.approx(0.1 - np.deg2rad(0.1))


def test_what_a_monitor_tells_arrives_as_it_was() -> None:
    monitor = Monitor(config_of())
    wanted = {"radii": Constant("radii", -0.01, 4e-4, 1.0), "turn": None}
    report = Report(not_observable=monitor.not_observable(), notes=["x"], memory_mb=1.5, wanted=wanted)
    assert msgspec.json.decode(msgspec.json.encode(report), type=Report) == report
    assert report.not_observable


@pytest.mark.parametrize("keys", ["fog: {protocol: none}", "model: {file: model.yaml}"])
def test_where_it_cannot_look_it_is_off_by_default_and_says_why_in_the_health_only(keys: str) -> None:
    config = config_of(keys)
    monitoring = Monitoring(lambda: None, MemoryKeeper(config), lambda _: None)
    put_in_force(monitoring, config)
    told = health(monitoring)
    assert (told["state"], told["pid"], monitoring.status) == ("off", None, "")
    assert told["reason"]


def test_a_reset_reaches_the_monitor_as_a_pose_of_which_nothing_is_known() -> None:
    monitoring = Monitoring(lambda: None, MemoryKeeper(config_of()), lambda _: None)
    monitoring._process = process = Mock()
    monitoring.event("set_pose", 4, x_m=1.0, y_m=2.0, heading_rad=0.0, sigma_m=0.1, sigma_rad=0.0)
    monitoring.event("reset", 5)
    assert [call.args for call in process.put.call_args_list] == [
        (FIX, (4, 1.0, 2.0, 0.1)),
        (FIX, (5, 0.0, 0.0, math.inf)),
    ]


def test_a_wall_clock_that_is_set_on_the_way_reaches_the_monitor_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monitoring, process = Monitoring(lambda: None, MemoryKeeper(config_of()), lambda _: None), Mock()
    process.report.return_value = None
    wall_ns = 10**18
    monkeypatch.setattr("drd.service.monitoring.time.time_ns", lambda: wall_ns)
    monkeypatch.setattr("drd.service.monitoring.time.monotonic_ns", lambda: 10**12)
    assert monitoring._with_memory(Setup(config_of(), None)).wall_zero_ns == wall_ns - 10**12
    for step_ns in (0, 10**9, 10**17, 0):  # corrected by a second, set by three years
        wall_ns += step_ns
        monitoring._exchange(process)
    process.put.assert_called_once_with(CLOCK, (wall_ns - 10**12, 0.0, 0.0, 0.0))
    feed = Feed(Setup(config_of(), None))
    feed.take(RECORD.pack(*process.put.call_args.args[:1], *process.put.call_args.args[1], 0.0))
    assert feed._lasting._wall_zero_ns == wall_ns - 10**12


def test_what_waits_of_an_old_monitor_at_a_reload_is_not_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drd.service.monitoring.PERIOD_S", 0.0)
    taken: list[Any] = []
    waiting: list[Report] = []
    monitoring = Monitoring(lambda: None, MemoryKeeper(config_of()), taken.append)

    def report() -> Report | None:
        return waiting.pop() if waiting else None

    def reload() -> None:
        waiting.append(Report(wanted={"turn": Constant("turn", 0.04, 0.002)}))
        put_in_force(monitoring, config_of())

    async def main() -> None:
        asyncio.get_running_loop().call_soon(reload)
        await monitoring._serve(Mock(report=report))

    asyncio.run(main())
    assert len(waiting) == 1
    assert taken == []


# ---- a process, without a daemon -------------------------------------------------------------------------------------


def with_monitoring(work: Callable[[Monitoring, list[str]], Awaitable[None]], config: Config) -> None:
    """Run `work` beside a Monitoring and the list of the states that it told."""

    async def main() -> None:
        states: list[str] = []
        keeper = MemoryKeeper(config)
        monitoring = Monitoring(lambda: states.append(monitoring.findings()["state"]), keeper, lambda _: None)
        put_in_force(monitoring, config)
        task = asyncio.create_task(monitoring.run())
        try:
            await work(monitoring, states)
            assert not task.done()
        finally:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)

    asyncio.run(main())


async def until(condition: Callable[[], object]) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline
        await asyncio.sleep(0.02)


def health(monitoring: Monitoring) -> dict[str, Any]:
    found = monitoring.health()
    assert found is not None
    return found


@pytest.mark.process
def test_a_stopped_process_drops_samples_and_is_told_of_the_gap_when_it_goes_on() -> None:
    async def work(monitoring: Monitoring, states: list[str]) -> None:
        await until(lambda: health(monitoring)["state"] == "running")
        os.kill(health(monitoring)["pid"], signal.SIGSTOP)
        sent = 0
        while not health(monitoring)["dropped"]:
            for _ in range(BATCH_RECORDS + 1):  # the batch goes out when one more comes
                monitoring.gyro(gyro(sent))
                monitoring.wheels(wheels(sent))
                sent += 1
            assert sent < 1_000_000
        os.kill(health(monitoring)["pid"], signal.SIGCONT)
        first = sent

        def more() -> bool:
            nonlocal sent
            for _ in range(20):
                monitoring.gyro(gyro(sent))
                monitoring.wheels(wheels(sent))
                sent += 1
            return bool(health(monitoring)["gaps"])

        await until(more)
        assert sent > first
        told = health(monitoring)
        assert (told["restarts"], told["reason"]) == (0, None)
        assert set(states) == {"starting", "running"}

    with_monitoring(work, config_of())


@pytest.mark.process
def test_one_that_takes_nothing_for_long_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drd.service.monitor_child.HUNG_S", 0.2)

    async def work(monitoring: Monitoring, _: list[str]) -> None:
        await until(lambda: health(monitoring)["state"] == "running")
        os.kill(health(monitoring)["pid"], signal.SIGSTOP)

        def more() -> bool:
            for i in range(20 * BATCH_RECORDS):
                monitoring.gyro(gyro(i))
            return bool(health(monitoring)["restarts"])

        await until(more)
        assert health(monitoring)["dropped"] > 0
        assert health(monitoring)["reason"] == "it has accepted no samples for 0.2 s"
        await until(lambda: health(monitoring)["state"] == "running")

    with_monitoring(work, config_of())


@pytest.mark.process
def test_the_findings_are_those_of_a_monitor_with_the_same_samples() -> None:
    alone = Monitor(config_of())

    async def work(monitoring: Monitoring, _: list[str]) -> None:
        await until(lambda: health(monitoring)["state"] == "running")
        for i in range(1200):  # a minute, in which the wheels turn twice as fast as the gyro says
            for monitor in (alone, monitoring):
                monitor.gyro(gyro(i))
                monitor.wheels(wheels(i))
            if i % 50 == 49:  # no faster than it takes them, however busy the machine is: none must be dropped
                most = 2 * (i + 1) - 80  # by the last block's report
                await until(lambda: health(monitoring)["samples"] > most)  # noqa: B023 (waited for at once)
        found = monitoring.findings()["findings"]
        assert msgspec.convert(found, list[Finding]) == alone.findings()
        assert [f["effect"] for f in monitoring.summary()] == [f.effect for f in alone.findings()] != []
        assert monitoring.status.startswith("monitor: ")

    with_monitoring(work, config_of())


@pytest.mark.process
def test_it_runs_as_the_configuration_says_and_begins_anew_with_another_robot() -> None:
    async def work(monitoring: Monitoring, states: list[str]) -> None:
        assert monitoring.health() is None
        monitoring.gyro(gyro(0))
        put_in_force(monitoring, config_of())
        await until(lambda: health(monitoring)["state"] == "running")
        first = health(monitoring)["pid"]
        assert os.getpriority(os.PRIO_PROCESS, first) == 19
        put_in_force(monitoring, config_of("output: {health_period_s: 2}"))
        await asyncio.sleep(0.3)
        assert health(monitoring)["pid"] == first
        larger = loads("robot: {wheel_radius_m: 0.12, tread_m: 0.6}", Config).value
        put_in_force(monitoring, larger)
        await until(lambda: health(monitoring)["pid"] not in (None, first))
        second = health(monitoring)["pid"]
        put_in_force(monitoring, config_of(OFF))
        await until(lambda: states[-1] == "off")
        for pid in (first, second):
            assert not Path(f"/proc/{pid}").exists()
        assert monitoring.restarts == 0

    with_monitoring(work, config_of(OFF))


@pytest.mark.process
@pytest.mark.parametrize(("sent", "code"), [(b"no record", 1), (b"", 0)], ids=["an error", "the daemon's end"])
def test_the_process_reports_an_error_and_ends_with_the_daemon(sent: bytes, code: int) -> None:
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with ours:
        ours.settimeout(PATIENCE_S)
        ours.send(msgspec.json.encode(Setup(config_of(), None)))
        with theirs:
            child = subprocess.Popen([sys.executable, *ARGUMENTS], stdin=theirs.fileno())
        assert msgspec.json.decode(ours.recv(LARGEST_PACKET_BYTES), type=Report).error is None
        if sent:
            ours.send(sent)
            error = msgspec.json.decode(ours.recv(LARGEST_PACKET_BYTES), type=Report).error
            assert error is not None
            assert "multiple of" in error
        else:
            ours.shutdown(socket.SHUT_WR)
        assert child.wait(PATIENCE_S) == code


def poses_of(config: Config, *observers: Observer) -> list[str]:
    poses: list[str] = []
    pipeline = Pipeline(config, Path("/"), lambda pose, _: poses.append(repr(pose)), observers)
    for t_ns, data in Circle(config).arrivals(20.0):
        pipeline.tick(t_ns)
        if isinstance(data, bytes):
            pipeline.on_fog_bytes(data, t_ns)
        else:
            pipeline.on_frames(data)
    return poses


@pytest.mark.process
def test_the_poses_are_the_same_to_the_bit_with_it_and_without() -> None:
    config = config_of(ROBOT)

    async def work(monitoring: Monitoring, _: list[str]) -> None:
        await until(lambda: health(monitoring)["state"] == "running")
        poses = poses_of(config, monitoring)
        assert poses == poses_of(config)
        assert len(poses) > 350
        await until(lambda: health(monitoring)["samples"] > 300)
        assert health(monitoring)["dropped"] == 0

    with_monitoring(work, config)


# ---- the daemon ------------------------------------------------------------------------------------------------------


@pytest.fixture
def watched(robot: Robot, tmp_path: Path) -> Iterator[Robot]:
    """A robot whose daemon records, and has a monitor once it has read its configuration again."""
    with robot.file.open("a") as file:
        file.write(f"recording: {{enabled: true, folder: {tmp_path}}}\n")
    robot.emulator.plug_in()
    command = [sys.executable, "-W", "error", "-m", "drd", "run", str(robot.file)]
    process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    try:
        robot.drive()
        assert robot.get("findings") == {"error": "there is no monitor: monitor.enabled is false"}
        robot.file.write_text(robot.file.read_text().replace("monitor: {enabled: false}\n", ""))
        process.send_signal(signal.SIGHUP)
        yield robot
    finally:
        process.send_signal(signal.SIGTERM)
        _, log = process.communicate(timeout=15.0)
    assert process.returncode == 0, log
    assert log.count("monitor: killed by SIGKILL") == 1, log
    (recording,) = tmp_path.glob("*.mcap")
    states = [s for s, _ in groupby(message.value()["state"] for message in open_mcap(recording).messages("/findings"))]
    assert states[:5] == ["starting", "running", "waiting", "starting", "running"]


def told(robot: Robot, what: Callable[[dict[str, Any]], object]) -> dict[str, Any]:
    """The health, once its monitor's part fulfils a condition."""
    deadline = time.monotonic() + PATIENCE_S
    while not (robot.health and robot.health["monitor"] and what(robot.health["monitor"])):
        assert time.monotonic() < deadline, robot.health
        time.sleep(0.05)
    return robot.health


@pytest.mark.process
def test_a_monitor_that_is_killed_is_started_again_and_no_pose_is_missed(watched: Robot) -> None:
    first = told(watched, lambda m: m["state"] == "running")
    assert first["findings"] == []
    findings = watched.get("findings")
    assert (findings["state"], findings["findings"]) == ("running", [])
    assert {e["effect"] for e in findings["not_observable"]} >= {"wheel_radius_speed"}
    watched.wait("a pose", lambda p: p["validity"] == "valid", 20.0)
    os.kill(first["monitor"]["pid"], signal.SIGKILL)
    told(watched, lambda m: m["state"] == "waiting" and m["reason"] == "killed by SIGKILL")
    again = told(watched, lambda m: m["state"] == "running")
    assert again["monitor"]["restarts"] == 1
    assert again["monitor"]["pid"] != first["monitor"]["pid"]
    numbers = [pose["sequence"] for pose in watched.poses]
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
    unused = {name: again["counters"]["estimator"][name] for name in ("wheel_gaps", "gyro_gaps", "late_wheels")}
    assert sum(unused.values()) <= 1, unused  # on a busy machine the emulated robot may stall
    assert again["counters"]["zenoh"]["findings"] >= 4
    # Two poses that are set far enough apart show what both radii have in common, unless a busy machine loses a sample
    # between them.
    assert "wheel_radius_error" in not_observable(watched)
    deadline = time.monotonic() + PATIENCE_S
    while "wheel_radius_error" in not_observable(watched):
        assert time.monotonic() < deadline
        here = watched.poses[-1]
        set_pose(watched, here)
        watched.wait("5.5 m away", partial(is_far, here), 30.0)
    assert watched.get("findings")["findings"] == []


def not_observable(robot: Robot) -> set[str]:
    return {e["effect"] for e in robot.get("findings")["not_observable"]}


def is_far(here: dict[str, Any], pose: dict[str, Any]) -> bool:
    return math.hypot(pose["x_m"] - here["x_m"], pose["y_m"] - here["y_m"]) > 5.5


def set_pose(robot: Robot, pose: dict[str, Any]) -> None:
    """Say that it is where it was a moment ago."""
    robot.get("set_pose", {**{name: pose[name] for name in ("x_m", "y_m", "heading_rad")}, "sigma_m": 0.5})
