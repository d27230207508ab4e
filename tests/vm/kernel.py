"""The kernel of the virtual machine: the first that runs on this host, and how it is started.

Where the processor's extended state is larger than the buffer of Debian 12's User-mode Linux (`amx_tile` in
/proc/cpuinfo), every process inside it dies. The kernel of Debian's unstable suite runs there. It needs a newer C
library than this machine may have, hence it is unpacked into a folder of its own and started there in a chroot.
"""

import logging
import os
import re
import subprocess
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

from vm import image

INSTALLED, NEWER = "installed", "newer"
# Which kernel to take, one of these two; unset, the first that runs.
WISH = "DRD_VM_KERNEL"
SUITE = "sid"
# /bin/true is the probe's init; base-files brings the links in / that programs are linked with.
PACKAGES = ("user-mode-linux", "base-files", "coreutils")
MODULES = "usr/lib/uml/modules"
LIMIT_S = 20

# All of it ends with this process: a kernel that is killed would leave its processes behind.
CONTAINED = ("setpriv", "--pdeathsig=KILL", "unshare", "--pid", "--fork", "--kill-child=SIGKILL")
# As the first process of its namespace the kernel could not abort itself; here `timeout` is the first.
TIMED = ("timeout", "--kill-after=2", str(LIMIT_S))
TIMEOUT_STATUSES = (124, 137)
PROBE = ("mem=256M", "rootfstype=hostfs", "rootflags=/", "rw", "init=/bin/true", "con=null", "con0=fd:0,fd:1")
# There is nothing to do after /bin/true: a kernel that ran it stops, and says with what status it ended.
RAN = "Attempted to kill init! exitcode=0x00000000"
TELLING = re.compile(r"errno = |Kernel panic|^E: ")

# Its devices (/dev/shm among them), the processes and the machine's own folder are under the same names in there.
ENTER = """\
root=$1 work=$2; shift 2
mkdir -p "$root$work" && mount --rbind /dev "$root/dev" && mount --bind /proc "$root/proc" &&
mount --bind "$work" "$root$work" && exec chroot "$root" "$@"
"""

log = logging.getLogger("drd.vm")


class NoKernelError(Exception):
    """None runs here; the message says what each said."""


class Kernel(NamedTuple):
    """A User-mode Linux that can be started."""

    title: str
    command: tuple[str, ...]
    modules: Path


def choose(makers: Mapping[str, Callable[[], Kernel]], work: Path) -> tuple[Kernel, str]:
    """The first kernel that runs in `work`, and a sentence of which it is and why not those before it."""
    refusals: list[str] = []
    for name, make in makers.items():
        try:
            kernel = make()
            title, reason = kernel.title, refusal(kernel, work)
        except (OSError, RuntimeError, ValueError) as error:
            title, reason = f"the {name} kernel", f"it cannot be had: {complaint(str(error))}"
        if reason is None:
            sentence = "; ".join([f"{kernel.title} runs", *refusals])
            log.info("%s", sentence)
            return kernel, sentence
        refusals.append(f"{title} does not run: {reason}")
    raise NoKernelError("; ".join(refusals))


def makers(work: Path) -> dict[str, Callable[[], Kernel]]:
    """The kernels to try, in that order, each made when it is its turn; `work` is where the machines will be."""
    known = {INSTALLED: installed, NEWER: lambda: newer(work)}
    wish = os.environ.get(WISH)
    if not wish:
        return known
    if wish not in known:
        raise NoKernelError(f"{WISH} is {wish!r}, expected one of {', '.join(known)}")
    return {wish: known[wish]}


def installed() -> Kernel:
    """The one of this machine's Debian."""
    modules = min(Path("/", MODULES).iterdir())
    return Kernel(f"User-mode Linux {modules.name}", ("linux.uml",), modules)


def newer(work: Path) -> Kernel:
    """The one of Debian's unstable suite, unpacked in `work`."""
    (root := work / "kernel").mkdir()
    # Extracted only: no script of that suite's packages runs here.
    tar = image.debian("kernel", SUITE, "extract", PACKAGES)
    image.run("tar", "-C", root, "-xf", tar, "--exclude=./dev/*")
    modules = min((root / MODULES).iterdir())
    enter = ("unshare", "--mount", "sh", "-c", ENTER, "sh", str(root), str(work))
    return Kernel(f"User-mode Linux {modules.name} of {SUITE}", (*enter, "/usr/bin/linux.uml"), modules)


def refusal(kernel: Kernel, work: Path) -> str | None:
    """Let it run /bin/true, about a second: None where it does, otherwise what its console says."""
    done = subprocess.run(
        (*CONTAINED, *TIMED, *kernel.command, *PROBE, f"uml_dir={work}/uml"),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        errors="replace",
        check=False,
    )
    if RAN in done.stdout:
        return None
    said = complaint(done.stdout)
    return f"no end after {LIMIT_S} s, at last {said}" if done.returncode in TIMEOUT_STATUSES else said


def complaint(text: str) -> str:
    """The line that tells why a program ended: the first that speaks of an error, else the last."""
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    telling = [line for line in lines if TELLING.search(line)]
    return (telling[:1] or lines[-1:] or ["it said nothing"])[0]
