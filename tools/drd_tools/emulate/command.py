"""`drd emulate`: emulate the hardware of a configured robot."""

import argparse
import csv
import math
import signal
import threading
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from drd.commands import command, number, whole, writing
from drd.config.file import load_config
from drd_tools.emulate.hardware import Emulator, Truth
from drd_tools.simulate.missions import Drive, demo_drive, make_drive

DESCRIPTION: Final = """\
Emulate the gyro and the wheel encoders of a configuration on a path in real time, with the noise of their datasheets.
The ports of the gyro and of an slcan adapter become pseudo-terminals, linked at the configured paths, which must be
free; for socketcan, create a vcan interface first. Start drd with the same configuration to see it work.
"""
EPILOG: Final = """\
examples:
  drd emulate config/demo.yaml                           and in other terminals: drd run config/demo.yaml, drd watch
  drd emulate mybot.yaml --path square --truth truth.csv
  ip link add dev vcan0 type vcan && ip link set vcan0 up && drd emulate mybot.yaml     encoders.channel: vcan0

Exit code: 0 done, 1 a device failed during the run, 2 bad usage, or the devices or FILE.csv cannot be created.
"""
# Length of the path without --seconds.
DEMO_S = 600.0


def main(argv: list[str]) -> int:
    """Run the command. Returns the exit code: 0, or 1 if the emulator failed. Raises ConfigError."""
    arguments = _parser().parse_args(argv)
    if arguments.truth is not None:  # checked before a long drive
        with writing(arguments.truth, "a file to write to"), arguments.truth.open("a"):
            pass
    emulator = Emulator(
        load_config(arguments.config).value,
        arguments.config.parent,
        _drive(arguments),
        seed=arguments.seed,
        allow_real_bus=arguments.real_bus,
    )
    emulator.heartbeat_s, emulator.nodes_autostart = arguments.heartbeat, not arguments.wait_for_start
    with _until_signal() as stopped, emulator:
        for name, place in emulator.places.items():
            print(f"{name}: {place}", flush=True)
        failed = _wait(emulator, stopped, arguments.seconds)
    print(", ".join(f"{name}={count}" for name, count in emulator.counters.items()), flush=True)
    if arguments.truth is not None:
        with writing(arguments.truth, "a file to write to"):
            write_truth(arguments.truth, emulator.truth)
    return 1 if failed else 0


def write_truth(file: Path, rows: Iterable[Truth]) -> None:
    """Write the true path as CSV; the first line names the columns. Raises OSError."""
    with file.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(Truth._fields)
        writer.writerows(rows)


def _parser() -> argparse.ArgumentParser:
    parser = command("drd emulate", DESCRIPTION, EPILOG)
    add = parser.add_argument
    add("config", type=Path, metavar="CONFIG", help="the daemon's configuration file")
    add("--seconds", type=_seconds, metavar="N", help="stop after N seconds; otherwise at Ctrl-C or SIGTERM")
    add("--seed", type=whole(0), default=0, metavar="N", help="repeats the sensors' noise (default 0)")
    text = (
        f"demo: figures of eight for --seconds, or {DEMO_S:g} s (default); square: 210 m with rounded corners in "
        "about three minutes. Both begin with 10 s of standstill (a short demo: a third of it); at the end "
        "the robot stands"
    )
    add("--path", choices=("demo", "square"), default="demo", help=text)
    add("--truth", type=Path, metavar="FILE.csv", help="write the true path there at the end")
    text = "CANopen encoders send a heartbeat this often, s; a master may set object 1017h too (default 0: none)"
    add("--heartbeat", type=number(0.0), default=0.0, metavar="S", help=text)
    text = "CANopen encoders stay pre-operational until NMT start, as with encoders.cia406.start_nodes"
    add("--wait-for-start", action="store_true", help=text)
    text = "allow a CAN bus that is not virtual; others on it will believe the frames"
    add("--real-bus", action="store_true", help=text)
    return parser


def _seconds(text: str) -> float:
    value = float(text)
    if not (math.isfinite(value) and 0 < value <= 86_400):
        raise argparse.ArgumentTypeError(f"more than 0 and at most 86400, got {text}")
    return value


def _drive(arguments: argparse.Namespace) -> Drive:
    if arguments.path == "square":
        return make_drive("square-ccw")
    seconds = min(arguments.seconds or DEMO_S, DEMO_S)
    return demo_drive(seconds, stand_s=min(10.0, seconds / 3))


def _wait(emulator: Emulator, stopped: threading.Event, seconds: float | None) -> bool:
    """Wait for a signal, the end of the time, or the emulator's failure, which is reported as True."""
    end_s = math.inf if seconds is None else time.monotonic() + seconds
    while emulator.is_running and (left_s := end_s - time.monotonic()) > 0:
        if stopped.wait(min(left_s, 0.5)):
            break
    return not emulator.is_running


@contextmanager
def _until_signal() -> Iterator[threading.Event]:
    """Provide an event that Ctrl-C and SIGTERM set; restore the previous handlers at the end."""
    stopped = threading.Event()
    numbers = (signal.SIGINT, signal.SIGTERM)
    before = [signal.signal(number, lambda *_: stopped.set()) for number in numbers]
    try:
        yield stopped
    finally:
        for number, handler in zip(numbers, before, strict=True):
            signal.signal(number, handler)
