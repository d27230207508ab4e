"""The daemon's side of Zenoh: poses and health go out, queries come in."""

import asyncio
import logging
import threading
from collections.abc import Mapping
from typing import Any

import zenoh

from drd.config.keys import Output
from drd.config.schema import ConfigError
from drd.output import ros2
from drd.output.cdr import OdometryEncoder
from drd.output.exposure import exposure
from drd.output.messages import health_json, pose_json
from drd.output.queries import Handler, QueryDesk
from drd.output.session import open_session, tidy
from drd.samples import Pose

log = logging.getLogger(__name__)


class ZenohLink:
    """One session with its publishers, queryables and liveliness tokens, under `output.prefix`.

    Published: `pose` (JSON), `odom` (CDR nav_msgs/Odometry, the form the ROS 2 DDS bridge takes), `health` (JSON),
    liveliness `alive`; with `ros2` also rmw_zenoh's own key. Queryables: the names of `handlers` (pose, health,
    config, set_pose, reset, calibrate_bias), each called in `loop` with the query's JSON object; it returns the
    answer or raises messages.Refused.

    The constructor opens the session (up to 0.5 s) and raises ConfigError. `close` must be called, not from a
    callback of Zenoh's. Publish from one thread only.
    """

    def __init__(self, output: Output, handlers: Mapping[str, Handler], loop: asyncio.AbstractEventLoop):
        self.counters = dict.fromkeys(("poses", "health", "put_errors"), 0)
        self._encoder = OdometryEncoder(output.frame_id, output.child_frame_id)
        self._ros2: Any = None
        self._ros2_sequence = 0
        self._closing: threading.Thread | None = None
        self._closed_well = True
        self._session = open_session(output)
        for text in exposure(output):
            log.warning("zenoh: %s", text)
        topic = ros2.topic_name(output.ros2_topic)
        assert topic is not None  # open_session has checked it
        self._desk = QueryDesk(handlers, output.commands, loop, self.counters)
        try:
            self._declare(output, topic)
        except zenoh.ZError as error:
            self.close()
            raise ConfigError("configuration", "output.prefix", "a Zenoh key", tidy(error)) from error

    def _declare(self, output: Output, topic: str) -> None:
        session, prefix = self._session, output.prefix
        # Not batched, ahead of everything else, and never waiting for a slow reader: the next pose is worth more.
        swift = {
            "priority": zenoh.Priority.REAL_TIME,
            "express": True,
            "congestion_control": zenoh.CongestionControl.DROP,
        }
        json, cdr = zenoh.Encoding.APPLICATION_JSON, zenoh.Encoding.APPLICATION_CDR
        self._pose = session.declare_publisher(f"{prefix}/pose", encoding=json, **swift)
        odometry = cdr.with_schema("nav_msgs/msg/Odometry")
        self._odom = session.declare_publisher(f"{prefix}/odom", encoding=odometry, **swift)
        self._health = session.declare_publisher(
            f"{prefix}/health", encoding=json, congestion_control=zenoh.CongestionControl.DROP
        )
        if output.ros2:
            type_hash = ros2.ODOMETRY_HASH if output.ros2_hash else ros2.HUMBLE_HASH
            names = ros2.Ros2Odometry(output.ros2_domain, topic, type_hash, str(session.zid()))
            self._gid = names.gid
            self._ros2 = session.declare_publisher(names.key, encoding=odometry, **swift)
        self._desk.declare(session, prefix)
        tokens = [f"{prefix}/alive"] + ([names.node_token, names.publisher_token] if output.ros2 else [])
        self._tokens = [session.liveliness().declare_token(key) for key in tokens]

    def publish_pose(self, pose: Pose, wall_ns: int) -> None:
        """The pose in all its forms; `wall_ns` is CLOCK_REALTIME at `pose.t_ns`. Never raises for the network."""
        odometry = self._encoder.encode(pose, wall_ns)
        sent = self._put(self._pose, pose_json(pose, wall_ns))
        sent &= self._put(self._odom, odometry)
        if self._ros2 is not None:
            self._ros2_sequence += 1
            sent &= self._put(self._ros2, odometry, ros2.attachment(self._ros2_sequence, wall_ns, self._gid))
        self.counters["poses"] += sent

    def publish_health(self, payload: Mapping[str, Any]) -> None:
        """The health as JSON. Never raises for the network."""
        self.counters["health"] += self._put(self._health, health_json(payload))

    def _put(self, publisher: Any, payload: bytes, attachment: bytes | None = None) -> bool:
        try:
            publisher.put(payload, attachment=attachment)
        except zenoh.ZError:
            self.counters["put_errors"] += 1
            return False
        return True

    def close(self, deadline_s: float = 3.0) -> bool:
        """Close the session; False where it did not end in time. May be called again.

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
