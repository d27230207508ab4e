"""One run of the virtual machine: User-mode Linux in a network and a process namespace of its own.

Out here are the gyros on its serial lines and a Zenoh subscriber beyond its network interface; what the checks inside
find out comes back through a folder that both see.
"""

import json
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import yaml
from vm import image, robot

from drd.config_file import load_config
from drd.units import S_PER_NS
from drd_tools.emulate.hardware import Emulator

LIMIT_S = 240.0
POLL_S = 0.004
RESULTS, OUTSIDE, CONSOLE = "results.json", "outside.jsonl", "console.log"

# The namespace, and all in it, ends with the machine. Time must go on in there whatever else runs out here: where that
# is permitted, the machine takes one processor before others do. The kernel's limit for real-time programs holds.
SCRIPT = f"""\
ip link set lo up && ip tuntap add dev tap0 mode tap && ip address add {robot.HOST_ADDRESS}/24 dev tap0 &&
ip link set tap0 up || exit 1
"$1" -c "$2" tcp/{robot.GUEST_ADDRESS}:{robot.PORTS["driving"]} "$3" &
shift 3
chrt --rr 1 true && exec chrt --rr 1 "$@"
exec "$@"
"""
SUBSCRIBER = """\
import json, sys, time, zenoh
from drd.output.session import isolated_config
config = isolated_config("peer", (), (sys.argv[1],))
config.insert_json5("connect/retry", '{"period_init_ms": 200, "period_max_ms": 500}')
with zenoh.open(config) as session, open(sys.argv[2], "w", buffering=1) as stream:
    poses = session.declare_subscriber("drd/pose")
    for sample in poses:
        print(json.dumps({"heard_s": time.monotonic()} | json.loads(sample.payload.to_bytes())), file=stream)
"""


class Gyro:
    """A fibre-optic gyro on a pseudo-terminal, told through a file in `out` where its drive began and when to talk."""

    def __init__(self, name: str, work: Path, out: Path):
        file = work / f"{name}.yaml"
        encoders = {"interface": "virtual", "channel": name, "counts_per_revolution": 4096}
        fog = robot.FOG | {"port": str(work / f"fog-{name}")}
        file.write_text(yaml.safe_dump({"robot": robot.GEOMETRY, "fog": fog, "encoders": encoders}))
        self._emulator = Emulator(load_config(file).value, work, robot.drive(name), seed=1)
        self._emulator.plug_in()
        self._orders = out / robot.orders(name)
        self.device = (work / f"fog-{name}").readlink()

    def step(self) -> None:
        """Send what is due."""
        try:
            orders = json.loads(self._orders.read_text())
        except (OSError, ValueError):
            return
        self._emulator.fog_silent = not orders["on"]
        self._emulator.step((time.time_ns() - orders["start_wall_ns"]) * S_PER_NS)

    def close(self) -> None:
        """Hang up."""
        self._emulator.stop()


def run(disk: Path, work: Path) -> Path:
    """Boot, wait for the end, and return the folder with what the machine left."""
    out = work / "out"
    out.mkdir()
    shutil.copytree(Path(__file__).parent, out / "vm", ignore=shutil.ignore_patterns("__pycache__"))
    small = work / "small.ext4"
    image.run("mke2fs", "-q", "-F", "-t", "ext4", small, "8M")
    gyros = [Gyro(name, work, out) for name in robot.LINES]
    lines = [f"ssl{i}=tty:{gyro.device}" for i, gyro in enumerate(gyros)]
    machine = (
        *("linux.uml", "mem=1024M", f"umid={work.name}", f"uml_dir={work}/uml", f"ubd0={disk}", f"ubd1={small}"),
        *("root=/dev/ubda", "rw", "init=/lib/systemd/systemd", "quiet", "panic=1", "con=null", "con0=null,fd:1"),
        *("ssl=null", *lines, "vec0:transport=tap,ifname=tap0", "systemd.unit=drd-test.service", f"drd_out={out}"),
    )
    command = (
        *("setpriv", "--pdeathsig=KILL", "unshare", "--net", "--pid", "--fork", "--kill-child=SIGKILL"),
        *("sh", "-c", SCRIPT, "sh", sys.executable, SUBSCRIBER, str(out / OUTSIDE)),
        *("timeout", "--kill-after=5", str(LIMIT_S), *machine),
    )
    try:
        with (out / CONSOLE).open("wb") as console:
            process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=console, stderr=subprocess.STDOUT)
            while process.poll() is None:
                for gyro in gyros:
                    gyro.step()
                time.sleep(POLL_S)
    finally:
        for gyro in gyros:
            gyro.close()
    return out


def results(out: Path) -> dict[str, dict[str, Any]]:
    """What each check inside found; empty where the machine did not come so far."""
    file = out / RESULTS
    return json.loads(file.read_text()) if file.exists() else {}


def poses_outside(out: Path) -> list[dict[str, Any]]:
    """The poses that left the machine, with the time of their arrival (`heard_s`, this machine's CLOCK_MONOTONIC)."""
    file = out / OUTSIDE
    lines = file.read_text().splitlines() if file.exists() else []
    return [json.loads(line) for line in lines if line.endswith("}")]
