"""`drd simulate`: simulate a drive and record it."""

import argparse
import math
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

from drd.commands import command, number, whole, writing
from drd.config.file import load_config
from drd.config.keys import Config
from drd.config.schema import Loaded
from drd_tools.replay.nominal import configuration
from drd_tools.report.terminal import columns
from drd_tools.simulate.conditions import GROUNDS, Conditions, Reference
from drd_tools.simulate.files import effect_rows, read_true_motion, read_truth, write_folder
from drd_tools.simulate.missions import MISSIONS, make_drive
from drd_tools.simulate.robot import read_robot
from drd_tools.simulate.sensors import Effects
from drd_tools.simulate.simulator import Simulated, simulate
from drd_tools.simulate.temperature import PROFILES
from drd_tools.simulate.truth import make_truth

DESCRIPTION = """\
Simulate a drive: the true motion at 500 Hz and the sensor readings. Noise is that of the datasheets in robot.yaml;
effects of the catalogue come from the model file. The same arguments give bit-identical files, and the noise stays the
same when effects are added.

The output folder is a recording as read by `drd replay` and `drd evaluate`, together with the ground truth:
  robot.yaml, fog.csv, encoders.csv, reference.csv     nominal robot and sensor readings
  truth.yaml, truth.csv                                ground truth: effects and their values, the path at 50 Hz
  report.html, simulated.png, effects.png              what was simulated, and the influence of the effects
A file name ending in .mcap gives a recording of the daemon instead: raw bytes and frames, samples, poses.
"""
WORLDS = ("formulas", "mujoco")
EXAMPLES = """\
examples:
  drd simulate --mission warehouse --seconds 900 --seed 7 --output run_07
  drd simulate --mission square-cw --model model.yaml --temperature cycle:10:35 --reference sparse:60 --output run_08
  drd simulate --mission field --ground grass --output run_09.mcap         then: drd replay run_09.mcap
  drd simulate --mission eights --live config/canopen.yaml                 be the hardware, in real time

model.yaml: keys that replace those of robot.yaml (also in the output folder), and the effects that robot.yaml does not
describe, in the units of the catalogue:
  effects:
    - effect: gyro_scale_error
      parameters: {k: 0.002}
    - effect: wheel_radius_error
      parameters: {left: 0.001, right: {value: -0.0005, std: 0.0002}}

Exit code: 0 done, 2 bad usage or input.
"""


def main(argv: list[str]) -> int:
    """Run the command. Returns the exit code: 0, or 2 for bad usage. Raises ConfigError on bad input."""
    parser = _parser()
    if _world(argv) == "mujoco":
        from drd_tools.mujoco_world.command import main as other_world  # noqa: PLC0415  # an optional extra

        return other_world(argv)
    chosen = parser.parse_args(argv)
    return _draw(chosen.draw) if chosen.draw is not None else _run(chosen)


def _run(chosen: argparse.Namespace) -> int:
    began_s = time.perf_counter()
    nominal, effects = read_robot(chosen.robot, chosen.model)
    drive = make_drive(chosen.mission, chosen.seconds, nominal.standstill_at_start_s)
    truth = make_truth(drive, chosen.temperature)
    conditions = _conditions(chosen)
    name = chosen.output.stem if chosen.output is not None else "live"
    simulated = simulate(truth, nominal, effects, conditions, chosen.seed, name)
    if chosen.live is not None:
        return _live(simulated, chosen)
    if chosen.output.suffix == ".mcap":
        return _mcap(simulated, chosen, began_s)
    without = simulate(truth, nominal, (), conditions, chosen.seed, name) if effects else None
    about = {"mission": chosen.mission, "temperature": chosen.temperature}
    write_folder(simulated, chosen.output, about, without)
    print(f"simulated and written in {time.perf_counter() - began_s:.2f} s\n")
    return _draw(chosen.output)


def _draw(folder: Path) -> int:
    """Print and draw the folder's contents."""
    from drd_tools.simulate.report import effect_table, sentences, write_report  # noqa: PLC0415  # matplotlib is slow

    about = read_truth(folder)
    print("\n".join(sentences(about, read_true_motion(folder))))
    print(*columns([row[:3] for row in effect_table(about)], text=range(3)), sep="\n")
    with writing(folder):
        write_report(folder)
    print(f"\nwrote {folder} with report.html; next: drd replay {folder} --output {folder.name}.csv")
    return 0


def _conditions(chosen: argparse.Namespace) -> Conditions:
    gyro, wheels, reference = chosen.noise
    late = replace(
        Reference.parse(chosen.reference), latency_s=chosen.reference_latency, lever_m=chosen.reference_lever
    )
    conditions = Conditions(
        gyro_noise=gyro,
        wheel_noise=wheels,
        reference_noise=reference,
        tails=chosen.tails,
        jitter_s=chosen.jitter,
        quantise=any(chosen.noise),
        reference=late,
        ground=GROUNDS[chosen.ground],
    )
    return conditions.stressed(chosen.seed) if chosen.stressed else conditions


def _configured(simulated: Simulated, file: Path | None) -> tuple[Loaded[Config], Path]:
    """The daemon's configuration: the file's, or the one that corresponds to robot.yaml."""
    if file is not None:
        return load_config(file), file.parent
    return Loaded(configuration(simulated.recording), {}), Path()


def _mcap(simulated: Simulated, chosen: argparse.Namespace, began_s: float) -> int:
    from drd_tools.emulate.raw import write_mcap  # noqa: PLC0415  # brings the daemon

    config, base = _configured(simulated, chosen.config)
    poses = write_mcap(chosen.output, simulated.recording, config, base)
    truth = simulated.truth
    print(f"{truth.duration_s:g} s, {truth.length_m:.1f} m; effects: {_names(simulated.effects)}")
    print(f"wrote {chosen.output} with {poses} poses in {time.perf_counter() - began_s:.1f} s; ", end="")
    print(f"next: drd replay {chosen.output}")
    return 0


def _live(simulated: Simulated, chosen: argparse.Namespace) -> int:
    from drd_tools.emulate.raw import drive_live  # noqa: PLC0415  # brings the daemon

    config, base = _configured(simulated, chosen.live)
    for sentence in drive_live(simulated.recording, config.value, base, allow_real_bus=chosen.real_bus):
        print(sentence, flush=True)
    return 0


def _names(effects: Effects) -> str:
    return ", ".join(row["effect"] for row in effect_rows(effects)) or "none"


def _parser() -> argparse.ArgumentParser:
    missions = "\n".join(f"  {name:<12} {mission.text}" for name, mission in MISSIONS.items())
    profiles = "\n".join(f"  {name:<12} {p.text} ({name}:{p.a_c:g}:{p.b_c:g})" for name, p in PROFILES.items())
    listed = f"missions (or a .csv file with x_m,y_m[,speed_m_s]):\n{missions}\n\n"
    listed += f"temperature profiles (or a .csv file with time_s,temperature_c):\n{profiles}\n\n"
    parser = command("drd simulate", DESCRIPTION, listed + EXAMPLES)
    add: Any = parser.add_argument
    add("--world", choices=WORLDS, default=WORLDS[0],
        help="formulas (default), or mujoco: contact physics, see `drd simulate --world mujoco --help`")  # fmt: skip
    add("--mission", default="warehouse", metavar="NAME", help="what is driven, see below (default warehouse)")
    add("--seconds", type=number(1.0, 86_400.0), metavar="S", help="laps, the last one cut (default: one lap)")
    add("--seed", type=whole(0), default=0, metavar="N", help="other noise (default 0)")
    add("--robot", type=Path, metavar="FILE", help="robot.yaml (default: a small skid-steer robot with an RD2100 gyro)")
    add("--model", type=Path, metavar="FILE", help="effects, and keys that replace robot.yaml's, see below")
    add("--temperature", default="warmup", metavar="NAME[:A[:B]]", help="of the gyro, see below (default warmup)")
    add("--reference", default="full", metavar="WHEN", help="full (10 Hz, default), sparse:SECONDS, ends or none")
    add("--ground", choices=tuple(GROUNDS), default="even", help="skid-steer: centres of rotation wander; bumps")
    add("--noise", type=_factors, default=(1.0, 1.0, 1.0), metavar="F[,F,F]",
        help="factors on the noise of gyro, wheels and reference; 0: perfect sensors (counts stay whole)")  # fmt: skip
    add("--tails", type=number(2.1, 1e6), default=math.inf, metavar="N",
        help="heavy tails: Student's t with N degrees of freedom (default: Gaussian)")  # fmt: skip
    add("--jitter", type=number(0.0, 1.0), default=0.0, metavar="S", help="scatter of the stamps (default 0)")
    add("--reference-latency", type=number(0.0, 1.0), default=0.0, metavar="S", help="age of the reference's poses")
    add("--reference-lever", type=_lever, default=(0.0, 0.0), metavar="X,Y", help="point it sees: forward, left, m")
    add("--stressed", action="store_true",
        help="noise unlike the datasheets', heavy tails, late reference off the centre")  # fmt: skip
    add("--config", type=Path, metavar="FILE", help="with .mcap: the daemon's configuration (default: robot.yaml's)")
    add("--real-bus", action="store_true", help="with --live: allow a CAN bus that is not virtual")
    add = parser.add_mutually_exclusive_group(required=True).add_argument
    add("--output", type=Path, metavar="DIR", help="folder for the recording, or a file that ends with .mcap")
    add("--live", type=Path, metavar="CONFIG", help="send it in real time to a daemon with this configuration")
    add("--draw", type=Path, metavar="DIR", help="only draw and report again what this folder holds")
    return parser


def _world(argv: list[str]) -> str:
    """Parse only --world, since each world has its own options."""
    parser = argparse.ArgumentParser(prog="drd simulate", add_help=False)
    parser.add_argument("--world", choices=WORLDS, default=WORLDS[0])
    chosen: str = parser.parse_known_args(argv)[0].world
    return chosen


def _factors(text: str) -> tuple[float, float, float]:
    values = tuple(number(0.0, 100.0)(part) for part in text.split(","))
    if len(values) == 1:
        values *= 3
    if len(values) != 3:
        raise argparse.ArgumentTypeError(f"one or three factors, got {text!r}")
    return values[0], values[1], values[2]


def _lever(text: str) -> tuple[float, float]:
    values = tuple(number(-10.0, 10.0)(part) for part in text.split(","))
    if len(values) != 2:
        raise argparse.ArgumentTypeError(f"expected forward,left in m, got {text!r}")
    return values[0], values[1]
