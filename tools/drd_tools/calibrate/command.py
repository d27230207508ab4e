"""`drd calibrate`: what to calibrate decides which command runs."""

import argparse
import importlib
from collections.abc import Callable
from typing import Final

from drd.commands import command

KINDS: Final = {
    "gyro": ("drd_tools.calibrate.gyro.command", "the gyro's error function, from a rate table"),
    "noise": ("drd_tools.calibrate.noise.command", "the gyro's noise and bias, from a log at standstill"),
    "wheels": ("drd_tools.calibrate.wheels.command", "wheel radii and tread, from UMBmark or recordings"),
}


def main(argv: list[str]) -> int:
    """Hand over to the kind's own command; returns its exit code."""
    width = max(map(len, KINDS))
    kinds = "\n".join(f"  {name:{width}}  {summary}" for name, (_, summary) in KINDS.items())
    epilog = f"kinds:\n{kinds}\n\n`drd calibrate KIND --help` explains each."
    parser = command("drd calibrate", "Measure what the daemon otherwise has to believe.", epilog)
    parser.add_argument("kind", choices=tuple(KINDS), metavar="KIND", help="one of the kinds below")
    parser.add_argument("arguments", nargs=argparse.REMAINDER, metavar="...", help="the kind's own arguments")
    chosen = parser.parse_args(argv)
    call: Callable[[list[str]], int] = importlib.import_module(KINDS[chosen.kind][0]).main
    return call(chosen.arguments)
