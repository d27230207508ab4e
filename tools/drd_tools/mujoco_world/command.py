"""`drd simulate --world mujoco`: a drive in which slip and effective tread emerge from contacts."""

import argparse
import math
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

import numpy as np

from drd.commands import command, number, whole, writing
from drd_tools.mujoco_world.ground import Ground
from drd_tools.mujoco_world.missions import MISSIONS
from drd_tools.mujoco_world.vehicle import Vehicle
from drd_tools.simulate.conditions import Reference

DESCRIPTION = """\
Drive a four-wheel skid-steer robot of 60 kg in MuJoCo's contact physics and record its sensors. The motion shares no
formula with the other simulated world: effective tread, slip and lateral motion are not prescribed but emerge, and are
measured and printed. robot.yaml states the geometric track width and wheel radius.

The output folder is a recording as read by `drd replay` and `drd evaluate`, together with the ground truth:
  robot.yaml, fog.csv, encoders.csv, reference.csv     nominal robot and sensor readings
  truth.yaml, truth.csv, emerged.png                   what emerged, manoeuvre by manoeuvre; the true path at 50 Hz
"""
EXAMPLES = """\
examples:
  drd simulate --world mujoco --mission circles --output run_11
  drd simulate --world mujoco --mission square-cw --seconds 300 --friction 0.4 --bumps 0.5 --seed 3 --output run_12
  drd simulate --world mujoco --mission slalom --payload 30 --reference sparse:30 --output run_13

It needs the extra: pip install 'drd[tools,mujoco]'.
"""
STAND_S: Final = 10.0


def main(argv: list[str]) -> int:
    """Run the command. Returns exit code 0, or 2 for bad usage or without MuJoCo. Raises ConfigError on bad input."""
    chosen = _parser().parse_args(argv)
    try:
        return _run(chosen)
    except ModuleNotFoundError as error:
        if error.name != "mujoco":
            raise
        text = "the Python package mujoco is missing; install it: pip install 'drd[mujoco]'"
        print(f"drd simulate: {text}", file=sys.stderr)
        return 2


def _run(chosen: argparse.Namespace) -> int:
    from drd_tools.mujoco_world import files, measure, picture, sensors, world  # noqa: PLC0415  # mujoco may be missing

    reference, vehicle = Reference.parse(chosen.reference), Vehicle(payload_kg=chosen.payload)
    ground = Ground(friction=chosen.friction, patch_friction=chosen.patches, bumps_per_m=chosen.bumps)
    began_s = time.perf_counter()
    motion = world.drive(vehicle, ground, chosen.mission, chosen.seconds, STAND_S, chosen.seed)
    took_s = time.perf_counter() - began_s
    nominal = sensors.nominal_of(vehicle, chosen.output.name, STAND_S)
    readings = sensors.read_sensors(motion, reference, chosen.seed, nominal)
    blocks = measure.make_blocks(motion, vehicle)
    found, expected = measure.manoeuvres(blocks), measure.coulomb_tread_ratio(vehicle)
    about = {
        "mission": chosen.mission,
        "seed": chosen.seed,
        "duration_s": float(motion.time_s[-1]),
        "vehicle": {name: list(v) if isinstance(v, tuple) else v for name, v in asdict(vehicle).items()},
        "ground": asdict(ground),
        "gyro": sensors.gyro_truth(readings),
    }
    files.write_folder(chosen.output, readings, motion, files.truth_of(found, about))
    title = f"MuJoCo: {chosen.mission}, {motion.time_s[-1]:g} s, {vehicle.total_kg:g} kg, friction {ground.friction:g}"
    title += f" and {ground.patch_friction:g}" if ground.patch_friction is not None else ""
    title += f", {ground.bumps_per_m:g} bumps per metre" if ground.bumps_per_m else ""
    with writing(chosen.output):
        picture.draw(chosen.output / "emerged.png", title, motion, blocks, found, vehicle.track_m, expected)
    distance_m = float(np.abs(blocks.speed_m_s).sum() * measure.BLOCK_S)
    print(f"Mission {chosen.mission}: {motion.time_s[-1]:g} s, {distance_m:.1f} m, {vehicle.total_kg:g} kg; ", end="")
    print(f"simulated in {took_s:.1f} s, {motion.time_s[-1] / took_s:.0f} times faster than real.\n")
    print("\n".join(table(found, vehicle, expected)))
    print(
        f"\nwrote {chosen.output} with emerged.png; next: drd replay {chosen.output} --output {chosen.output.name}.csv"
    )
    return 0


def table(found: Sequence[Any], vehicle: Vehicle, expected: float) -> list[str]:
    """Lines of the results by kind of manoeuvre: medians, and the range of the tread.

    `expected`: ratio of effective tread and track for Coulomb friction.
    """
    lines = [
        f"What emerged, medians (track {vehicle.track_m:g} m; ideal friction and equal loads give the ratio "
        f"{expected:.3f}; the tyres' deflection counts as slip):",
        f"  {'':11} {'number':>6} {'tread / m':>22} {'ratio':>6} {'slip / %':>9} {'v_y/(v w) / s':>14} "
        f"{'centre ahead / m':>17} {'left / m':>9} {'right / m':>10}",
    ]
    for kind in sorted({m.kind for m in found}):
        rows = np.array([
            (m.tread_m, m.slip, m.lateral_s, m.ahead_m, m.left_m, m.right_m) for m in found if m.kind == kind
        ])  # fmt: skip
        tread, slip, lateral, ahead, left, right = np.median(rows, axis=0).tolist()
        low, high = rows[:, 0].min(), rows[:, 0].max()
        span = f" ({low:.3f} to {high:.3f})" if math.isfinite(tread) else ""
        lines.append(
            f"  {kind:11} {len(rows):6} {_cell(tread, 3) + span:>22} {_cell(tread / vehicle.track_m, 3):>6} "
            f"{_cell(100.0 * slip, 2):>9} {_cell(lateral, 3):>14} {_cell(ahead, 3):>17} {_cell(left, 3):>9} "
            f"{_cell(right, 3):>10}"
        )
    return lines if found else [*lines[:1], "  nothing: no manoeuvre was long enough"]


def _cell(value: float, decimals: int) -> str:
    return f"{value:.{decimals}f}" if math.isfinite(value) else "-"


def _parser() -> argparse.ArgumentParser:
    missions = "\n".join(f"  {name:<12} {mission.text}" for name, mission in MISSIONS.items())
    epilog = f"missions, each from the origin and back:\n{missions}\n\n{EXAMPLES}"
    parser = command("drd simulate --world mujoco", DESCRIPTION, epilog)
    add: Any = parser.add_argument
    add("--world", choices=("mujoco",), required=True, help="this world")
    add("--mission", choices=tuple(MISSIONS), default="circles", metavar="NAME", help="see below (default circles)")
    add("--seconds", type=number(11.0, 3600.0), metavar="S", help="cut at S, lap after lap (default: one whole lap)")
    add("--seed", type=whole(0), default=0, metavar="N", help="other noise, patches and bumps (default 0)")
    add("--friction", type=number(0.1, 2.0), default=0.8, metavar="MU", help="of tyre on ground (default 0.8)")
    add("--patches", type=number(0.1, 2.0), metavar="MU", help="one square of 2 m in three has this friction instead")
    add("--bumps", type=number(0.0, 10.0), default=0.0, metavar="N", help="stones of 3 to 12 mm per metre of path")
    add("--payload", type=number(0.0, 100.0), default=0.0, metavar="KG", help="stands 0.15 m behind the middle")
    add("--reference", default="full", metavar="WHEN",
        help="full (10 Hz, default), sparse:SECONDS, ends or none")  # fmt: skip
    add("--output", type=Path, required=True, metavar="DIR", help="folder for the recording")
    return parser
