"""From the gyro's last byte to the published pose, against a loop that only reads and publishes."""

import asyncio
import os
import tempfile
import time
from bisect import bisect_left
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

import zenoh

from bench.listener import listening
from bench.report import Figure, Refused, Report
from bench.robot import Circle, config_text, free_endpoint
from bench.timing import percentile
from drd.config.keys import Config
from drd.config.schema import loads
from drd.output.cdr import OdometryEncoder
from drd.output.messages import pose_json
from drd.output.session import isolated_config
from drd.output.zenoh_link import ZenohLink
from drd.pipeline import Pipeline
from drd.ports.serial_port import SerialPort
from drd.samples import Pose
from drd.units import NS_PER_S, S_PER_NS
from drd_tools.emulate.endpoints import PtyLink

DRD_KEY, BARE_KEY = "bench/pose", "bare/pose"
ROUND_S: Final = 0.1
WARM_UP_PART: Final = 0.2
OPEN_TIMEOUT_S: Final = 10.0


def run(quick: bool) -> Report:
    """Measure both, in turn, in one process."""
    with tempfile.TemporaryDirectory() as name:
        rounds = 20 if quick else 300
        bench = _Bench(Path(name), rounds)
        asyncio.run(bench.measure())
    figures = []
    for where, drd_ns, bare_ns in (
        ("put returned", bench.published_ns[DRD_KEY], bench.published_ns[BARE_KEY]),
        ("at a subscriber", bench.heard_ns[DRD_KEY], bench.heard_ns[BARE_KEY]),
    ):
        drd_us = latencies_us(bench.written_ns[DRD_KEY], drd_ns)
        bare_us = latencies_us(bench.written_ns[BARE_KEY], bare_ns)
        for percent in (50, 99):
            bare, ours = percentile(bare_us, percent), percentile(drd_us, percent)
            figures.append(Figure(f"{where}, p{percent}: bare loop", bare, "us"))
            figures.append(Figure(f"{where}, p{percent}: drd", ours, "us", ours / bare))
    return Report(
        f"latency: gyro packet written to pose published, {rounds} packets at 10 Hz, wheels at 20 Hz",
        "how many times longer drd takes than a loop that reads the same bytes and puts two payloads of the same size",
        tuple(figures),
    )


class _Bench:
    """drd's serial port, pipeline and Zenoh link beside the bare loop, in one event loop; a thread is the robot."""

    def __init__(self, folder: Path, rounds: int):
        self._endpoints = free_endpoint(), free_endpoint()
        text = config_text(folder, self._endpoints[0], publish_on="gyro")
        self._config = loads(text, Config).value
        self._folder, self._rounds = folder, rounds
        self._circle = Circle(self._config)
        self._start_ns = time.monotonic_ns()
        self.written_ns: dict[str, list[int]] = {DRD_KEY: [], BARE_KEY: []}
        self.published_ns: dict[str, list[int]] = {DRD_KEY: [], BARE_KEY: []}
        self.heard_ns: dict[str, list[int]] = {}
        self._payloads: tuple[bytes, bytes] | None = None  # of one pose, as drd publishes it
        self._link: ZenohLink

    async def measure(self) -> None:
        """Fill `written_ns`, `published_ns` and `heard_ns`."""
        loop = asyncio.get_running_loop()
        self._link = ZenohLink(self._config.output, {}, loop)
        pipeline = Pipeline(self._config, self._folder, self._on_pose)
        opened = asyncio.Event()

        def on_state(trouble: str | None) -> None:
            if trouble is None:
                opened.set()

        port = SerialPort(self._config.fog, pipeline.on_fog_bytes, on_state)
        drd_pty, bare_pty = PtyLink(self._config.fog.port, "fog.port"), PtyLink(f"{self._folder}/bare", "bare")
        drd_pty.open()
        bare_pty.open()
        task = asyncio.create_task(port.run())
        try:
            await asyncio.wait_for(opened.wait(), OPEN_TIMEOUT_S)
            with zenoh.open(isolated_config("peer", self._endpoints[1:], ())) as session:
                bare = _Bare(bare_pty.device, self._declare(session), self._payload_pair, self.published_ns[BARE_KEY])
                loop.add_reader(bare.fd, bare.on_readable)
                try:
                    await asyncio.to_thread(self._be_robot, loop, pipeline, drd_pty, bare_pty)
                finally:
                    loop.remove_reader(bare.fd)
                    os.close(bare.fd)
        finally:
            task.cancel()
            with suppress(asyncio.CancelledError):
                await task
            drd_pty.close()
            bare_pty.close()
            self._link.close()

    def _be_robot(
        self, loop: asyncio.AbstractEventLoop, pipeline: Pipeline, drd_pty: PtyLink, bare_pty: PtyLink
    ) -> None:
        """The world's side, in a thread: while it sleeps, the event loop waits in the kernel as a daemon's does."""
        with listening(self._endpoints, (DRD_KEY, BARE_KEY)) as listener:
            for _ in range(self._rounds):
                for pty, key in ((bare_pty, BARE_KEY), (drd_pty, DRD_KEY)):
                    loop.call_soon_threadsafe(self._turn_wheels, pipeline)
                    time.sleep(ROUND_S / 4)
                    packet = self._circle.fog_packet()
                    self.written_ns[key].append(time.monotonic_ns())
                    pty.write(packet)
                    time.sleep(ROUND_S / 4)
            self.heard_ns = listener.arrivals_ns()

    def _turn_wheels(self, pipeline: Pipeline) -> None:
        now_ns = time.monotonic_ns()
        pipeline.on_frames(self._circle.wheel_frames((now_ns - self._start_ns) * S_PER_NS, now_ns))

    def _on_pose(self, pose: Pose, _: int) -> None:
        wall_ns = time.time_ns() - (time.monotonic_ns() - pose.t_ns)
        self._link.publish_pose(pose, wall_ns)
        self.published_ns[DRD_KEY].append(time.monotonic_ns())
        if self._payloads is None:
            output = self._config.output
            odometry = OdometryEncoder(output.frame_id, output.child_frame_id).encode(pose, wall_ns)
            self._payloads = pose_json(pose, wall_ns), bytes(odometry)

    def _payload_pair(self) -> tuple[bytes, bytes] | None:
        return self._payloads

    def _declare(self, session: Any) -> tuple[Any, Any]:
        """Publishers as swift as the daemon's."""
        swift = {
            "priority": zenoh.Priority.REAL_TIME,
            "express": True,
            "congestion_control": zenoh.CongestionControl.DROP,
        }
        return session.declare_publisher(BARE_KEY, **swift), session.declare_publisher("bare/odom", **swift)


class _Bare:
    """The yardstick: read the packet, put two payloads as large as a pose's."""

    def __init__(
        self,
        device: str,
        publishers: tuple[Any, Any],
        payloads: Callable[[], tuple[bytes, bytes] | None],
        published_ns: list[int],
    ):
        self.fd = os.open(device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        self._publishers, self._payloads, self._published_ns = publishers, payloads, published_ns

    def on_readable(self) -> None:
        os.read(self.fd, 4096)
        payloads = self._payloads()
        if payloads is None:
            return
        for publisher, payload in zip(self._publishers, payloads, strict=True):
            publisher.put(payload)
        self._published_ns.append(time.monotonic_ns())


def latencies_us(written_ns: list[int], arrived_ns: list[int]) -> list[float]:
    """Time from each packet to the first arrival before the next packet, without the warm-up. Raises Refused."""
    first = round(len(written_ns) * WARM_UP_PART)
    found = []
    for sent_ns, next_ns in zip(written_ns[first:], [*written_ns[first + 1 :], written_ns[-1] + NS_PER_S], strict=True):
        i = bisect_left(arrived_ns, sent_ns)
        if i < len(arrived_ns) and arrived_ns[i] < next_ns:
            found.append((arrived_ns[i] - sent_ns) / 1e3)
    if len(found) < 0.9 * (len(written_ns) - first):
        raise Refused(f"latency: {len(found)} of {len(written_ns) - first} packets were answered")
    return found
