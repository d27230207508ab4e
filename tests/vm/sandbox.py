"""The unit's sandbox, seen by a program that runs in the place of the daemon, as `drd@probe`."""

import json
import shutil
from pathlib import Path
from typing import Final

from vm.checks import Seen, check
from vm.robot import PROGRAM as DRD
from vm.robot import REBOOTING, Robot, sh, until

UNIT: Final = "drd@probe.service"
PROGRAM: Final = Path("/opt/probe.py")
DROP_IN: Final = f"""\
[Service]
Type=exec
WatchdogSec=0
Restart=no
ExecStart=
ExecStart=/opt/drd/bin/python3 {PROGRAM}
"""


def put() -> None:
    """Prepare the instance; systemd must be reloaded after that."""
    shutil.copy(Path(__file__).with_name("probe.py"), PROGRAM)
    PROGRAM.chmod(0o644)
    folder = Path(f"/etc/systemd/system/{UNIT}.d")
    folder.mkdir()
    (folder / "test.conf").write_text(DROP_IN)


@check("driving")
def the_sandbox_holds(_: Robot) -> Seen:
    found = probed()
    own = [error or "changed" for name, error in found.items() if name.startswith("change ")]
    assert len(own) == 5, found
    assert not any("No such file" in error for error in own), found
    allowed = {name for name, error in found.items() if error is None}
    assert allowed == {"write state", "write /tmp", "AF_CAN", "AF_INET", "open /dev/ttyS0"}, found
    return Seen(f"allowed: {', '.join(sorted(allowed))}; refused: {len(found) - len(allowed)} others")


@check(REBOOTING)
def a_refused_system_call_is_logged_by_name(_: Robot) -> Seen:
    """As the page of `drd refused` says; systemd took the setting at this boot."""
    before = sh(f"{DRD} refused").splitlines()
    probed()
    said = [line for line in sh(f"{DRD} refused").splitlines() if line not in before]
    names = {line.partition(":")[0] for line in said}
    assert {"clock_settime", "sched_setscheduler"} <= names, said
    return Seen(f"{', '.join(sorted(names))}; of the daemon itself: {'; '.join(before)}")


def probed() -> dict[str, str | None]:
    """Run the probe in the daemon's place: what it tried and why each failed, None where it did not."""
    sh(f"systemctl start {UNIT}")
    until("it is done", lambda: sh(f"systemctl is-active {UNIT}", may_fail=True) in {"inactive", "failed"}, 40)
    said = sh(f"journalctl --boot --no-pager --output=cat --unit={UNIT}")
    lines = [line for line in said.splitlines() if line.startswith("{")]
    assert lines, said
    sh(f"systemctl clean --what=state {UNIT}")
    found: dict[str, str | None] = json.loads(lines[0])
    return found
