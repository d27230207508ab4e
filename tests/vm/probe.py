"""Runs in the place of the daemon, in its sandbox: what can be done there, and why not. One line of JSON."""

import json
import mmap
import os
import socket
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

CLOSED: Final = (
    "/etc",
    "/etc/drd",
    "/usr",
    "/opt/drd",
    "/var",
    "/var/lib/drd-driving",
    "/root",
    "/home",
    "/run",
    "/dev",
)

# What the daemon is: its program, package, interpreter, configuration and unit.
OWN: Final = (
    "/opt/drd/bin/drd",
    *(str(file) for file in Path("/opt/drd/lib").glob("python3*/site-packages/drd/__init__.py")),
    str(Path(sys.executable).resolve()),
    "/etc/drd/driving.yaml",
    "/etc/systemd/system/drd@.service",
)


def write(folder: str) -> Callable[[], object]:
    return lambda: Path(folder, "probe").write_text("x")


def change(file: str) -> Callable[[], object]:
    """Open what is there for writing; whatever comes of it, it is not written."""
    return lambda: os.close(os.open(file, os.O_WRONLY | os.O_APPEND))


def family(number: int, kind: int, protocol: int = 0) -> Callable[[], object]:
    return lambda: socket.socket(number, kind, protocol).close()


ATTEMPTS: Final[dict[str, Callable[[], object]]] = {
    "write state": write(os.environ.get("STATE_DIRECTORY", "")),
    "write /tmp": write("/tmp"),
    **{f"write {folder}": write(folder) for folder in CLOSED},
    **{f"change {file}": change(file) for file in OWN},
    "writable code": lambda: mmap.mmap(-1, mmap.PAGESIZE, prot=mmap.PROT_READ | mmap.PROT_WRITE | mmap.PROT_EXEC),
    "AF_CAN": family(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW),
    "AF_INET": family(socket.AF_INET, socket.SOCK_STREAM),
    "AF_PACKET": family(socket.AF_PACKET, socket.SOCK_RAW),
    "AF_BLUETOOTH": family(socket.AF_BLUETOOTH, socket.SOCK_RAW),
    "open /dev/ttyS0": lambda: os.open("/dev/ttyS0", os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK),
    "open /dev/ubda": lambda: os.open("/dev/ubda", os.O_RDONLY),
    "open /dev/mem": lambda: os.open("/dev/mem", os.O_RDONLY),
    "set the clock": lambda: time.clock_settime(time.CLOCK_REALTIME, time.time()),
    "real time": lambda: os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(5)),
    "signal systemd": lambda: os.kill(1, 0),
    "be root": lambda: os.setuid(0),
}


def main() -> None:
    """Try all; say why each failed, None where it did not."""
    found: dict[str, str | None] = {}
    for name, attempt in ATTEMPTS.items():
        try:
            attempt()
            found[name] = None
        except OSError as error:
            found[name] = str(error)
    sys.stdout.write(json.dumps(found) + "\n")


if __name__ == "__main__":
    main()
