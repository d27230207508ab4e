"""All checks of a robot, inside its virtual machine, as root: `python3 -m vm.guest NAME`."""

import json
import os
import sys
import time
import traceback
from collections.abc import Iterator
from typing import Any

from vm import cut, driving, rebooting, sandbox, standing
from vm.checks import CHECKS, Check, Seen, check
from vm.robot import CUT, GUEST_ADDRESS, PROGRAM, REBOOTING, SHARED, Robot, sh

__all__ = ["CHECKS", "driving", "rebooting", "sandbox", "standing"]  # with these the list is whole

# Where an installation or a service may leave something; the program's own folder is the user's to delete.
SEARCHED = ("/etc", "/run/systemd", "/usr/lib/systemd", "/usr/lib/udev", "/usr/local", "/var/lib", "/var/cache")
VERDICTS: dict[str, dict[str, Any]] = {}
BEFORE: set[str] = set()


def install(name: str) -> None:
    """What a user does once (README.md), then what is special here."""
    BEFORE.update(files())
    sh(f"{PROGRAM} install-service {name}{' --log-refused' if name == REBOOTING else ''}")
    sandbox.put()
    if name == REBOOTING:
        rebooting.put()
    # It reloads systemd, too, which takes seconds here.
    sh(f"systemctl enable drd@{name}")


@check("driving")
def uninstall_leaves_nothing(_: Robot) -> Seen:
    sh("rm -r /etc/systemd/system/drd@*.service.d")  # the tests' own drop-in
    said = sh(f"{PROGRAM} install-service --uninstall --purge")
    left = sorted(name for name in set(files()) - BEFORE if "drd" in name)
    assert not left, f"{left}; it said: {said}"
    assert not sh("systemctl list-units --all --no-legend 'drd@*'")
    return Seen(f"{len(said.splitlines())} lines; no new file of that name in {', '.join(SEARCHED)}")


def files() -> Iterator[str]:
    """All that there is where somebody might leave something."""
    for top in SEARCHED:
        for folder, folders, names in os.walk(top):
            yield from (f"{folder}/{name}" for name in (*folders, *names))


def attempt(name: str, one: Check, robot: Robot) -> None:
    """Make one check and keep its verdict."""
    began_s = time.monotonic()
    try:
        verdict = {"ok": True} | one.work(robot)._asdict()
    except Exception:
        status = sh(f"systemctl status --no-pager --lines=15 {robot.unit}", may_fail=True)
        known = f"{robot.reasons()}\n{robot.counters()}"
        verdict = {"ok": False} | Seen(f"{traceback.format_exc()}\n{status}\n{known}")._asdict()
    VERDICTS[name] = verdict | {"took_s": time.monotonic() - began_s}
    sys.stdout.write(f"{began_s:7.2f} {robot.name} {name} {VERDICTS[name]}\n")
    (SHARED / "results.json").write_text(json.dumps(VERDICTS))


def main(name: str) -> None:
    """Run all of that robot's, one after the other; one that fails does not end it. The verdicts go to the host."""
    # The hardware must not wait for the robot's computer, although here they share a processor. Not so what we start.
    os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(50))
    sh("modprobe vcan")
    if name != REBOOTING:  # User-mode Linux that boots again does not give its interface back to itself
        sh(f"ip address add {GUEST_ADDRESS}/24 dev vec0 && ip link set vec0 up")
    if name == CUT:
        cut.main()
        return
    results = SHARED / "results.json"
    if is_again := results.exists():
        VERDICTS.update(json.loads(results.read_text()))
    else:
        install(name)
    robot = Robot(name)
    for title, one in CHECKS.items():
        if title == rebooting.REBOOT and one.robot == name and not is_again:
            break  # the machine boots again then
        if one.robot == name and title not in VERDICTS:
            attempt(title, one, robot)
    robot.close()


if __name__ == "__main__":
    main(sys.argv[1])
