"""What is tried on the robot that drives: its hardware, its clock, its configuration. In this order."""

import datetime
import math
import re
import time
from collections.abc import Callable
from typing import Any

from vm.checks import Seen, check, noticed, undisturbed
from vm.robot import Robot, sh, steps, until

HOURS = 3


@check("driving", notice_s=36, recover_s=18)
def gyro_unplugged_at_the_start(robot: Robot) -> Seen:
    began_s = time.monotonic()
    sh(f"systemctl start {robot.unit}")
    took_s = time.monotonic() - began_s
    assert robot.is_active()
    until("STATUS names the port", lambda: str(robot.port) in robot.show("StatusText"), 10)
    noticed_s, status = time.monotonic() - began_s, robot.show("StatusText")
    robot.gyro(on=True)
    recovered_s = until("the gyro is heard", robot.hears_gyro, 30, 0.1)
    return Seen(f"READY after {took_s:.1f} s; STATUS: {status}", noticed_s, recovered_s)


@check("driving")
def both_nodes_are_seen_by_candump(robot: Robot) -> Seen:
    lines = sh(f"timeout 15 candump -n 60 {robot.bus}").splitlines()
    counted = {can_id: sum(f" {can_id} " in line for line in lines) for can_id in ("080", "281", "282")}
    assert min(counted.values()) >= 10, counted
    return Seen(f"60 frames: {counted}")


@check("driving")
def poses_inside_are_valid_and_come_at_20_hz(robot: Robot) -> Seen:
    until("well", robot.is_well, 60)
    until("driving", lambda: robot.poses[-1][1]["speed_m_s"] > 0.5, 60)
    began_s = time.monotonic()
    with undisturbed(robot):
        time.sleep(4.0)
    poses = robot.since(began_s)
    rate_hz, valid = len(poses) / (time.monotonic() - began_s), sum(p["validity"] == "valid" for p in poses)
    assert 12 < rate_hz < 23, rate_hz  # 20 where the processor is not late
    assert valid > 0
    return Seen(f"{rate_hz:.1f} Hz, {valid} of {len(poses)} valid; error and bound {error(robot)}")


@check("driving")
def the_status_is_a_sentence(robot: Robot) -> Seen:
    time.sleep(1.2)  # STATUS comes with the health, once a second
    status = robot.show("StatusText")
    assert re.fullmatch(r"valid.*|degraded: agreement: .*", status), status
    return Seen(status)


@check("driving", recover_s=7)
def reload_takes_a_new_configuration(robot: Robot) -> Seen:
    with undisturbed(robot):
        robot.configure(robot={"max_speed_m_s": 4.0})
        began_s = time.monotonic()
        done = robot.systemctl("reload")
        assert done.returncode == 0, done
        until("it is in force", lambda: in_force(robot) == 4.0, 10)
        recovered_s = time.monotonic() - began_s
        time.sleep(1.0)
    return Seen(f"robot.max_speed_m_s: 4; error and bound {error(robot)}", None, recovered_s)


@check("driving", notice_s=7)
def reload_refuses_a_bad_configuration(robot: Robot) -> Seen:
    with undisturbed(robot):
        robot.configure(robot={"max_speed_m_s": 5.0, "wheel_radius_m": -0.1})
        began_s = time.monotonic()
        robot.systemctl("reload")
        try:
            until("STATUS says so", lambda: "wheel_radius_m" in robot.show("StatusText"), 10)
            noticed_s, status = time.monotonic() - began_s, robot.show("StatusText")
            assert in_force(robot) == 4.0
        finally:
            robot.configure()
        assert robot.systemctl("reload").returncode == 0
        until("STATUS is as before", lambda: "refused" not in robot.show("StatusText"), 10)
    return Seen(status, noticed_s)


def in_force(robot: Robot) -> Any:
    answer = robot.get("config")
    return answer and answer["config"]["robot"]["max_speed_m_s"]


@check("driving", recover_s=4)
def clock_stepped_by_hours(robot: Robot) -> Seen:
    took_s = []
    with undisturbed(robot):
        for hours in (HOURS, -HOURS):
            time.sleep(1.0)
            step_s = datetime.timedelta(hours=hours).total_seconds()
            time.clock_settime(time.CLOCK_REALTIME, time.clock_gettime(time.CLOCK_REALTIME) + step_s)
            took_s.append(until("wall_ns follows", lambda: abs(wall_error_s(robot)) < 0.05, 5, 0.02))
            time.sleep(2.0)
    return Seen(f"{HOURS:+} h and back: poses valid throughout", None, max(took_s))


def wall_error_s(robot: Robot) -> float:
    """How far the newest pose's two times lie from each other, beyond the clocks' own distance."""
    pose = robot.poses[-1][1]
    distance_ns = pose["wall_ns"] - pose["monotonic_ns"]
    return float(distance_ns - (time.time_ns() - time.monotonic_ns())) * 1e-9


@check("driving", notice_s=7, recover_s=18)
def gyro_unplugged_while_driving(robot: Robot) -> Seen:
    return interrupted(robot, lambda: robot.gyro(on=False), lambda: robot.gyro(on=True), "fog")


@check("driving", notice_s=4, recover_s=14)
def can_interface_down(robot: Robot) -> Seen:
    down, up = (f"ip link set {robot.bus} {state}" for state in ("down", "up"))
    return interrupted(robot, lambda: sh(down), lambda: sh(up), robot.bus)


@check("driving", notice_s=5, recover_s=14)
def can_interface_deleted_and_made_again(robot: Robot) -> Seen:
    def again() -> None:
        robot.make_bus()
        robot.emulator.unplug_can()
        robot.emulator.replug_can()

    return interrupted(robot, lambda: sh(f"ip link delete {robot.bus}"), again, robot.bus)


@check("driving", notice_s=4, recover_s=14)
def bus_off(robot: Robot) -> Seen:
    """A virtual bus has no bus-off of its own: the controller's two error frames are sent on it (linux/can/error.h)."""

    def cut() -> None:
        robot.emulator.wheels_silent = True
        sh(f"cansend {robot.bus} 20000040#0000000000000000")

    def mend() -> None:
        sh(f"cansend {robot.bus} 20000100#0000000000000000")
        robot.emulator.wheels_silent = False

    return interrupted(robot, cut, mend, "bus-off")


def interrupted(robot: Robot, cut: Callable[[], Any], mend: Callable[[], Any], word: str) -> Seen:
    """Break something for two seconds: it is named, the daemon stays, the pose comes back without a jump."""
    pid = robot.pid()
    began_s = time.monotonic()
    cut()
    until("the health names it", lambda: word in robot.reasons(), 16, 0.1)
    noticed_s, reasons = time.monotonic() - began_s, robot.reasons()
    time.sleep(max(0.0, 2.0 - noticed_s))
    mended_s = time.monotonic()
    mend()
    until("well again", lambda: robot.since(mended_s) and robot.is_well(), 30, 0.02)
    recovered_s = time.monotonic() - mended_s
    time.sleep(0.5)
    _, excess_m = steps(robot.since(began_s - 1))
    assert excess_m == 0, f"a step of {excess_m:.2f} m beyond the top speed"
    assert robot.pid() == pid, "the daemon was restarted"
    return Seen(reasons, noticed_s, recovered_s)


@check("driving")
def the_truth_is_within_the_bound(robot: Robot) -> Seen:
    """After all of the above."""
    return Seen(f"error and bound {error(robot)}")


@check("driving", recover_s=36)
def warm_restart_goes_on_from_the_pose(robot: Robot) -> Seen:
    before = robot.poses[-1][1]
    pid = robot.pid()
    began_s = time.monotonic()
    done = robot.systemctl("restart")
    assert done.returncode == 0, done
    assert robot.pid() not in {0, pid}
    until("poses again", lambda: robot.poses[-1][1]["sequence"] < before["sequence"], 40)
    recovered_s = time.monotonic() - began_s
    after = robot.poses[-1][1]
    assert after["position_bound_99_m"] > before["position_bound_99_m"]
    line, _ = noticed(robot, began_s, "start=warm restart")
    time.sleep(2.0)
    return Seen(f"error and bound {error(robot)}; {line}", None, recovered_s)


def error(robot: Robot) -> str:
    """Distance of a recent pose from the truth, and its bound. Raises AssertionError where it is beyond."""
    time.sleep(0.3)
    pose = robot.poses[-3][1]
    x_m, y_m = robot.truth(pose["monotonic_ns"])
    error_m, bound_m = math.hypot(pose["x_m"] - x_m, pose["y_m"] - y_m), pose["position_bound_99_m"]
    # In UML a frame may be stamped a moment late, and the robot drives on meanwhile.
    late_m = 0.2 * abs(pose["speed_m_s"])
    assert error_m <= bound_m + late_m, f"error {error_m:.2f} m beyond the bound of {bound_m:.2f} m: {pose}"
    return f"{error_m:.2f} m, {bound_m:.2f} m"


@check("driving", recover_s=14)
def stop_is_clean(robot: Robot) -> Seen:
    began_s = time.monotonic()
    done = robot.systemctl("stop")
    took_s = time.monotonic() - began_s
    result = {name: robot.show(name) for name in ("ActiveState", "Result", "ExecMainStatus", "NRestarts")}
    expected = {"ActiveState": "inactive", "Result": "success", "ExecMainStatus": "0", "NRestarts": "0"}
    assert result == expected, f"{result} {done}"
    assert not any("Traceback" in line for _, line in robot.journal())
    return Seen("no traceback in the whole run", None, took_s)
