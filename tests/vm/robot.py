"""A robot inside its virtual machine: encoders on a virtual CAN bus, a gyro on a serial line, drd as its service."""

import contextlib
import json
import math
import re
import subprocess
import time
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np
import yaml
import zenoh

import drd
from drd.config.file import load_config
from drd.output.session import isolated_config
from drd.units import S_PER_NS
from drd_tools.emulate import hardware
from drd_tools.emulate.hardware import Emulator
from drd_tools.simulate.missions import Drive, demo_drive, make_drive

# Shared with the host: what stands in files there leaves the machine.
SHARED: Final = Path("/mnt")
HOST_ADDRESS, GUEST_ADDRESS = "10.213.0.1", "10.213.0.2"  # private, as the unit asks
REBOOTING: Final = "rebooting"
# Machines that run beside each other, and one after the other.
ROUNDS: Final = (("driving", "standing"), (REBOOTING,))
NAMES: Final = tuple(name for names in ROUNDS for name in names)
# The one whose power is cut; its disk is at this address (volatile_disk.py).
CUT: Final = "cut"
DISK: Final = (HOST_ADDRESS, 10809)
PORT: Final = 7447
LINE: Final = "/dev/ttyS0"
BUS: Final = "vcan0"
# First the gyro is away, then its bias is measured.
STAND_S: Final = {"driving": 30.0, CUT: 5.0}
GEOMETRY: Final = {"wheel_radius_m": 0.1, "tread_m": 0.5}
# Few bytes: User-mode Linux never reads a serial line again in which 4 KiB have been waiting. These need 50 s for them.
FOG: Final = {"protocol": "ecore", "baud": 9600, "rate_hz": 10, "full_scale_deg_s": 100, "latency_s": 0.0}
EXAMPLE: Final = Path(drd.__file__).parent / "data/config/canopen.yaml"
PROGRAM: Final = "/opt/drd/bin/drd"
# The daemon listens at both; the second can be reached from outside the machine.
ENDPOINTS: Final = (f"tcp/127.0.0.1:{PORT}", f"tcp/{GUEST_ADDRESS}:{PORT}")
# The heading may be hardly known for so long: the gyro, whose rate is 10 Hz, is late by as much where the host is busy,
# 0.58 s were seen.
MOMENT_S: Final = 1.0
# In which the gyro outside finds out when to begin and whether it is plugged in.
ORDERS: Final = "gyro.json"


def drive(name: str) -> Drive:
    """The way of the robot of that name; the gyro outside goes the same."""
    return demo_drive(300, stand_s=STAND_S[name]) if name in STAND_S else make_drive("stand")


def sh(command: str, *, may_fail: bool = False) -> str:
    """Run a line of shell, which must succeed; its output."""
    done = subprocess.run(command, shell=True, capture_output=True, text=True, timeout=60, check=False)
    assert may_fail or done.returncode == 0, f"{command}: exit status {done.returncode}: {done.stdout}{done.stderr}"
    return (done.stdout + done.stderr).strip()


def until(what: str, condition: Callable[[], object], timeout_s: float, step_s: float = 0.25) -> float:
    """Wait for it; the time that took. Raises AssertionError."""
    began_s = time.monotonic()
    while not condition():
        assert time.monotonic() - began_s < timeout_s, f"{what}: not within {timeout_s:g} s"
        time.sleep(step_s)
    return time.monotonic() - began_s


class Robot:
    """The hardware, the service `drd@NAME` and a Zenoh subscriber to it."""

    def __init__(self, name: str):
        self.name, self.unit, self.bus = name, f"drd@{name}.service", BUS
        self.port = Path(f"/dev/fog-{name}")
        self.file = Path(f"/etc/drd/{name}.yaml")
        self.poses: list[tuple[float, dict[str, Any]]] = []  # with the time of arrival, CLOCK_MONOTONIC
        self.configure()
        self.make_bus()
        encoders_only = Path(f"/run/{name}-encoders.yaml")
        encoders_only.write_text(yaml.safe_dump(self.configuration() | {"fog": {"protocol": "none"}}))
        # Only an SLCAN adapter must answer sooner than it has to say something, and the processor is slow.
        setattr(hardware, "POLL_S", 1.0)  # noqa: B010
        self.emulator = Emulator(load_config(encoders_only).value, Path("/"), drive(name), seed=1)
        self.emulator.start()
        self._start_wall_ns = time.time_ns() - time.monotonic_ns() + self.emulator.start_ns
        self.gyro(on=False)
        config = isolated_config("peer", (), ENDPOINTS[:1])
        config.insert_json5("connect/retry", '{"period_init_ms": 100, "period_max_ms": 200}')
        self._session: Any = zenoh.open(config)
        self._session.declare_subscriber("drd/pose", self._hear)

    def close(self) -> None:
        """Stop the hardware and listen no more."""
        self._session.close()
        self.emulator.stop()

    # ---- hardware ----------------------------------------------------------------------------------------------

    def configuration(self) -> dict[str, Any]:
        """The example for CANopen encoders, with this robot's places."""
        values: dict[str, Any] = yaml.safe_load(EXAMPLE.read_text())
        values["robot"] |= GEOMETRY | {"name": self.name}
        values["fog"] |= FOG | {"port": str(self.port)}
        values["encoders"]["channel"] = self.bus
        # The machine's processor is late by tens of ms, now for the one and now for the other; more would make the
        # heading of a moment without the gyro worthless, since the stamps make the speed jump.
        values["estimation"]["noise"]["timing_s"] = 0.02
        # On a busy host the gyro outside is late by a second: it is waited for, and nothing is lost.
        values["estimation"]["reorder_s"] = 3.0
        values["estimation"]["static_bias"] = {"duration_s": 3.0, "minimum_s": 1.0}
        # Nothing here waits for a silence: a lost port says so.
        values["fog"]["silent_after_s"] = values["encoders"]["silent_after_s"] = 5.0
        # A process more, whose low priority the sandbox refuses, would be in its way for seconds at each start; that of
        # golden.yaml has one (`upgraded`).
        values["monitor"] = {"enabled": False}
        values["output"] = {"listen": list(ENDPOINTS[: 1 if self.name == REBOOTING else 2]), "commands": True}
        return values

    def configure(self, **sections: dict[str, Any]) -> None:
        """Write /etc/drd/NAME.yaml, with keys of some sections changed."""
        values = self.configuration()
        for section, keys in sections.items():
            values[section] = (values.get(section) or {}) | keys
        self.file.parent.mkdir(exist_ok=True)
        self.file.write_text(yaml.safe_dump(values))

    def make_bus(self) -> None:
        """The CAN interface as the network configuration would bring it up."""
        sh(f"ip link add dev {self.bus} type vcan && ip link set {self.bus} up")

    def gyro(self, on: bool) -> None:
        """Plug the gyro in, or pull its plug."""
        order = SHARED / ORDERS
        new = order.with_suffix(".new")
        new.write_text(json.dumps({"on": on, "start_wall_ns": self._start_wall_ns}))
        new.rename(order)
        self.port.unlink(missing_ok=True)
        if on:
            self.port.symlink_to(LINE)

    def truth(self, t_ns: int) -> tuple[float, float]:
        """Where the robot was then (CLOCK_MONOTONIC), in m."""
        motion = drive_at(self.emulator, t_ns)
        return motion[0], motion[1]

    # ---- service -----------------------------------------------------------------------------------------------

    def systemctl(self, verb: str) -> subprocess.CompletedProcess[str]:
        """`systemctl VERB drd@NAME`."""
        command = ["systemctl", verb, self.unit]
        return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)

    def show(self, name: str) -> str:
        """A property of the service."""
        return sh(f"systemctl show --value --property={name} {self.unit}")

    def is_active(self) -> bool:
        """What systemd says, after READY=1."""
        return self.show("ActiveState") == "active"

    def pid(self) -> int:
        """The daemon's process; 0: none."""
        return int(self.show("MainPID"))

    def journal(self) -> list[tuple[float, str]]:
        """All that was said by and about the service so far, with the time (CLOCK_MONOTONIC, s)."""
        lines = sh(f"journalctl --boot --no-pager --output=short-monotonic --unit={self.unit}").splitlines()
        found = (re.match(r"\[ *([\d.]+)\] \S+ (.*)", line) for line in lines)
        return [(float(line[1]), line[2]) for line in found if line]

    # ---- Zenoh -------------------------------------------------------------------------------------------------

    def _hear(self, sample: Any) -> None:
        self.poses.append((time.monotonic(), json.loads(sample.payload.to_bytes())))

    def get(self, key: str, request: dict[str, Any] | None = None) -> dict[str, Any] | None:
        """Ask the daemon; None where it does not answer."""
        payload = None if request is None else json.dumps(request).encode()
        for reply in self._session.get(f"drd/{key}", payload=payload, timeout=1.0):
            # Where nothing answers in time, Zenoh itself replies, with an error that is no JSON.
            with contextlib.suppress(json.JSONDecodeError):
                answer: dict[str, Any] = json.loads((reply.ok or reply.err).payload.to_bytes())
                return answer
        return None

    def since(self, began_s: float) -> list[dict[str, Any]]:
        """Poses that arrived after that moment (time.monotonic())."""
        return [pose for heard_s, pose in list(self.poses) if heard_s >= began_s]

    def talks(self) -> bool:
        """A pose came within the last 0.3 s."""
        return bool(self.poses) and time.monotonic() - self.poses[-1][0] < 0.3

    def is_well(self) -> bool:
        """Poses come, and nothing is wrong with them."""
        if not self.talks():
            return False
        newest = self.poses[-1][1]
        return not troubles([newest]) and all(r["source"] != "heading" for r in newest["reasons"])

    def reasons(self) -> str:
        """What the daemon says is wrong, in one line; it may be empty."""
        health = self.get("health")
        return "no answer" if health is None else "; ".join(f"{r['source']}: {r['text']}" for r in health["reasons"])

    def counters(self) -> Any:
        """All that the daemon has counted; None without an answer."""
        return (self.get("health") or {}).get("counters")

    def hears_gyro(self) -> bool:
        """Neither the port nor the samples are missing."""
        health = self.get("health")
        return health is not None and not any(r["source"].startswith("fog") for r in health["reasons"])


def drive_at(emulator: Emulator, t_ns: int) -> tuple[float, float, float]:
    """True x, y (m) and heading (rad) at that time (CLOCK_MONOTONIC), between the emulator's rows."""
    rows = list(emulator.truth)
    times_s = [(row.t_ns - t_ns) * S_PER_NS for row in rows]
    x_m, y_m, heading_rad = (float(np.interp(0.0, times_s, [row[i] for row in rows])) for i in range(1, 4))
    return x_m, y_m, heading_rad


def troubles(poses: list[dict[str, Any]]) -> set[str]:
    """What is wrong with these poses.

    That the two headings disagree for a moment is not the daemon's: where other programs keep this machine's processor,
    wheels and gyro come late, and not equally. Nor is a heading that is hardly known while the gyro's sample is on its
    way, and the wheels' stamps make them jump: but the next sample must end that.
    """
    reasons = [reason for pose in poses for reason in pose["reasons"]]
    found = {f"{r['source']}: {r['text']}" for r in reasons if r["source"] not in {"agreement", "heading"}}
    lasts_s = last_s = 0.0
    for before, after in pairwise([poses[0], *poses]):
        is_lost = any(r["source"] == "heading" for r in after["reasons"])
        last_s = last_s + (after["monotonic_ns"] - before["monotonic_ns"]) * S_PER_NS if is_lost else 0.0
        lasts_s = max(lasts_s, last_s)
    return found | ({f"the heading was hardly known for {lasts_s:.2f} s"} if lasts_s > MOMENT_S else set())


def steps(poses: list[dict[str, Any]]) -> tuple[float, float]:
    """Longest time between two poses (s), and the largest step between them, beyond what the top speed explains (m).

    Where the machine stands still for a moment, the samples of that time come together with stamps of their arrival.
    """
    top_speed_m_s, stall_s = 2.5, 0.3
    gap_s = excess_m = 0.0
    for before, after in pairwise(poses):
        taken_s = (after["monotonic_ns"] - before["monotonic_ns"]) * S_PER_NS
        moved_m = math.hypot(after["x_m"] - before["x_m"], after["y_m"] - before["y_m"])
        gap_s, excess_m = max(gap_s, taken_s), max(excess_m, moved_m - top_speed_m_s * (taken_s + stall_s))
    return gap_s, excess_m
