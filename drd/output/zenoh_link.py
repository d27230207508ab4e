"""The daemon's side of Zenoh: poses and health go out, queries come in."""

import asyncio
import logging
import resource
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any

import zenoh

from drd.config.keys import Output
from drd.config.schema import ConfigError
from drd.output.cdr import OdometryEncoder
from drd.output.exposure import exposure
from drd.output.messages import encode, pose_json
from drd.output.queries import Handler, QueryDesk
from drd.output.ros2_publishers import ODOMETRY, Ros2Publishers
from drd.output.session import limits, open_session, tidy
from drd.samples import Pose, WheelTurns

log = logging.getLogger(__name__)


class ZenohLink:
    """One session with its publishers, queryables and liveliness tokens, under `output.prefix`.

    Published: `pose` (JSON), `odom` (CDR nav_msgs/Odometry, the form the ROS 2 DDS bridge takes), `health` and
    `findings` (JSON), liveliness `alive`; with `ros2` also what Ros2Publishers has. Queryables: the names of `handlers`
    (pose, health, findings, config, set_pose, reset, calibrate_bias), each called in `loop` with the query's JSON
    object; it returns the answer or raises messages.Refused.

    Zenoh does not report which messages it dropped. `full_queues` counts the visible sign: puts that slept for as long
    as Zenoh waits for room in a neighbour's queue before it drops.

    The constructor opens the session (up to 0.5 s) and raises ConfigError. `close` must be called, not from a
    callback of Zenoh's. Publish from one thread only.
    """

    def __init__(self, output: Output, handlers: Mapping[str, Handler], loop: asyncio.AbstractEventLoop):
        self.counters = dict.fromkeys(("poses", "health", "findings", "put_errors", "full_queues"), 0)
        self._neighbours = 0
        self._encoder = OdometryEncoder(output.frame_id, output.child_frame_id)
        self._closing: threading.Thread | None = None
        self._closed_well = True
        self._session = open_session(output)
        self._limits = limits(output)
        for text in exposure(output):
            log.warning("zenoh: %s", text)
        self._desk = QueryDesk(handlers, output.commands, loop, self.counters)
        try:
            self._declare(output)
        except zenoh.ZError as error:
            self.close()
            raise ConfigError("configuration", "output.prefix", "a Zenoh key", tidy(error)) from error

    def _declare(self, output: Output) -> None:
        session, prefix = self._session, output.prefix
        # Not batched, before everything else, and never waiting for a slow reader: the next pose is worth more.
        swift = {
            "priority": zenoh.Priority.REAL_TIME,
            "express": True,
            "congestion_control": zenoh.CongestionControl.DROP,
        }
        json, cdr = zenoh.Encoding.APPLICATION_JSON, zenoh.Encoding.APPLICATION_CDR
        self._pose = session.declare_publisher(f"{prefix}/pose", encoding=json, **swift)
        odometry = cdr.with_schema(ODOMETRY)
        self._odom = session.declare_publisher(f"{prefix}/odom", encoding=odometry, **swift)
        patient = {"encoding": json, "congestion_control": zenoh.CongestionControl.DROP}
        self._health = session.declare_publisher(f"{prefix}/health", **patient)
        self._findings = session.declare_publisher(f"{prefix}/findings", **patient)
        self._ros2 = Ros2Publishers(session, output) if output.ros2 else None
        self._desk.declare(session, prefix, self._ros2.services if self._ros2 else ())
        tokens = [f"{prefix}/alive", *(self._ros2.tokens if self._ros2 else ())]
        self._tokens = [session.liveliness().declare_token(key) for key in tokens]

    @property
    def wants_turns(self) -> bool:
        """Whether `publish_turns` publishes anything."""
        return self._ros2 is not None and self._ros2.wants_turns

    def publish_pose(self, pose: Pose, wall_ns: int) -> None:
        """Publish the pose in all forms; `wall_ns` is CLOCK_REALTIME at `pose.t_ns`. Never raises for the network."""
        odometry = self._encoder.encode(pose, wall_ns)
        sent = self._tried(self._pose.put, pose_json(pose, wall_ns))
        sent &= self._tried(self._odom.put, odometry)
        if self._ros2 is not None:
            sent &= self._tried(self._ros2.publish_pose, pose, odometry, wall_ns)
        self.counters["poses"] += sent

    def publish_turns(self, turns: WheelTurns, wall_ns: int) -> None:
        """Publish the wheels' turns; `wall_ns` is CLOCK_REALTIME at `turns.t_ns`. Never raises for the network."""
        if self._ros2 is not None:
            self._tried(self._ros2.publish_turns, turns, wall_ns)

    def publish_health(self, payload: Mapping[str, Any]) -> None:
        """Publish the health as JSON. Never raises for the network."""
        sent = self._tried(self._health.put, encode(payload))
        if self._ros2 is not None:
            sent &= self._tried(self._ros2.publish_health, payload)
        self.counters["health"] += sent

    def publish_findings(self, payload: Mapping[str, Any]) -> None:
        """Publish the monitor's findings as JSON. Never raises for the network."""
        self.counters["findings"] += self._tried(self._findings.put, encode(payload))

    def neighbours(self) -> int:
        """Number of sessions connected now; 0 once closed.

        Zenoh does not report refused sessions, so the log says when the maximum is reached.
        """
        before = self._neighbours
        try:
            self._neighbours = len(self._session.info.transports())
        except zenoh.ZError:  # the session is closed
            self._neighbours = 0
        if before < self._limits.sessions <= self._neighbours:
            text = "zenoh: neighbours=%d, the maximum (output.max_sessions); more are refused"
            log.warning(text, self._neighbours)
        return self._neighbours

    def _tried(self, put: Callable[..., None], *arguments: Any) -> bool:
        before_ns, slept = time.monotonic_ns(), _times_slept()
        try:
            put(*arguments)
        except zenoh.ZError:
            self.counters["put_errors"] += 1
            return False
        took_ns = time.monotonic_ns() - before_ns
        self.counters["full_queues"] += took_ns >= self._limits.wait_ns and _times_slept() > slept
        return True

    def close(self, deadline_s: float = 3.0) -> bool:
        """Close the session; False if it did not end in time. May be called again.

        Zenoh's close can take seconds and has been seen to hang, so it runs in a thread that does not keep the
        interpreter alive. After False, leave with os._exit: an orderly exit could hang too.
        """
        if self._closing is None:
            self._desk.close()
            self._closing = threading.Thread(target=self._close_session, name="zenoh-close", daemon=True)
            self._closing.start()
        self._closing.join(deadline_s)
        return self._closed_well and not self._closing.is_alive()

    def _close_session(self) -> None:
        try:
            self._session.close()
        except zenoh.ZError as error:
            self._closed_well = False
            log.warning("zenoh: close failed: %s", tidy(error))
        self._desk.join()


def _times_slept() -> int:
    """Voluntary context switches of this thread: waiting for room causes one, being preempted does not."""
    return resource.getrusage(resource.RUSAGE_THREAD).ru_nvcsw
