"""What is tried on the robot that stands: its process, its memory and its disk. In this order."""

import os
import signal
import subprocess
import time
from pathlib import Path
from typing import Final

from vm.checks import Seen, check, noticed, undisturbed
from vm.robot import Robot, sh, until

RESTART_S: Final = 2.0  # RestartSec= of the unit


@check("standing", recover_s=50)
def ready_only_when_it_is(robot: Robot) -> Seen:
    robot.gyro(on=True)
    began_s = time.monotonic()
    starting = subprocess.Popen(["systemctl", "start", robot.unit])
    states = []
    while starting.poll() is None:
        states.append(robot.show("ActiveState"))
        time.sleep(0.2)
    took_s = time.monotonic() - began_s
    assert (starting.returncode, robot.is_active()) == (0, True)
    assert set(states[:-1]) <= {"inactive", "activating"}, states
    health = robot.get("health")
    assert health is not None, "no answer right after READY"
    return Seen(f"until then activating, then an answer at once: {health['validity']}", None, took_s)


@check("standing", notice_s=18, recover_s=54)
def hung_loop_is_killed_by_the_watchdog(robot: Robot) -> Seen:
    return killed(robot, signal.SIGSTOP, "watchdog")


@check("standing", notice_s=4, recover_s=45)
def sigkill(robot: Robot) -> Seen:
    return killed(robot, signal.SIGKILL, "signal")


def killed(robot: Robot, number: signal.Signals, result: str) -> Seen:
    """End the process that way: systemd notices, says why, and starts it again."""
    pid = robot.pid()
    began_s = time.monotonic()
    os.kill(pid, number)
    until("the process is gone", lambda: not Path(f"/proc/{pid}").exists(), 40)
    gone_s = time.monotonic()
    until("poses again", lambda: robot.since(gone_s), 60)
    return Seen(*noticed(robot, began_s, f"Failed with result '{result}'"), time.monotonic() - began_s)


@check("standing", notice_s=9, recover_s=45)
def out_of_memory(robot: Robot) -> Seen:
    began_s = time.monotonic()
    sh(f"systemctl set-property --runtime {robot.unit} MemoryMax=25M")
    until("killed", lambda: not robot.is_active(), 30)
    lifted_s = time.monotonic()
    sh(f"systemctl set-property --runtime {robot.unit} MemoryMax=512M")
    until("poses again", lambda: robot.since(lifted_s), 60)
    recovered_s = time.monotonic() - lifted_s
    return Seen(*noticed(robot, began_s, "killed by the OOM killer"), recovered_s)


@check("standing", recover_s=14)
def sigterm(robot: Robot) -> Seen:
    """The daemon ends by itself, with success, and is not started again."""
    os.kill(robot.pid(), signal.SIGTERM)
    took_s = until("inactive", lambda: robot.show("ActiveState") == "inactive", 24)
    assert (robot.show("Result"), robot.show("ExecMainStatus")) == ("success", "0")
    time.sleep(2.0)  # Poses that were on the way when it ended may still be delivered.
    silent_s = time.monotonic()
    time.sleep(RESTART_S + 1.0)
    assert not robot.since(silent_s)
    assert robot.show("ActiveState") == "inactive"
    return Seen("exit status 0", None, took_s)


@check("standing", notice_s=36)
def spoilt_state_is_refused_and_kept(robot: Robot) -> Seen:
    """The daemon starts cold then, and says so; its state directory is an ext4 of 8 MB from here on."""
    state = state_directory(robot)
    sh(f"rm -rf {state} && mkdir -m 0700 {state} && mount /dev/ubdb {state}")
    (state / "standing.state").write_text("drd-state/99 sha256=0\n{}\n")
    began_s = time.monotonic()
    assert robot.systemctl("start").returncode == 0
    line, noticed_s = noticed(robot, began_s, "standing.state")
    assert (state / "standing.state.refused-1").exists(), line
    until("well", robot.is_well, 30)
    return Seen(line, noticed_s)


@check("standing", notice_s=14, recover_s=27)
def full_disk(robot: Robot) -> Seen:
    ballast = state_directory(robot) / "ballast"
    with undisturbed(robot):
        began_s = time.monotonic()
        sh(f"head --bytes=20M /dev/zero >{ballast}", may_fail=True)
        until("STATUS says so", lambda: "No space left" in robot.show("StatusText"), 30)
        noticed_s, status = time.monotonic() - began_s, robot.show("StatusText")
        ballast.unlink()
        mended_s = time.monotonic()
        until("it writes again", lambda: "No space left" not in robot.show("StatusText"), 40)
    return Seen(status, noticed_s, time.monotonic() - mended_s)


@check("standing", notice_s=18)
def read_only_state_directory(robot: Robot) -> Seen:
    """As after an error of the medium: ext4 refuses every write from then on."""
    state = state_directory(robot)
    with undisturbed(robot):
        began_s = time.monotonic()
        sh(f"mount -o remount,abort {state}", may_fail=True)
        until("STATUS says so", lambda: "Read-only" in robot.show("StatusText"), 30)
        noticed_s, status = time.monotonic() - began_s, robot.show("StatusText")
        time.sleep(1.0)
    assert robot.systemctl("stop").returncode == 0
    assert robot.show("Result") == "success"
    sh(f"umount {state}")
    return Seen(f"{status}; stops cleanly all the same", noticed_s)


@check("standing")
def a_configuration_that_is_wrong_is_never_ready(robot: Robot) -> Seen:
    robot.configure(robot={"wheel_radius_m": -0.1})
    began_s = time.monotonic()
    assert robot.systemctl("start").returncode != 0
    line, _ = noticed(robot, began_s, "wheel_radius_m")
    assert not robot.is_active()
    robot.systemctl("stop")
    return Seen(line)


def state_directory(robot: Robot) -> Path:
    return Path(f"/var/lib/private/drd-{robot.name}")
