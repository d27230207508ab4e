"""A virtual machine for each robot: User-mode Linux in a network and a process namespace of its own.

Each has one processor, and they run beside each other. Out here are the gyro on its serial line and a Zenoh subscriber
beyond its network interface; what the checks inside find out comes back through a folder that both see.
"""

import contextlib
import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml
from vm import image, robot, volatile_disk
from vm.kernel import CONTAINED, Kernel

from drd.config.file import load_config
from drd.units import S_PER_NS
from drd_tools.emulate.hardware import Emulator

LIMIT_S = 240.0
POLL_S = 0.004
CONSOLE_LINES = 40  # a panic prints about thirty
# What a robot's own machine starts; the checks need less.
UNITS = {robot.REBOOTING: "multi-user.target"}
RESULTS, OUTSIDE, CONSOLE = "results.json", "outside.jsonl", "console.log"

# The namespace, and all in it, ends with the machine. Time must go on in there whatever else runs out here: where that
# is permitted, the machine takes one processor before others do. The kernel's limit for real-time programs holds.
SCRIPT = f"""\
ip link set lo up && ip tuntap add dev tap0 mode tap && ip address add {robot.HOST_ADDRESS}/24 dev tap0 &&
ip link set tap0 up || exit 1
chrt --rr 1 true && first="chrt --rr 1"
"$1" -c "$2" {robot.ENDPOINTS[1]} "$3" &
test -z "$4" || $first "$1" "$5" "$4" {robot.DISK[0]} {robot.DISK[1]} &
shift 5
exec $first "$@"
"""
SUBSCRIBER = """\
import json
import os, sys, time, zenoh
from drd.output.session import isolated_config
config = isolated_config("peer", (), (sys.argv[1],))
config.insert_json5("connect/retry", '{"period_init_ms": 200, "period_max_ms": 500}')
with zenoh.open(config) as session, open(sys.argv[2], "w", buffering=1) as stream:
    poses = session.declare_subscriber("drd/pose")
    for sample in poses:
        print(json.dumps({"heard_s": time.monotonic()} | json.loads(sample.payload.to_bytes())), file=stream)
"""


class Machine:
    """One robot's machine while it runs, with the gyro of that robot on its serial line, a pseudo-terminal."""

    def __init__(self, name: str, kernel: Kernel, disk: str, work: Path, volatile: Path | None = None):
        """Start it, in `work`, a folder of its own; `disk` is changed, or else it names a file for the changes first.

        `volatile`: the folder of a second disk whose cache a power cut empties (volatile_disk.py).
        """
        self.out = work / "out"
        self.out.mkdir()
        shutil.copytree(Path(__file__).parent, self.out / "vm", ignore=shutil.ignore_patterns("__pycache__"))
        shutil.copytree(image.CHECKOUT / "tests/golden", self.out / "golden")
        (self.out / "robot").write_text(name)
        small, gyro, configuration = work / "small.ext4", work / "gyro", work / "gyro.yaml"
        image.run("mke2fs", "-q", "-F", "-t", "ext4", small, "8M")
        encoders = {"interface": "virtual", "channel": name, "counts_per_revolution": 4096}
        fog = robot.FOG | {"port": str(gyro)}
        configuration.write_text(yaml.safe_dump({"robot": robot.GEOMETRY, "fog": fog, "encoders": encoders}))
        self._gyro = Emulator(load_config(configuration).value, work, robot.drive(name), seed=1)
        self._gyro.plug_in()
        system = (
            *(*kernel.command, "mem=768M", f"umid={work.name}", f"uml_dir={work}/uml", f"ubd0={disk}", f"ubd1={small}"),
            *("root=/dev/ubda", "rw", "init=/lib/systemd/systemd", "quiet", "panic=1", "con=null", "con0=null,fd:1"),
            *("ssl=null", f"ssl0=tty:{gyro.readlink()}", "vec0:transport=tap,ifname=tap0,gro=1"),
            *(f"systemd.unit={UNITS.get(name, 'drd-test.service')}", f"drd_out={self.out}"),
        )
        command = (
            *(*CONTAINED, "--net"),
            *("sh", "-c", SCRIPT, "sh", sys.executable, SUBSCRIBER, str(self.out / OUTSIDE)),
            *(str(volatile or ""), volatile_disk.__file__),
            *("timeout", "--kill-after=5", str(LIMIT_S), *system),
        )
        self._alive, alive = os.pipe()
        with (self.out / CONSOLE).open("wb") as console:
            self._process = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=console, stderr=subprocess.STDOUT, pass_fds=(alive,)
            )
        os.close(alive)

    def is_running(self) -> bool:
        """Whether it has not ended."""
        return self._process.poll() is None

    def step(self) -> None:
        """Send what is due of the gyro. The robot inside says in a file when to begin and whether it is plugged in."""
        try:
            orders = json.loads((self.out / robot.ORDERS).read_text())
        except (OSError, ValueError):
            return
        self._gyro.fog_silent = not orders["on"]
        self._gyro.step((time.time_ns() - orders["start_wall_ns"]) * S_PER_NS)

    def close(self) -> None:
        """Pull both plugs: every process of the machine is gone afterwards."""
        self._process.kill()
        self._process.wait()
        os.read(self._alive, 1)  # an end when nobody holds the other one any more
        os.close(self._alive)
        self._gyro.stop()


def run(kernel: Kernel, disk: Path, work: Path, names: Sequence[str]) -> tuple[dict[str, Path], float]:
    """Boot a machine for each of these robots, and wait for their ends.

    Returns the folders with what they left, and by how long the gyros out here were late at most, in s.
    """
    machines: dict[str, Machine] = {}
    late_s = 0.0
    with contextlib.ExitStack() as ends:
        for name in names:
            (own := work / name).mkdir()
            image.run("cp", "--sparse=always", disk, own / "root.ext4")
            machines[name] = Machine(name, kernel, str(own / "root.ext4"), own)
            ends.callback(machines[name].close)
        # The machines' own programs are started: from here on the gyros must wait neither for a busy host nor for the
        # machines, whose turn is 0.1 s long at a priority of 1.
        ends.callback(os.sched_setscheduler, 0, os.SCHED_OTHER, os.sched_param(0))
        with contextlib.suppress(PermissionError):
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(2))
        last_s = time.monotonic()
        while any(machine.is_running() for machine in machines.values()):
            for machine in machines.values():
                machine.step()
            time.sleep(POLL_S)
            now_s = time.monotonic()
            late_s, last_s = max(late_s, now_s - last_s - POLL_S), now_s
    return {name: machine.out for name, machine in machines.items()}, late_s


def results(out: Path) -> dict[str, dict[str, Any]]:
    """What each check inside found; empty where the machine did not come so far."""
    file = out / RESULTS
    return json.loads(file.read_text()) if file.exists() else {}


def console_end(out: Path) -> str:
    """The last lines of the console."""
    lines = (out / CONSOLE).read_text(errors="replace").splitlines()
    return "\n".join(lines[-CONSOLE_LINES:]) or "nothing"


def poses_outside(out: Path) -> list[dict[str, Any]]:
    """The poses that left the machine, with the time of their arrival (`heard_s`, this machine's CLOCK_MONOTONIC)."""
    file = out / OUTSIDE
    lines = file.read_text().splitlines() if file.exists() else []
    return [json.loads(line) for line in lines if line.endswith("}")]
