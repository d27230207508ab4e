"""`drd demo`: run the emulated hardware, the real daemon as a separate process, and a watcher for half a minute."""

import argparse
import contextlib
import json
import math
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import zenoh

from drd.arrays import Array, cumulative
from drd.commands import command
from drd.commands.watch import View
from drd.config.file import load_config
from drd.config.keys import Config
from drd.effects.catalogue import catalogue
from drd.effects.effect import Effect, Parameter, Values
from drd.output.session import isolated_config
from drd.units import S_PER_NS
from drd_tools.emulate.fault import Fault
from drd_tools.emulate.hardware import Emulator, Truth
from drd_tools.options import seed
from drd_tools.report.path import ErrorSeries, Mark, path_picture
from drd_tools.shipped import shipped_config
from drd_tools.simulate.missions import Drive, demo_drive
from drd_tools.simulate.route import STEP_S
from drd_tools.simulate.simulator import motion_along
from drd_tools.simulate.truth import make_truth
from drd_tools.trial.live_cases import WAY_M, seen_live, since, sized

# Extra standstill, for the daemon to start before it measures the bias.
STAND_MARGIN_S = 2.5
CONNECT_S = 15.0
# With --fault: length of the run, onset as a share of the distance, and detectability in sigmas within 100 m of it.
FAULT_SECONDS: Final = 240.0
FAULT_SHARE: Final = 0.45
FAULT_D: Final = 12.0
FAULT_TRIES: Final = 20
DESCRIPTION: Final = """\
Drive an emulated robot, estimate its pose with the real daemon, and draw the true and the estimated path, the error and
the published bound. Needs no hardware.
"""
EPILOG: Final = """\
examples:
  drd demo
  drd demo --seconds 120 --seed 3 --output out/demo.png
  drd demo --fault tyre_deflation       (four minutes: onset, naming and size in the picture)

Exit code: 0 done, 1 the daemon failed or gave no pose, 2 bad usage or configuration.
"""


class Heard(NamedTuple):
    """Poses, and the newest of the monitor's findings by the time at which they were named."""

    poses: list[dict[str, Any]]
    findings: dict[int, dict[str, Any]]


class Result(NamedTuple):
    """Result of the demo: columns time_s, x_m, y_m, heading_rad; the estimate also has bound_m."""

    truth: Array
    estimate: Array
    wheels: Array
    length_m: float

    @property
    def errors_m(self) -> Array:
        """Distance of the estimate from the truth, at the estimate's times."""
        at = self.truth_at(self.estimate[:, 0])
        return np.hypot(self.estimate[:, 1] - at[:, 0], self.estimate[:, 2] - at[:, 1])

    def truth_at(self, time_s: Array) -> Array:
        """True x, y, heading at these times; shape (n, 3)."""
        return np.column_stack([np.interp(time_s, self.truth[:, 0], self.truth[:, i]) for i in (1, 2, 3)])

    def sentence(self) -> str:
        """Summarise the errors in one line."""
        heading = self.estimate[-1, 3] - self.truth_at(self.estimate[-1:, 0])[0, 2]
        errors, wheels = self.errors_m, self.wheels
        true = self.truth_at(wheels[:, 0])
        alone = np.hypot(wheels[:, 1] - true[:, 0], wheels[:, 2] - true[:, 1])
        percent = 100 * errors[-1] / self.length_m
        return (
            f"after {self.length_m:.1f} m: position error {errors[-1]:.3f} m ({percent:.2f} %), "
            f"99 % bound {self.estimate[-1, 4]:.3f} m, heading error {abs(math.degrees(heading)):.2f} deg; "
            f"largest error {errors.max():.3f} m; wheels alone {alone[-1]:.3f} m, largest {alone.max():.3f} m"
        )


def main(argv: list[str]) -> int:
    """Run the command. Returns exit code 0, or 1 if the daemon failed or no pose was received."""
    arguments = _arguments(argv)
    config = load_config(arguments.config).value
    stand_s = config.estimation.static_bias.duration_s + STAND_MARGIN_S
    if arguments.seconds < stand_s + 5.0:
        print(f"drd demo: --seconds: expected at least {stand_s + 5.0:g}, got {arguments.seconds:g}", file=sys.stderr)
        return 2
    if arguments.fault is not None and not config.monitor.enabled:
        print("drd demo: --fault: expected monitor.enabled: true in the configuration", file=sys.stderr)
        return 2
    drive = demo_drive(arguments.seconds, stand_s=stand_s)
    planted = None if arguments.fault is None else plant(arguments.fault, drive, config, arguments.seed)
    if arguments.fault is not None and planted is None:
        print(f"drd demo: --fault {arguments.fault}: no plausible size shows on so short a drive", file=sys.stderr)
        return 2
    heard = Heard([], {})
    fault = None if planted is None else planted.fault
    with Emulator(config, arguments.config.parent, drive, seed=arguments.seed, fault=fault) as emulator:
        with _daemon(arguments.config) as process:
            _watch(process, config, emulator, arguments.seconds, heard)
        truth = list(emulator.truth)
    poses = heard.poses
    if process.returncode != 0 or not poses:
        print(f"drd demo: the daemon ended with {process.returncode} and {len(poses)} poses", file=sys.stderr)
        return 1
    result = evaluate(truth, poses, config, emulator.path.length_m)
    said = ""
    marks: list[Mark] = []
    if planted is not None:
        first_s = (poses[0]["monotonic_ns"] - emulator.start_ns) * S_PER_NS
        said, marks = told(planted, list(heard.findings.values()), poses[0]["monotonic_ns"], first_s)
    title = "" if planted is None else f", {planted.effect.id}"
    _draw(arguments.output, result, title, said, marks)
    print(result.sentence() + said)
    print(f"picture: {arguments.output}")
    return 0


def _arguments(argv: list[str]) -> argparse.Namespace:
    parser = command("drd demo", DESCRIPTION, EPILOG, [seed("the sensors' noise", 1)])
    add = parser.add_argument
    file, text = shipped_config("demo.yaml"), "configuration (default: %(default)s)"
    add("--config", type=Path, default=file, metavar="CONFIG", help=text)
    add("--seconds", type=float, metavar="N", help="length of the run (default: 30; with --fault 240)")
    text = "from the middle on the robot has this effect of the catalogue, and the monitor's findings are drawn"
    add("--fault", choices=[e.id for e in seen_live() if not e.irreversible], metavar="EFFECT", help=text)
    add("--output", type=Path, default=Path("demo.png"), metavar="FILE.png", help="the picture (default: demo.png)")
    found = parser.parse_args(argv)
    if found.seconds is None:
        found.seconds = 30.0 if found.fault is None else FAULT_SECONDS
    return found


@contextlib.contextmanager
def _daemon(config: Path) -> Iterator[subprocess.Popen[bytes]]:
    process = subprocess.Popen([sys.executable, "-m", "drd", "run", str(config)])
    try:
        yield process
    finally:
        process.send_signal(signal.SIGTERM)
        try:
            process.wait(15.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def _watch(process: subprocess.Popen[bytes], config: Config, emulator: Emulator, seconds: float, heard: Heard) -> None:
    """Print one line per second, as `drd watch --plain` does, and keep poses and findings."""
    endpoint, prefix = config.output.listen[0], config.output.prefix
    session = _connect(process, endpoint)
    if session is None:
        return
    view = View(prefix, endpoint)
    with session:
        subscriber = session.declare_subscriber(f"{prefix}/pose", zenoh.handlers.FifoChannel(4096))
        findings = session.declare_subscriber(f"{prefix}/findings", zenoh.handlers.FifoChannel(256))
        health = session.declare_subscriber(f"{prefix}/health", zenoh.handlers.FifoChannel(256))
        end_s = emulator.start_ns * 1e-9 + seconds
        while (now_s := time.monotonic()) < end_s and process.poll() is None:
            time.sleep(min(1.0, max(0.0, end_s - now_s)))
            while (sample := subscriber.try_recv()) is not None:
                payload = sample.payload.to_bytes()
                view.take_pose(payload, time.monotonic())
                heard.poses.append(json.loads(payload))
            while (sample := health.try_recv()) is not None:
                view.take_health(sample.payload.to_bytes())
            while (sample := findings.try_recv()) is not None:
                now = json.loads(sample.payload.to_bytes())["findings"]
                for finding in now:  # its name may change, but not the time of its first naming
                    heard.findings[finding["named_ns"]] = finding
                for gone in heard.findings.keys() - {f["named_ns"] for f in now}:
                    del heard.findings[gone]
            print(view.line(time.monotonic()), flush=True)


def _connect(process: subprocess.Popen[bytes], endpoint: str) -> Any:
    """Open a session with the daemon once it listens; None if it ends or takes too long."""
    deadline_s = time.monotonic() + CONNECT_S
    while time.monotonic() < deadline_s and process.poll() is None:
        with contextlib.suppress(zenoh.ZError):
            return zenoh.open(isolated_config("client", (), (endpoint,)))
        time.sleep(0.1)
    return None


def evaluate(truth: Sequence[Truth], poses: Sequence[dict[str, Any]], config: Config, length_m: float) -> Result:
    """Bring truth, estimate and the wheels' own odometry (equation 7) to one time base, from the first pose on."""
    start_ns = poses[0]["monotonic_ns"]
    rows = np.array(
        [((t.t_ns - start_ns) * 1e-9, t.x_m, t.y_m, t.heading_rad, t.left_m, t.right_m) for t in truth], dtype=float
    )
    names = ("x_m", "y_m", "heading_rad", "position_bound_99_m")
    estimate = np.array([[(p["monotonic_ns"] - start_ns) * 1e-9, *(p[n] for n in names)] for p in poses], dtype=float)
    steps = np.diff(rows[:, 4:6], axis=0)
    turn = (steps[:, 1] - steps[:, 0]) / config.robot.tread_m
    heading = cumulative(turn)
    middle, travel = heading[:-1] + 0.5 * turn, steps.mean(axis=1)
    x, y = (cumulative(travel * f(middle)) for f in (np.cos, np.sin))
    return Result(rows[:, :4], estimate, np.column_stack([rows[:, 0], x, y, heading]), length_m)


class Planted(NamedTuple):
    """An effect, its onset (s since the start), its values (SI), and its accumulated errors."""

    effect: Effect
    begin_s: float
    values: Values
    fault: Fault


def plant(name: str, drive: Drive, config: Config, seed_: int) -> Planted | None:
    """Size the effect for a detectability of FAULT_D within 100 m of its onset; None if it cannot be so large."""
    effect, truth = catalogue()[name], make_truth(drive)
    half_m_s = 0.5 * config.robot.tread_m * truth.rate_rad_s  # perfect wheels and tread
    wheels = truth.speed_m_s - half_m_s, truth.speed_m_s + half_m_s
    motion = motion_along(truth, config.robot.wheel_radius_m, config.robot.tread_m, *wheels)
    distance_m = np.cumsum(np.abs(truth.speed_m_s)) * STEP_S
    begin = int(np.searchsorted(distance_m, FAULT_SHARE * distance_m[-1]))
    limit = min(int(np.searchsorted(distance_m, distance_m[begin] + WAY_M)), len(distance_m) - 1)
    random = np.random.default_rng([seed_, 4])
    tries = (sized(effect, FAULT_D, motion, (begin, limit), random) for _ in range(FAULT_TRIES))
    values = next((v for v in tries if v is not None), None)
    if values is None:
        return None
    fault = Fault.of(since(effect, values, motion, begin), motion)
    return Planted(effect, float(motion.time_s[begin]), values, fault)


def told(planted: Planted, findings: list[dict[str, Any]], zero_ns: int, first_s: float) -> tuple[str, list[Mark]]:
    """The monitor's report on it, as text and as marks in time since `zero_ns`, which is `first_s` into the drive."""
    begin_s = planted.begin_s - first_s
    sizes = ", ".join(f"{q.name} {_shown(planted, q)}" for q in planted.effect.parameters if q.name in planted.values)
    said, marks = f"; {planted.effect.id} from {begin_s:.0f} s ({sizes})", [Mark(begin_s, "onset")]
    if not findings:
        return f"{said}: the monitor names nothing", marks
    for f in sorted(findings, key=lambda f: f["named_ns"]):
        since_s, named_s = ((f[key] - zero_ns) * S_PER_NS for key in ("since_ns", "named_ns"))
        shown = [f"{n} {v if isinstance(v, str) else _interval(v)}" for n, v in f["parameters"].items()]
        text = f" ({', '.join(shown)})" if shown else ""
        others = f", or {', '.join(name for name, _ in f['also_fits'])}" if f["also_fits"] else ""
        said += f"; named after {named_s - begin_s:.0f} s: {f['effect']}{text}, {f['probability']:.2f}{others}"
        said += f", since {since_s:.0f} s"
        marks += [Mark(since_s, "since, as told", f["since_std_s"]), Mark(named_s, f"{f['effect']} named")]
    return said, marks


def _shown(planted: Planted, q: Parameter) -> str:
    value = planted.values[q.name]
    return value if isinstance(value, str) else f"{float(value) / q.si:.3g} {q.unit}".removesuffix(" 1")


def _interval(size: dict[str, Any]) -> str:
    return f"{size['value']:.3g} [{size['low']:.3g}, {size['high']:.3g}] {size['unit']}".removesuffix(" 1")


def _draw(file: Path, result: Result, title: str, said: str, marks: Sequence[Mark]) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    path_picture(
        file,
        result.truth[:, 1:3],
        result.estimate[:, 1:3],
        result.wheels[:, 1:3],
        errors=ErrorSeries(result.estimate[:, 0], result.errors_m, bound_m=result.estimate[:, 4]),
        title=f"drd demo: true and estimated path{title}",
        caption=result.sentence() + said,
        marks=marks,
    )
