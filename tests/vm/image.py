"""The disk of the virtual machine: this machine's Debian, with drd's own wheel installed as the README says.

The base system is cached outside the checkout for a week. Packages come from where this machine's apt and pip
get theirs.
"""

import datetime
import hashlib
import os
import platform
import shutil
import subprocess
import sys
from pathlib import Path

CHECKOUT = Path(__file__).parents[2]
PROGRAMS = ("linux.uml", "mmdebstrap", "mke2fs", "depmod", "ip", "unshare", "setpriv")
PACKAGES = ("systemd", "systemd-sysv", "udev", "dbus", "kmod", "iproute2", "can-utils", "python3", "python3-venv")
# They cost time at the boot, and nobody is there to log in.
MASKED = (
    "getty.target",
    "apt-daily.timer",
    "apt-daily-upgrade.timer",
    "dpkg-db-backup.timer",
    "e2scrub_all.timer",
    "e2scrub_reap.service",
    "fstrim.timer",
    "systemd-timesyncd.service",
    "systemd-pstore.service",
    "systemd-networkd.service",
)
FREE_BYTES = 4_000_000_000

TEST_UNIT = """\
[Unit]
Description=One robot's checks of tests/vm/guest.py
After=basic.target dbus.service systemd-udev-trigger.service
Wants=basic.target dbus.socket
SuccessAction=poweroff-force
FailureAction=poweroff-force

[Service]
Type=oneshot
TimeoutStartSec=infinity
ExecStartPre=/bin/sh -c 'mount -t hostfs none /mnt -o $$(sed "s/.*drd_out=//; s/ .*//" /proc/cmdline)'
ExecStart=/bin/sh -c 'cd /mnt && exec /opt/drd/bin/python3 -u -m vm.guest $$(cat robot) >guest.log 2>&1'
ExecStopPost=/bin/sh -c 'journalctl --boot --no-pager --output=short-monotonic >/mnt/journal.log'
"""
# The machine's serial line stands for a USB adapter, which User-mode Linux does not have.
SERIAL_RULES = """\
ACTION!="remove", SUBSYSTEM=="tty", KERNEL=="ttyS0", GROUP="dialout", MODE="0660"
"""


def missing() -> str | None:
    """Why no machine can be built here; None where one can."""
    path = os.environ["PATH"] + ":/usr/sbin:/sbin"
    if absent := [name for name in PROGRAMS if shutil.which(name, path=path) is None]:
        return f"not installed: {', '.join(absent)} (`make vm-test` installs them on Debian)"
    if os.geteuid() != 0:
        return "it needs root: a Debian system is unpacked, a network namespace is made"
    if not Path("/dev/net/tun").exists():
        return "there is no /dev/net/tun"
    return None


def workshop() -> str:
    """Where to work: in memory where there is room, which is twice as fast."""
    memory = Path("/dev/shm")
    has_room = memory.is_dir() and shutil.disk_usage(memory).free > FREE_BYTES
    return str(memory) if has_room else "/var/tmp"


def build(work: Path, modules: Path) -> Path:
    """The disk, made in `work`, for the kernel that these modules are of."""
    root, wheels, disk = work / "root", work / "wheels", work / "root.ext4"
    root.mkdir()
    base = base_system()
    run("tar", "-C", root, "-xf", base, "--exclude=./dev/*")
    install_drd(root, wheels)
    install_kernel_modules(root, modules)
    prepare_system(root)
    # Without a journal of its own: what is lost in a crash of the machine is lost.
    run("mke2fs", "-q", "-F", "-t", "ext4", "-O", "^has_journal", "-d", root, disk, "1200M")
    shutil.rmtree(root)
    return disk


def base_system() -> Path:
    """The Debian that the disk is made of, as a tar file."""
    return debian("base", codename(), "minbase", PACKAGES)


def debian(kind: str, suite: str, variant: str, packages: tuple[str, ...]) -> Path:
    """A tar file of this week with these packages of a suite of Debian and all that they need."""
    year, week, _ = datetime.datetime.now(datetime.UTC).isocalendar()
    contents = hashlib.sha256(" ".join(packages).encode()).hexdigest()[:8]
    caches = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    cache = Path(os.environ.get("DRD_VM_CACHE") or caches / "drd-vm")
    tar = cache / f"{kind}-{suite}-{year}w{week:02}-{contents}.tar"
    if not tar.exists():
        cache.mkdir(parents=True, exist_ok=True)
        for old in cache.glob(f"{kind}-*"):
            old.unlink()
        unfinished = tar.with_suffix(".new")
        # A mirror may lag behind. What it has is signed all the same.
        late = '--aptopt=Acquire::Check-Valid-Until "false"'
        options = ("--mode=root", f"--variant={variant}", "--format=tar", f"--include={','.join(packages)}", late)
        run("mmdebstrap", *options, suite, unfinished, *apt_sources(suite))
        unfinished.rename(tar)
    return tar


def codename() -> str:
    """The release of this machine's Debian."""
    return platform.freedesktop_os_release()["VERSION_CODENAME"]


def apt_sources(suite: str) -> list[str]:
    """Where this machine's packages come from, in apt's one-line form; `suite` may be another one than its own."""
    fields = "deb $(REPO_URI) $(RELEASE) $(COMPONENT)"
    own = codename()
    listed = run("apt-get", "indextargets", "--format", fields, "Created-By: Packages").splitlines()
    sources = [line for line in dict.fromkeys(listed) if line.split()[2].startswith(own)]
    if suite == own:
        return sources
    return [line.replace(f" {own} ", f" {suite} ") for line in sources if line.split()[2] == own]


def install_drd(root: Path, wheels: Path) -> None:
    """README.md's way: a virtual environment in /opt/drd and pip. The wheels are fetched out here."""
    pip = (sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check")
    run(*pip, "wheel", "--no-deps", "--wheel-dir", wheels, CHECKOUT)
    (wheel,) = wheels.glob("drd-*.whl")
    version = (root / "usr/bin/python3").readlink().name.removeprefix("python")
    run(*pip, "download", "--dest", wheels, "--only-binary=:all:", f"--python-version={version}", wheel)
    shutil.move(wheels, root / "root/wheels")
    run("chroot", root, "python3", "-m", "venv", "/opt/drd")
    offline = ("--quiet", "--disable-pip-version-check", "--no-index", "--find-links=/root/wheels")
    run("chroot", root, "/opt/drd/bin/pip", "install", *offline, f"/root/wheels/{wheel.name}")
    shutil.rmtree(root / "root/wheels")


def install_kernel_modules(root: Path, source: Path) -> None:
    """User-mode Linux' modules for CAN and for block devices."""
    target = root / "lib/modules" / source.name
    for part in ("kernel/net/can", "kernel/drivers/net/can", "kernel/drivers/block"):
        shutil.copytree(source / part, target / part)
    for file in (source / "modules.order", *source.glob("modules.builtin*")):
        shutil.copy(file, target)
    run("depmod", "-b", root, source.name)


def prepare_system(root: Path) -> None:
    """What the checks need beside drd: their own unit, the shipped examples, names of the serial lines."""
    units = root / "etc/systemd/system"
    (units / "drd-test.service").write_text(TEST_UNIT)
    (wants := units / "multi-user.target.wants").mkdir(exist_ok=True)
    (wants / "drd-test.service").symlink_to("../drd-test.service")
    for unit in MASKED:
        (units / unit).unlink(missing_ok=True)
        (units / unit).symlink_to("/dev/null")
    # Each would be run at each daemon-reload; together they take User-mode Linux seconds, and PID 1 waits for them.
    generators = root / "etc/systemd/system-generators"
    generators.mkdir()
    for generator in (root / "usr/lib/systemd/system-generators").iterdir():
        (generators / generator.name).symlink_to("/dev/null")
    (root / "etc/udev/rules.d/98-test.rules").write_text(SERIAL_RULES)
    (root / "etc/machine-id").write_text("")
    (root / "etc/hostname").write_text("robot\n")
    (root / "etc/fstab").write_text("")


def run(*command: object) -> str:
    """Run a program, which must succeed; its output."""
    environment = os.environ | {"PATH": os.environ["PATH"] + ":/usr/sbin:/sbin", "LC_ALL": "C.UTF-8"}
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True, env=environment, check=False)
    if done.returncode:
        raise RuntimeError(f"{' '.join(map(str, command))}: exit status {done.returncode}\n{done.stdout}{done.stderr}")
    return done.stdout


if __name__ == "__main__":
    sys.stdout.write(f"{missing() or base_system()}\n")
