"""`drd fleet simulate`: simulate a fleet with a known history."""

import json
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any, Final

import yaml
from tqdm import tqdm

from drd.commands import command, number, whole, writing
from drd.config.schema import ConfigError
from drd.effects.catalogue import catalogue
from drd_tools.fleet.histories import BATCHES, BEGIN, PLACES, Drive, Fleet, draw, maintenance_rows, summaries
from drd_tools.processes import called
from drd_tools.simulate.conditions import Conditions, stream
from drd_tools.simulate.files import write_folder
from drd_tools.simulate.missions import make_drive
from drd_tools.simulate.robot import DEFAULT
from drd_tools.simulate.sensors import Effects
from drd_tools.simulate.simulator import simulate
from drd_tools.simulate.truth import make_truth

# Driven alternately: together they show every constant, none of them alone does.
MISSIONS: Final = ("warehouse", "field", "eights")
SECONDS: Final = 120.0
LOADS: Final = 4  # recordings that a process is given at once
DESCRIPTION = """\
Simulate a fleet with a known history: slow leaks, tyres that change suddenly or are swapped, replaced gyros, a floor
that differs, one that is relaid, a gyro batch that deviates and one that ages, seasons, wear, maintenance without
effect, and faulty recordings. Each robot drives on nine of ten days.

The output folder holds
  recordings/ROBOT/TIME_PLACE/     recordings as drd simulate writes them, of two minutes (with --summaries: none)
  robots.yaml, maintenance.csv     for drd fleet update
  truth.json                       all events, and the true constants of each recording
  store/                           with --summaries: a store with the constants that a diagnosis would have found
"""
EXAMPLES = """\
examples:
  drd fleet simulate --robots 40 --days 90 --summaries --output out/fleet
  drd fleet report out/fleet/store --output out/report
  drd fleet simulate --robots 3 --days 10 --output out/small
  drd fleet update out/small/recordings --store out/small/store --robots out/small/robots.yaml \\
      --maintenance out/small/maintenance.csv

--summaries draws the constants of each recording instead of simulating it: their sigma is that of the wheels'
calibrator after two minutes (see fleet/histories.py), with a scatter of 20 %, errors of one sigma with heavy
tails, and one recording in a hundred that is off by 5 to 15 sigma.

Exit code: 0 done, 2 bad usage or input.
"""


def main(argv: list[str]) -> int:
    """Run the command. Raises ConfigError on bad input."""
    parser = command("drd fleet simulate", DESCRIPTION, EXAMPLES)
    add: Any = parser.add_argument
    add("--robots", type=whole(1), default=40, metavar="N", help="robots (default 40)")
    add("--days", type=whole(1), default=90, metavar="N", help="days (default 90)")
    add("--seed", type=whole(0), default=0, metavar="N", help="seed of the history (default 0)")
    add("--seconds", type=number(30.0, 3600.0), default=SECONDS, metavar="S", help="of each recording (default 120)")
    add("--summaries", action="store_true", help="only the constants of each recording, drawn directly")
    add("--jobs", type=whole(1), default=2, metavar="N", help="processes (default 2)")
    add("--output", type=Path, required=True, metavar="DIR", help="folder for the fleet")
    chosen = parser.parse_args(argv)
    fleet = draw(chosen.robots, chosen.days, chosen.seed)
    with writing(chosen.output):
        if (chosen.output / "recordings").exists() or (chosen.output / "store").exists():
            raise ConfigError("--output", "", "a folder without a fleet", str(chosen.output))
        chosen.output.mkdir(parents=True, exist_ok=True)
        write_about(fleet, chosen.output)
        if chosen.summaries:
            write_store(fleet, chosen.seed, chosen.output / "store")
        else:
            _record(fleet, chosen.seed, chosen.seconds, chosen.output / "recordings", chosen.jobs)
    print(f"wrote {chosen.output}: {len(fleet.drives)} recordings of {chosen.robots} robots, {len(fleet.happenings)} "
          f"events, {len(fleet.maintenance)} maintenance entries")  # fmt: skip
    return 0


def write_about(fleet: Fleet, folder: Path) -> None:
    """Write robots.yaml, maintenance.csv and truth.json. Raises OSError."""
    when = r"/(?P<year>\d{4})(?P<month>\d\d)(?P<day>\d\d)T(?P<hour>\d\d)(?P<minute>\d\d)(?P<second>\d\d)_"
    rules: list[dict[str, Any]] = [
        {"recordings": [f"{robot}/*"], "robot": robot, "batch": batch, "start_in_name": when}
        for robot, batch in fleet.batch.items()
    ]
    rules += [{"recordings": [f"*_{place}"], "place": place} for place in PLACES]
    (folder / "robots.yaml").write_text(yaml.safe_dump(rules, sort_keys=False), "utf-8")
    lines = ["date,robot,what", *(f"{row['date']},{row['robot']},{row['what']}" for row in fleet.maintenance)]
    (folder / "maintenance.csv").write_text("\n".join(lines) + "\n", "utf-8")
    truth = {
        "begin": BEGIN.isoformat(),
        "batches": list(BATCHES),
        "happenings": [asdict(h) for h in fleet.happenings],
        "recordings": [{**asdict(d), "folder": folder_of(d)} for d in fleet.drives],
    }
    (folder / "truth.json").write_text(json.dumps(truth, indent=1) + "\n", "utf-8")


def write_store(fleet: Fleet, seed: int, folder: Path) -> None:
    """Write a store with the drawn constants. Raises ConfigError, OSError."""
    from drd_tools.fleet.store import Store  # noqa: PLC0415  # pyarrow is an extra

    by_recording: dict[str, list[dict[str, Any]]] = {}
    for row in summaries(fleet, seed):
        by_recording.setdefault(row["recording"], []).append(row)
    store, labels = Store(folder), ("recording", "robot", "place", "batch", "start_utc", "duration_s")
    with store.writing():
        store.put_all([
            {"recordings": [{**{k: rows[0][k] for k in labels}, "verdict": "drawn"}], "constants": rows}
            for rows in by_recording.values()
        ])  # fmt: skip
        store.keep_maintenance(maintenance_rows(fleet))


def folder_of(drive: Drive) -> str:
    """Path of a recording below recordings/; it contains robot, start and place."""
    return f"{drive.robot}/{drive.start_utc:%Y%m%dT%H%M%S}_{drive.place}"


def _record(fleet: Fleet, seed: int, seconds: float, folder: Path, jobs: int) -> None:
    calls = [partial(record, drive, k, seed, seconds, folder) for k, drive in enumerate(fleet.drives)]
    for _ in tqdm(called(calls, jobs, LOADS), total=len(calls), desc="simulating", unit="recording", disable=None):
        pass


def record(drive: Drive, number: int, seed: int, seconds: float, folder: Path) -> None:
    """Simulate a recording and write its folder. Raises OSError."""
    mission = MISSIONS[number % len(MISSIONS)]
    truth = make_truth(make_drive(mission, seconds, DEFAULT.standstill_at_start_s), "warmup")
    random = stream(seed, f"recording {number}")
    nominal = replace(DEFAULT, name=drive.robot)
    own, effects = int(random.integers(2**31)), effects_of(drive.constants)
    made = simulate(truth, nominal, effects, Conditions(), own, drive.recording)
    write_folder(made, folder / folder_of(drive), {"mission": mission, "constants": drive.constants})


def effects_of(constants: dict[str, float]) -> Effects:
    """Effects of the catalogue with these constants, in SI. A negative lag is the gyro's."""
    c, lag_s = constants, constants["lag_s"]
    found: list[tuple[str, dict[str, float | str]]] = [
        ("wheel_radius_error", {"left": c["radius_left"], "right": c["radius_right"]}),
        ("tread_error", {"k": c["tread"]}),
        ("gyro_scale_error", {"k": c["gyro_scale"]}),
        ("gyro_bias_temperature", {"b1": c["bias_per_c"], "b2": 0.0}),
        ("encoder_latency" if lag_s > 0.0 else "gyro_latency", {"delay": abs(lag_s)}),
    ]
    return tuple((catalogue()[name], values) for name, values in found)
