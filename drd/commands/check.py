"""`drd check CONFIG`: the values in force and their origins; with --live, how the robot is wired."""

import argparse
import importlib
from typing import Any, Final

from drd.commands import command, config_argument, number, placed
from drd.config.file import load_config
from drd.config.keys import Config
from drd.config.schema import keys, meanings, values
from drd.output.exposure import exposure
from drd.output.session import check_output, unreadable_files
from drd.pipeline import Pipeline

LIVE_OPTIONS: Final = ("seconds", "drove", "turned", "distance")
DEFAULT_S: Final = 60.0
DESCRIPTION: Final = """\
Check a configuration and all files named in it, without opening a device. Prints each key in force with its value,
unit and origin.

With --live, open the configured ports instead (stop the daemon first) and monitor gyro and encoders while you push or
drive the robot. Nothing is published or recorded. Faults are printed with their evidence: gyro and wheels of opposite
sign, swapped sides, a side that counts backwards, a dead encoder, wrong counts per revolution, late or repeated values;
so is anything that could not be determined, with the manoeuvre that would determine it. Some faults look alike in the
samples: state how the robot moved (--drove, --turned, --distance) to distinguish them.
"""
EPILOG: Final = """\
examples:
  drd check mybot.yaml
  drd check --live mybot.yaml
  drd check --live mybot.yaml --drove forward --turned left --distance 2

Exit code: 0 good, 1 --live found a fault, 2 the configuration cannot be used.
"""


def main(argv: list[str]) -> int:
    """Print every key with value, unit and origin; load all files that the configuration names."""
    parser = _parser()
    arguments = parser.parse_args(argv)
    if not arguments.live and (given := [f"--{n}" for n in LIVE_OPTIONS if getattr(arguments, n) is not None]):
        parser.error(f"{given[0]} goes with --live")
    loaded, base = load_config(arguments.config), arguments.config.parent
    output = loaded.value.output.beside(base)
    with placed(loaded):
        if arguments.live:
            live = importlib.import_module("drd.commands.live_check")
            said = live.statement_of(arguments)
            code: int = live.live_check(loaded.value, base, arguments.seconds or DEFAULT_S, said)
            return code
        pipeline = Pipeline(loaded.value, base, lambda *_: None)
        check_output(output)
    meant = meanings(Config) if arguments.explain else {}
    in_force = values(loaded.value)
    rows = [(path, _shown(in_force[path]), key.unit, loaded.origins[path]) for path, key in keys(Config)]
    width, value_width = (max(len(row[i]) for row in rows) for i in (0, 1))
    for path, value, unit, origin in rows:
        print(f"{path:{width}}  {value:{value_width}}  {unit:14}  {origin}".rstrip())
        if path in meant:
            print(f"{'':{width}}  {meant[path]}")
    if (calibration := pipeline.calibration) is not None:
        (low, high), (cold, warm) = calibration.rate_range_deg_s, calibration.temperature_range_c
        source = ", ".join(f"{k} {v}" for k, v in calibration.provenance.items() if not k.startswith("sha256"))
        print(f"calibration holds from {low:.4g} to {high:.4g} deg/s and {cold:.4g} to {warm:.4g} degC: {source}")
    print(f"the gyro's scale is {'' if pipeline.estimator.estimates_gyro_scale else 'not '}estimated")
    print(f"wheel travel is resolved to {pipeline.encoders.resolution_m * 1e3:.4g} mm")
    if output.ros2 and not output.connect and output.zenoh_config is None:
        print(
            "note: ROS 2's router is usually at tcp/localhost:7447; name it in output.connect and change output.listen"
        )
    for text in exposure(output) + unreadable_files(output):
        print(f"note: {text}")
    print(f"{arguments.config}: good")
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = command("drd check", DESCRIPTION, EPILOG, [config_argument()])
    add = parser.add_argument
    add("--explain", action="store_true", help="also print what each key means")
    add("--live", action="store_true", help="monitor gyro and encoders and check their wiring")
    add("--seconds", type=number(1.0, 86_400.0), metavar="S", help=f"duration, s (default {DEFAULT_S:g})")
    add("--drove", choices=("forward", "backward"), help="your statement: direction of the straight driving")
    add("--turned", choices=("left", "right"), help="your statement: direction of most turns")
    add("--distance", type=number(0.1, 1e5), metavar="M", help="your statement: net distance driven, m")
    return parser


def _shown(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if value is None:
        return "null"
    if isinstance(value, tuple):
        return f"[{', '.join(map(str, value))}]"
    return f"{value:.12g}" if isinstance(value, float) else str(value)
