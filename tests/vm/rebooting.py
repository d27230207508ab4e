"""What is tried on the robot whose computer is booted twice: reboot, TLS and access control, upgrade. In this order.

drd-test.service ends before the second boot; the checks go on behind `REBOOT` then.
"""

import json
import re
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import yaml
import zenoh
from vm.checks import Seen, check
from vm.robot import PROGRAM, REBOOTING, SHARED, Robot, sh, until

import drd
from drd.state import memory_file, saved
from drd_tools.recordings.mcap_file import open_mcap

CONFIG: Final = Path(drd.__file__).parent / "data/config"
GOLDEN: Final = SHARED / "golden"
TLS: Final = Path("/etc/drd/tls")
# Where the robot stands, m and rad; a dock of its own would be the origin.
STANDS: Final = {"x_m": 3.0, "y_m": -4.0, "heading_rad": 1.0}
DROP_IN: Final = Path("/etc/systemd/system/drd-test.service.d/reboot.conf")
# The first boot's last check stands before this one.
REBOOT: Final = "the_daemon_comes_up_by_itself_and_goes_on"


def put() -> None:
    """Have the end of the first boot's checks be a reboot in good order; systemd must be reloaded after that."""
    DROP_IN.parent.mkdir()
    DROP_IN.write_text("[Unit]\nSuccessAction=reboot\n")


@check(REBOOTING)
def a_pose_is_known_before_the_reboot(robot: Robot) -> Seen:
    robot.gyro(on=True)
    assert robot.systemctl("start").returncode == 0
    until("well", robot.is_well, 60)
    answer = robot.get("set_pose", STANDS)
    assert answer is not None, "no answer"
    assert "error" not in answer, answer
    until("it is there", lambda: abs(robot.poses[-1][1]["x_m"] - STANDS["x_m"]) < 0.1, 10)
    return Seen(f"{answer}")


@check(REBOOTING)
def the_daemon_comes_up_by_itself_and_goes_on(robot: Robot) -> Seen:
    """Nobody starts it; a reboot without a clock chip leaves the time off unknown, which the sentence says."""
    DROP_IN.unlink()
    sh("systemctl daemon-reload")
    robot.gyro(on=True)
    until("active", robot.is_active, 60)
    until("poses", lambda: robot.poses, 60)
    pose = robot.poses[-1][1]
    moved_m = max(abs(pose[key] - STANDS[key]) for key in ("x_m", "y_m", "heading_rad"))
    assert moved_m < 0.05, pose
    line = next(line for _, line in robot.journal() if "start=" in line)
    assert re.search("start=warm restart .* where it stood", line), line
    return Seen(line)


@check(REBOOTING)
def the_state_is_the_former_boots(robot: Robot) -> Seen:
    health = robot.get("health")
    assert health is not None, "no answer"
    assert (health["state"]["start"]["kind"], health["state"]["refused"]) == ("warm", 0), health
    first, second = map(open_mcap, sorted(Path(f"/var/lib/private/drd-{REBOOTING}/recordings").iterdir()))
    assert (first.end or {}).get("reason") == "stopped", first.end
    return Seen(f"{first.sentence()}; {second.sentence()}")


# ---- TLS -------------------------------------------------------------------------------------------------------------


@check(REBOOTING)
def tls_lets_in_whom_the_authority_knows(robot: Robot) -> Seen:
    """The shipped files and commands, the key readable by root only."""
    TLS.mkdir()
    for name in ("zenoh-tls.json5", "stranger"):
        text = (CONFIG / "zenoh-tls.json5").read_text()
        commands = re.findall(r"^// +(openssl .*)$", text, re.MULTILINE)
        for command in commands if name != "stranger" else [commands[2].replace("reader", name)]:
            sh(f"cd {TLS} && {command}")
    sh(f"chmod 0600 {TLS}/*.key && {PROGRAM} install-service {REBOOTING} --tls && systemctl daemon-reload")
    robot.configure(output={"zenoh_config": f"{REBOOTING}-tls.json5", "commands": True, "listen": []})
    done = robot.systemctl("restart")
    assert done.returncode == 0, f"{done} {robot.journal()[-5:]}"
    answers = {}
    for name in ("reader", "operator", "stranger"):
        with client(name) as session:
            answers[name] = [bool(ask(session, key)) for key in ("pose", "reset")]
    assert answers == {"reader": [True, False], "operator": [True, True], "stranger": [False, False]}, answers
    return Seen(f"answers to pose and reset: {answers}")


@check(REBOOTING)
def tls_lets_nobody_else_in(robot: Robot) -> Seen:
    sh(f"cd {TLS} && openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -subj /CN=operator "
       "-keyout forged.key -out forged.crt")  # fmt: skip
    refused = []
    for name, protocol in (("forged", "tls"), ("reader", "tcp")):
        try:
            with client(name, protocol):
                pass
        except zenoh.ZError as error:
            refused.append(str(error)[:60])
    assert len(refused) == 2, refused
    with client("reader") as session:
        assert ask(session, "pose"), "the right one still is"
    key = Path(f"/proc/{robot.pid()}/root/run/credentials/{robot.unit}/robot.key")
    return Seen(f"{'; '.join(refused)}; the service's copy of the key has mode {key.stat().st_mode & 0o777:o}")


@contextmanager
def client(name: str, protocol: str = "tls") -> Iterator[Any]:
    """The shipped client's file with the certificate of `name`. Raises ZError where it is not let in."""
    text = (CONFIG / "zenoh-tls-client.json5").read_text().replace("reader.", f"{name}.")
    text = text.replace("tls/localhost", f"{protocol}/127.0.0.1").replace('["tls"]', f'["{protocol}"]')
    file = TLS / "client.json5"
    file.write_text(re.sub(r'"([a-z]+\.(?:key|crt))"', rf'"{TLS}/\1"', text))
    with zenoh.open(zenoh.Config.from_file(file)) as session:
        yield session


def ask(session: Any, key: str) -> list[str]:
    return [reply.ok.payload.to_string() for reply in session.get(f"drd/{key}", payload=b"{}", timeout=3.0) if reply.ok]


# ---- upgrade ---------------------------------------------------------------------------------------------------------


@check(REBOOTING)
def an_upgrade_goes_on_with_the_files_of_each_version_before(robot: Robot) -> Seen:
    robot.systemctl("stop")
    return Seen("; ".join(upgraded(expected.parent) for expected in sorted(GOLDEN.glob("*/expected.json"))))


def upgraded(golden: Path) -> str:
    """Put a version's files where it had them, start today's daemon, and look at what became of them."""
    state = Path("/var/lib/private/drd-golden")
    shutil.rmtree(state, ignore_errors=True)
    (records := state / "records").mkdir(parents=True)
    shutil.copy(golden / "calibration.yaml", "/etc/drd")
    # The monitor was off, and its memory would stay unread.
    values = yaml.safe_load((golden / "robot.yaml").read_text()) | {"monitor": {"enabled": True}}
    Path("/etc/drd/golden.yaml").write_text(yaml.safe_dump(values))
    for name in ("golden.state", "golden.memory"):
        shutil.copy(golden / name, state)
    shutil.copy(golden / "run.mcap", records / "golden-20260101T000000Z-00000000-0001.mcap")
    sh(f"chmod -R go-rwx {state}")
    before = saved.decoded((golden / "golden.state").read_bytes())
    sh("systemctl start drd@golden")
    said = sh("journalctl --boot --no-pager --output=cat --unit=drd@golden")
    time.sleep(3.0)
    sh("systemctl stop drd@golden")
    assert "start=warm restart" in said, said
    assert "refused" not in said, said
    after = saved.decoded((state / "golden.state").read_bytes())
    assert after.estimate.nominal.x_m == before.estimate.nominal.x_m
    days = [len(memory_file.decoded((folder / "golden.memory").read_bytes()).days) for folder in (golden, state)]
    assert days[0] <= days[1], days
    assert not list(state.glob("*refused*"))
    files = sorted(records.glob("*.mcap"))
    assert len(files) == 2, files
    messages = json.loads((golden / "expected.json").read_text())["messages"]
    assert sum(1 for _ in open_mcap(files[0]).messages()) == sum(messages.values())
    start = next(line for line in said.splitlines() if "start=" in line)
    return f"{golden.name}: {start}"
