"""The table of faults: what each does to the sensors, for how long, and what must name it how soon."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from drd.fog.dsp17xx import BODY, HEADER, crc32_mpeg2
from drd.ports.can_errors import problems, state_after
from drd.samples import CanFrame
from drd.units import RAD_PER_DEG

# Pieces of a delivery, each with how much later than usual it comes, s.
Delivery = list[tuple[float, Any]]
LEFT_ID, RIGHT_ID, BOOT_UP_ID, EMERGENCY_ID, FOREIGN_ID = 0x181, 0x182, 0x701, 0x081, 0x5A5
# Beyond the plausibility limit of 500 deg/s^2 over one interval of 0.1 s; within full scale.
SPIKE_DEG_S: Final = 80.0
# Less than `estimation.reorder_s`, which is what the estimator waits.
BUNCH_S: Final = 0.2


@dataclass
class Site:
    """Where a fault is at work: its random numbers, how long it has lasted, and a place for its memory."""

    random: np.random.Generator
    elapsed_s: float = 0.0
    memory: dict[str, Any] = field(default_factory=dict)

    def every(self, name: str, period_s: float) -> bool:
        """True once in each period."""
        number = int(self.elapsed_s / period_s)
        is_new, self.memory[name] = self.memory.get(name) != number, number
        return is_new


@dataclass(frozen=True)
class Fault:
    """One row. `named`: sources of reasons, or counters (part.name), any of which names it, within `within_s`.

    What it changes: `rate(rad/s, C)` that the gyro sends, `packet(bytes)` on its way, `travel(left m, right m)` that
    the counters show, `frames` on their way. `valid`: the gyro's own flag. `port`: the port whose trouble the daemon
    reports, and how it reads. `stalls`: the host stands still and reads everything afterwards. `unseen`: why the bound
    does not cover it; such a row is shown and not judged.
    """

    name: str
    seconds: float
    named: tuple[str, ...] = ()
    within_s: float = 1.0
    rate: Callable[[float, float, Site], tuple[float, float]] = lambda rate, celsius, _: (rate, celsius)
    packet: Callable[[bytes, Site], Delivery] = lambda packet, _: [(0.0, packet)]
    travel: Callable[[float, float, Site], tuple[float, float]] = lambda left, right, _: (left, right)
    frames: Callable[[list[CanFrame], Site], Delivery] = lambda frames, _: [(0.0, frame) for frame in frames]
    valid: bool = True
    port: tuple[str, str] | None = None
    stalls: bool = False
    unseen: str = ""


def _nothing(_: Any, __: Site) -> Delivery:
    return []


def _sometimes(part: float, hit: Callable[[bytes], list[bytes]]) -> Callable[[bytes, Site], Delivery]:
    """So many of the packets become something else."""
    return lambda packet, site: [(0.0, p) for p in (hit(packet) if site.random.random() < part else [packet])]


def _flipped(packet: bytes) -> list[bytes]:
    return [packet[:-6] + bytes([packet[-6] ^ 1]) + packet[-5:]]


def _not_a_number(packet: bytes, _: Site) -> Delivery:
    values = list(BODY.unpack_from(packet))
    values[3] = math.nan  # the z axis
    body = BODY.pack(HEADER, *values[1:])
    return [(0.0, body + crc32_mpeg2(body))]


def _stuck(rate: float, celsius: float, site: Site) -> tuple[float, float]:
    """The value of the fault's beginning, for ever."""
    return float(site.memory.setdefault("rate", rate)), celsius


def _spike(rate: float, celsius: float, site: Site) -> tuple[float, float]:
    return (rate + SPIKE_DEG_S * RAD_PER_DEG if site.every("spike", 2.0) else rate), celsius


def _bunched(packet: bytes, site: Site) -> Delivery:
    """An adapter that hands packets over five times a second."""
    return [(BUNCH_S - site.elapsed_s % BUNCH_S, packet)]


def _only(kept: int) -> Callable[[list[CanFrame], Site], Delivery]:
    return lambda frames, _: [(0.0, frame) for frame in frames if frame.can_id == kept]


def _short(frames: list[CanFrame], _: Site) -> Delivery:
    return [(0.0, f._replace(data=f.data[:2]) if f.can_id == LEFT_ID else f) for f in frames]


def _with(make: Callable[[CanFrame], CanFrame], count: int = 1) -> Callable[[list[CanFrame], Site], Delivery]:
    """Further frames behind the true ones."""
    return lambda frames, _: [(0.0, f) for f in (*frames, *(make(frames[-1]) for _ in range(count)))]


def _once_restarted(frames: list[CanFrame], site: Site) -> Delivery:
    """The left node says that it has started again; its counter goes on from zero (see `_from_zero`)."""
    boots = [CanFrame(frames[0].t_ns - 1000, BOOT_UP_ID, False, b"\0")] if site.every("boot", 1e9) else []
    return [(0.0, f) for f in (*boots, *frames)]


def _from_zero(left_m: float, right_m: float, site: Site) -> tuple[float, float]:
    return left_m - float(site.memory.setdefault("zero", left_m)), right_m


def _grown(factor: float, also_right: bool = False) -> Callable[[float, float, Site], tuple[float, float]]:
    """Counts that come `factor` times as fast from the fault's beginning on."""

    def travel(left_m: float, right_m: float, site: Site) -> tuple[float, float]:
        left0, right0 = site.memory.setdefault("zero", (left_m, right_m))
        grown = left0 + factor * (left_m - left0), right0 + factor * (right_m - right0)
        return grown[0], grown[1] if also_right else right_m

    return travel


def _preset(left_m: float, right_m: float, site: Site) -> tuple[float, float]:
    """The left counter jumps by 1 m every 2 s."""
    return left_m + int(site.elapsed_s / 2.0) + 1.0, right_m


def _swapped(frames: list[CanFrame], site: Site) -> Delivery:
    """Every other frame of the left node is read after the one that follows it."""
    last, site.memory["held"] = site.memory.get("held"), None
    left, *rest = frames
    if last is None:
        site.memory["held"] = left
        return [(0.0, f) for f in rest]
    return [(0.0, left), (0.06, last), *((0.0, f) for f in rest)]


def _late(frames: list[CanFrame], _: Site) -> Delivery:
    """The kernel's stamp is right, but they are read half a second later."""
    return [(0.5, f) for f in frames]


def _bus_error(data: bytes) -> str:
    """What the CAN port reports after an error frame of the class "controller problem"."""
    return f"can0: {state_after(problems(0x004, data), None)}"


FAULTS: Final = (
    Fault("none", 20.0),
    # ---- the gyro's line
    Fault("gyro silent", 5.0, ("fog",), packet=_nothing),
    Fault("gyro silent for long", 20.0, ("fog",), packet=_nothing),
    Fault("gyro unplugged, plugged in", 8.0, ("fog.port",), 0.1, packet=_nothing,
          port=("fog.port", "lost /dev/fog: unplugged")),
    Fault("garbage between packets", 10.0, ("fog.foreign_bytes",),
          packet=lambda packet, site: [(0.0, site.random.integers(0, 128, 9, np.uint8).tobytes() + packet)]),
    Fault("wrong baud rate", 8.0, ("fog", "fog.foreign_bytes"),
          packet=lambda packet, site: [(0.0, site.random.integers(0, 256, len(packet), np.uint8).tobytes())]),
    Fault("checksum errors", 10.0, ("fog.bad_checksum",), packet=_sometimes(0.5, _flipped)),
    Fault("packets lost", 10.0, ("fog.lost_packets",), 2.0, packet=_sometimes(0.3, lambda _: [])),
    Fault("packets doubled", 10.0, ("fog.doubled",), packet=_sometimes(1.0, lambda p: [p, p])),
    Fault("packets in bunches", 10.0, packet=_bunched),
    # ---- what the gyro says
    Fault("gyro says invalid", 5.0, ("fog", "fog.bad_flag"), valid=False),
    Fault("gyro says NaN", 5.0, ("fog", "fog.not_finite"), packet=_not_a_number),
    Fault("gyro saturated", 5.0, ("fog", "fog.over_range"), rate=lambda _, c, __: (100.0 * RAD_PER_DEG, c)),
    Fault("gyro spikes", 10.0, ("fog.implausible",), rate=_spike),
    Fault("gyro stuck at a value", 20.0, ("agreement",), 15.0, rate=_stuck),
    Fault("gyro steps by 3 deg/s", 15.0, ("agreement",), 5.0, rate=lambda r, c, _: (r + 3.0 * RAD_PER_DEG, c)),
    Fault("bias steps by 0.01 deg/s", 60.0, rate=lambda r, c, _: (r + 0.01 * RAD_PER_DEG, c)),
    Fault("temperature out of range", 10.0, ("calibration",), rate=lambda r, _, __: (r, 90.0)),
    # ---- the bus
    Fault("both counters silent", 5.0, ("encoders",), frames=_nothing),
    Fault("both silent for long", 15.0, ("encoders",), frames=_nothing),
    Fault("left counter silent", 5.0, ("encoders.left",), frames=_only(RIGHT_ID)),
    Fault("right counter silent", 5.0, ("encoders.right",), frames=_only(LEFT_ID)),
    Fault("interface down, up", 5.0, ("encoders.port",), 0.1, frames=_nothing,
          port=("encoders.port", "lost can0: Network is down")),
    Fault("bus error frames", 5.0, ("encoders.port",), 0.1, port=("encoders.port", _bus_error(bytes((0, 0x10))))),
    Fault("frames too short", 5.0, ("encoders.wrong_length",), frames=_short),
    Fault("foreign frames", 5.0, ("encoders.foreign",),
          frames=_with(lambda f: f._replace(can_id=FOREIGN_ID, data=b"?" * 8), 50)),
    Fault("emergency messages", 5.0, ("encoders.emergencies",),
          frames=_with(lambda f: f._replace(can_id=EMERGENCY_ID, data=b"\x10\x10" + bytes(6)))),
    Fault("frames doubled", 10.0, ("encoders.right_not_newer",), frames=_with(lambda f: f)),
    Fault("frames in wrong order", 10.0, ("encoders.left_not_newer",), frames=_swapped),
    Fault("frames read late", 10.0, ("encoders",), 2.0, frames=_late),
    # ---- what the counters say
    Fault("node restarts", 30.0, ("encoders.left_restarts",), frames=_once_restarted, travel=_from_zero),
    # One step in seven looks like motion that the robot can make: then the two headings disagree.
    Fault("counter to zero, unannounced", 30.0, ("encoders.left_jumps", "agreement"), travel=_from_zero),
    Fault("counter jumps", 10.0, ("encoders.left_jumps",), travel=_preset),
    Fault("counts doubled, left", 10.0, ("agreement", "encoders.left_jumps"), 2.0, travel=_grown(2.0)),
    Fault("counter stuck, left", 10.0, ("agreement",), 2.0, travel=_grown(0.0)),
    Fault("one wheel slips by 30 %", 10.0, ("agreement",), 2.0, travel=_grown(1.3)),
    Fault("both wheels slip by 30 %", 5.0, travel=_grown(1.3, also_right=True),
          unseen="both slip alike, so that gyro and wheels agree; the wheels' noise is configured for good ground"),
    # ---- the host
    Fault("host stands still", 2.0, stalls=True),
)  # fmt: skip
