"""Conversion of the daemon's Zenoh messages to ROS 2 messages in CDR, which does not need ROS 2."""

import json
import math
from collections.abc import Mapping

from drd.output.cdr import CdrReader, ImuEncoder, OdometryEncoder, TransformEncoder, encode_diagnostics
from drd.output.diagnostics import diagnostics
from drd.samples import Pose, Validity


class Messages:
    """CDR by topic: odom, tf, imu and diagnostics. Empty frames: the daemon's own."""

    def __init__(self, frame_id: str = "", child_frame_id: str = ""):
        self._wanted = (frame_id, child_frame_id)
        self.frame_id = frame_id
        self._frames: tuple[str, str] | None = None
        self._odometry: OdometryEncoder | None = None

    def of_odometry(self, data: bytes) -> Mapping[str, bytes]:
        """Convert a message of `drd/odom`, which is passed on unchanged if its frames are. Raises ValueError."""
        wall_ns, frame_id, child_frame_id, pose = _pose(data)
        self._use((frame_id, child_frame_id))
        return {
            "odom": data if self._odometry is None else self._odometry.encode(pose, wall_ns),
            "tf": self._transform.encode(pose, wall_ns),
            "imu": self._imu.encode(pose, wall_ns),
        }

    def of_health(self, data: bytes) -> Mapping[str, bytes]:
        """Convert a message of `drd/health`. Raises ValueError."""
        health = json.loads(data)
        try:
            return {"diagnostics": encode_diagnostics(diagnostics(health), health["wall_ns"])}
        except (KeyError, TypeError) as error:
            raise ValueError(f"no health: {error!r}") from error

    def _use(self, frames: tuple[str, str]) -> None:
        """Make the encoders for the daemon's frames, and again if it restarts with others."""
        if frames == self._frames:
            return
        self._frames = frames
        used = (self._wanted[0] or frames[0], self._wanted[1] or frames[1])
        self.frame_id = used[0]
        self._odometry = None if used == frames else OdometryEncoder(*used)
        self._transform, self._imu = TransformEncoder(*used), ImuEncoder(used[1])


def _pose(data: bytes) -> tuple[int, str, str, Pose]:
    """Stamp in ns, both frames and the pose of drd's nav_msgs/Odometry."""
    reader = CdrReader(data)
    wall_ns, frame_id = reader.header()
    child_frame_id = reader.text()
    values = reader.doubles(85)
    c, twist, r = values[7:43], values[43:49], values[49:]
    heading_rad = 2 * math.atan2(values[5], values[6])
    covariance = (c[0], c[1], c[5], c[7], c[11], c[35])
    pose = Pose(
        t_ns=wall_ns,
        sequence=0,
        x_m=values[0],
        y_m=values[1],
        heading_rad=heading_rad,
        speed_m_s=twist[0],
        rate_rad_s=twist[5],
        speed_sigma_m_s=math.sqrt(max(r[0], 0.0)),
        rate_sigma_rad_s=math.sqrt(max(r[35], 0.0)),
        covariance=covariance,
        position_bound_m=math.nan,
        validity=Validity.VALID,
        reasons=(),
    )
    return wall_ns, frame_id, child_frame_id, pose
