"""What recording costs: two daemons side by side, one of which records, with the same inputs in turn."""

import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

from bench.cpu import usage
from bench.driven import QUARTER_S, Driven, driven
from bench.latency import latencies_us
from bench.listener import listening
from bench.report import Figure, Refused, Report
from bench.timing import percentile
from drd_tools.recordings.mcap_file import open_mcap

ALONE, RECORDED = "alone", "recorded"


def run(quick: bool) -> Report:
    """Run both for a while. Raises Refused where one of them does not run well."""
    rounds = 40 if quick else 600
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        keys = {RECORDED: f"recording: {{enabled: true, folder: {name}/recordings}}\n"}
        robots = [
            stack.enter_context(driven(Path(name) / which, which, keys.get(which, ""))) for which in (ALONE, RECORDED)
        ]
        topics = [f"{robot.name}/pose" for robot in robots]
        with listening([robot.endpoint for robot in robots], topics) as listener:
            before = [usage(robot.process.pid) for robot in robots]
            began_s = time.monotonic()
            for _ in range(rounds):
                _round(robots)
            seconds = time.monotonic() - began_s
            after = [usage(robot.process.pid) for robot in robots]
            heard_ns = listener.arrivals_ns()
        for robot in robots:
            robot.end()
        written_kb_s = _written_kb_s(Path(name) / "recordings")
    latencies = [latencies_us(robot.written_ns, heard_ns[key]) for robot, key in zip(robots, topics, strict=True)]
    figures = []
    for percent in (50, 99):
        alone, recorded = (percentile(values, percent) for values in latencies)
        figures.append(Figure(f"packet to subscriber, p{percent}: not recording", alone, "us"))
        figures.append(Figure(f"packet to subscriber, p{percent}: recording", recorded, "us", recorded / alone))
    alone, recorded = (100.0 * (b.cpu_s - a.cpu_s) / seconds for a, b in zip(before, after, strict=True))
    figures += [
        Figure("CPU, not recording", alone, "% of core"),
        Figure("CPU, recording", recorded, "% of core", recorded / alone),
        Figure("written", written_kb_s, "kB/s"),
    ]
    return Report(
        f"recording: two `drd run`, one of which records; gyro at 10 Hz, encoders at 20 Hz over SLCAN, {seconds:.0f} s",
        "how many times longer a pose takes, and how many times more of a core the daemon, when it records",
        tuple(figures),
    )


def _round(robots: list[Driven]) -> None:
    """0.1 s: both robots' wheels twice, and each one's gyro once, in turn."""
    for robot in robots:
        for each in robots:
            each.turn_wheels()
        time.sleep(QUARTER_S)
        robot.send_packet()
        time.sleep(QUARTER_S)


def _written_kb_s(folder: Path) -> float:
    """Of a run that was recorded whole, in one file. Raises Refused."""
    files = list(folder.glob("*.mcap"))
    found = open_mcap(files[0]) if len(files) == 1 else None
    if found is None or found.end is None or found.end["lost"] != "0":
        raise Refused("recording: the recording is not complete")
    return found.path.stat().st_size / found.seconds / 1e3
