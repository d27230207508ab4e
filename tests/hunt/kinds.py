"""Kinds of events: what can happen to robot, sensors, lines and host in a drive, within which sizes."""

from dataclasses import dataclass
from typing import Final

SLIP_BOTH: Final = "both wheels slip alike"
SIDEWAYS: Final = "moved sideways"
# Classes of what no sensor could know, beside these two.
GYRO_LIES: Final = "the gyro reads wrong"  # beyond the gate the wheels are taken to slip, which is far more usual
TURNS_LATE: Final = "a line turns late"  # how late a sensor is, is learned over a minute
NO_GYRO: Final = "one wheel lies, no gyro"
UNCOMPARED: Final = "one wheel lies, heading: gyro"  # in motion the wheels' heading is the gyro's: nothing is compared
UNLEARNED: Final = "one wheel slips, or turned by hand, before the tread is learned"  # in a curve: another tread's turn
JUMPS: Final = "a counter jumps by less than the robot can drive"  # believed until the gyro's next sample


@dataclass(frozen=True)
class Kind:
    """Sizes are drawn log-uniformly from `low` to `high` in `unit`, of both signs where `signed`.

    `traces`: sources of reasons or counters (part.name), of which one must tell of it where it lasts a second.
    `named`: the class of what no sensor could know. `sided`: one wheel's. `unseen`: nothing shows it before the gyro's
    next sample.
    """

    low: float = 1.0
    high: float = 1.0
    unit: str = ""
    signed: bool = False
    traces: tuple[str, ...] = ()
    named: str = ""
    sided: bool = False
    unseen: bool = False
    longest_s: float = 15.0


GYRO: Final = {
    "gyro bias steps": Kind(0.005, 5.0, "deg/s", signed=True, named=GYRO_LIES),
    "gyro scale steps": Kind(0.001, 0.2, "", signed=True, named=GYRO_LIES),
    "gyro stuck": Kind(named=GYRO_LIES),
    "gyro noise": Kind(1.5, 30.0, "x"),
    "gyro spikes": Kind(1.0, 80.0, "deg/s", signed=True, named=GYRO_LIES),
    "gyro invalid": Kind(),
    "gyro silent": Kind(traces=("fog",)),
    "gyro port lost": Kind(traces=("fog.port",)),
    "gyro packets lost": Kind(0.02, 0.9, "of them"),
    "gyro packets flipped": Kind(0.02, 1.0, "of them", traces=("fog.bad_checksum", "fog.framing_errors",
        "fog.foreign_bytes", "fog.implausible", "agreement", "fog", "fog.malformed_lines")),
    "gyro packets doubled": Kind(0.05, 1.0, "of them"),
    "gyro in bunches": Kind(0.03, 0.6, "s"),
    "gyro late": Kind(0.02, 0.5, "s", named=TURNS_LATE),
    "garbage on the line": Kind(1.0, 30.0, "bytes", traces=("fog.foreign_bytes", "fog.framing_errors",
        "fog.malformed_lines")),
}  # fmt: skip
WHEELS: Final = {
    "one wheel slips": Kind(0.005, 1.0, "", signed=True, sided=True, unseen=True),
    SLIP_BOTH: Kind(0.01, 1.0, "", signed=True, named=SLIP_BOTH),
    "counter to zero": Kind(sided=True, named=JUMPS),
    "counter jumps": Kind(0.01, 2.0, "m", signed=True, sided=True, named=JUMPS),
    "node restarts": Kind(sided=True),
    "both counters silent": Kind(traces=("encoders",)),
    "one counter silent": Kind(sided=True, traces=("encoders.left", "encoders.right", "encoders")),
    "bus lost": Kind(traces=("encoders.port",)),
    "frames lost": Kind(0.02, 0.9, "of them"),
    "frames doubled": Kind(0.05, 1.0, "of them"),
    "frames late": Kind(0.02, 1.0, "s"),
    "frames stamped late": Kind(0.01, 0.3, "s", named=TURNS_LATE),
    "frames swapped": Kind(0.05, 1.0, "of them"),
    "foreign frames": Kind(1.0, 30.0, "a cycle", traces=("encoders.foreign", "encoders.wrong_length")),
}  # fmt: skip
OTHERS: Final = {
    "other ground": Kind(0.02, 0.5, "of the tread", signed=True),
    SIDEWAYS: Kind(0.01, 0.3, "m/s", signed=True, named=SIDEWAYS),
    "turned by hand": Kind(1.0, 40.0, "deg/s", signed=True, unseen=True),
    "host stands still": Kind(longest_s=4.0),
    "set_pose": Kind(0.001, 1.0, "m"),
    "reset": Kind(),
    "calibrate_bias": Kind(),
}
KINDS: Final = {**GYRO, **WHEELS, **OTHERS}
# What is given once, at the event's time.
MOMENTS: Final = ("set_pose", "reset", "calibrate_bias", "counter to zero", "counter jumps", "node restarts")
# Some or all of the gyro's samples are missing.
AWAY: Final = (
    "gyro silent", "gyro port lost", "gyro invalid", "gyro packets lost", "gyro packets flipped", "gyro in bunches",
)  # fmt: skip
# Without a gyro nothing contradicts these.
UNCONTRADICTED: Final = (
    "one wheel slips", "counter to zero", "counter jumps", "node restarts", "other ground", "turned by hand",
)  # fmt: skip
