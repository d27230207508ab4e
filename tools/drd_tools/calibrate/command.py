"""`drd calibrate`: what to calibrate decides which command runs."""

import argparse
import importlib
from collections.abc import Callable
from typing import Final

KINDS: Final = {
    "gyro": ("drd_tools.calibrate.gyro.command", "the gyro's error function, from a rate table"),
    "noise": ("drd_tools.calibrate.noise.command", "the gyro's noise and bias, from a log at standstill"),
    "wheels": ("drd_tools.calibrate.wheels.command", "wheel radii and tread, from UMBmark or recordings"),
}


def main(argv: list[str]) -> int:
    """Hand over to the kind's own command; returns its exit code."""
    width = max(map(len, KINDS))
    parser = argparse.ArgumentParser(
        prog="drd calibrate",
        description="Measure what the daemon otherwise has to believe.",
        epilog="kinds:\n"
        + "\n".join(f"  {name:{width}}  {summary}" for name, (_, summary) in KINDS.items())
        + "\n\n`drd calibrate KIND --help` explains each.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("kind", choices=tuple(KINDS), metavar="KIND", help="one of the kinds below")
    parser.add_argument("arguments", nargs=argparse.REMAINDER, metavar="...", help="the kind's own arguments")
    chosen = parser.parse_args(argv)
    call: Callable[[list[str]], int] = importlib.import_module(KINDS[chosen.kind][0]).main
    return call(chosen.arguments)
