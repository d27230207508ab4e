"""`drd calibrate`: run the command for the kind of calibration."""

from typing import Final

from drd.commands import hand_over

KINDS: Final = {
    "gyro": ("drd_tools.calibrate.gyro.command", "the gyro's error function, from a rate table"),
    "noise": ("drd_tools.calibrate.noise.command", "the gyro's noise and bias, from a log at standstill"),
    "wheels": ("drd_tools.calibrate.wheels.command", "wheel radii and tread, from UMBmark or recordings"),
}


def main(argv: list[str]) -> int:
    """Run the command of the chosen kind; return its exit code."""
    return hand_over("drd calibrate", "Measure the values that the daemon otherwise assumes.", "kind", KINDS, argv)
