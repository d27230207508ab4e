"""`drd refused`: list by name the system calls that the service's sandbox has refused."""

import ctypes
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Iterable
from typing import Final, NamedTuple

from drd.commands import command

# systemd's users that exist only while their service runs (systemd.io/UIDS-GIDS).
DYNAMIC_USERS: Final = range(61184, 65520)
# AUDIT_SECCOMP (linux/audit.h), as the kernel and as systemd's journal write it.
LINE: Final = re.compile(
    r"(?:type=1326 audit\([^)]*\):|SECCOMP) .*? uid=(\d+) .*? pid=(\d+) "
    r"comm=\"([^\"]*)\" .* arch=([0-9a-f]+) syscall=(\d+) "
)
DESCRIPTION: Final = """\
Show the system calls that the sandbox of drd@.service has refused since boot, by name. Needs root, and `drd
install-service NAME --log-refused` beforehand: otherwise refused calls are not logged.

A call refused once while libraries are being loaded is harmless: they try features that they can do without. To allow
any other, add SystemCallFilter=NAME to a drop-in (systemctl edit drd@NAME).
"""
EPILOG: Final = """\
examples:
  sudo /opt/drd/bin/drd refused

Exit code: 0 done, 1 the journal cannot be read.
"""


class Refused(NamedTuple):
    """A system call of a process; `user` is its uid."""

    user: int
    pid: int
    program: str
    call: str


def refused(lines: Iterable[str]) -> list[Refused]:
    """Refused calls in the kernel's log by services with a dynamic user."""
    found = (match.groups() for line in lines if (match := LINE.search(line)))
    calls = [Refused(int(uid), int(pid), comm, name(int(arch, 16), int(n))) for uid, pid, comm, arch, n in found]
    return [call for call in calls if call.user in DYNAMIC_USERS]


def name(architecture: int, number: int) -> str:
    """A system call's name from libseccomp, which systemd itself needs; without it, the number."""
    try:
        resolve = ctypes.CDLL("libseccomp.so.2").seccomp_syscall_resolve_num_arch
    except OSError:
        return str(number)
    resolve.argtypes, resolve.restype = (ctypes.c_uint32, ctypes.c_int), ctypes.c_char_p
    found: bytes | None = resolve(architecture, number)
    return found.decode() if found else str(number)


def main(argv: list[str]) -> int:
    """Print the refused calls, and how often each was."""
    command("drd refused", DESCRIPTION, EPILOG).parse_args(argv)
    call = ("journalctl", "--boot", "--no-pager", "--output=cat", "_TRANSPORT=kernel", "+", "_TRANSPORT=audit")
    try:
        done = subprocess.run(call, capture_output=True, text=True, errors="replace", check=True)
    except (OSError, subprocess.CalledProcessError) as error:
        print(f"drd refused: {error}", file=sys.stderr)
        return 1
    counts = Counter(refused(done.stdout.splitlines()))
    if not counts:
        print("no refused call in the journal since boot (without install-service --log-refused, none is logged)")
    for one, times in counts.items():
        print(f"{one.call}: refused to {one.program}, process {one.pid}, {times} times")
    return 0
