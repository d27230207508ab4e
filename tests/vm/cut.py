"""In the machine whose power will be cut: its disk, its robot and the daemon, until the end comes."""

import json
import sys
import threading
from pathlib import Path
from typing import Final

from vm import volatile_disk
from vm.robot import CUT, DISK, PROGRAM, SHARED, Robot, sh, until

# Where systemd keeps a DynamicUser's state.
STATE: Final = Path(f"/var/lib/private/drd-{CUT}")
DISK_BYTES: Final = 64 << 20
# So small that recordings are deleted, too.
RECORDING: Final = {"enabled": True, "max_total_mb": 4}
# A robot with a clock chip, which User-mode Linux has not: the daemon only looks whether there is one.
DROP_IN: Final = Path(f"/etc/systemd/system/drd@{CUT}.service.d/clock.conf")
CLOCK_CHIP: Final = """\
[Service]
TemporaryFileSystem=/sys/class
BindReadOnlyPaths=/opt:/sys/class/rtc
"""
# It appears when the daemon is about to be started.
STARTED: Final = "started"
# The first pose.
RESUMED: Final = "resumed.json"


def main() -> None:
    """The first time, install only. Then go on from what the disk holds, and never return."""
    if not STATE.exists():
        sh(f"{PROGRAM} install-service {CUT} && mkdir -p -m 0700 {STATE} {DROP_IN.parent}")
        DROP_IN.write_text(CLOCK_CHIP)
        sh("sync")
        return
    sh("modprobe nbd nbds_max=1 max_part=0")
    threading.Thread(target=volatile_disk.connect, args=(DISK, DISK_BYTES), daemon=True).start()
    until("the disk is there", lambda: sh("blockdev --getsize64 /dev/nbd0") == str(DISK_BYTES), 10, 0.02)
    sh(f"mount /dev/nbd0 {STATE}")
    robot = Robot(CUT)
    robot.configure(recording=RECORDING)
    robot.gyro(on=True)
    (SHARED / STARTED).touch()
    sys.stdout.write(f"{robot.systemctl('start')}\n")
    sys.stdout.flush()
    until("a pose", lambda: robot.poses, 60)
    # After so long a time unseen on the move the pose is worth nothing, until somebody says where the robot is.
    first = robot.poses[0][1]
    (SHARED / RESUMED).write_text(json.dumps(first))
    pose = {key: first[key] for key in ("x_m", "y_m", "heading_rad")}
    sys.stdout.write(f"{robot.get('set_pose', pose)}\n")
    sys.stdout.flush()
    threading.Event().wait()
