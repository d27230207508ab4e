"""What those who watch cost the daemon: the same one, in turn without clients and with one of each kind."""

import json
import os
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from statistics import mean, median
from typing import Any, Final

import zenoh

from bench.audience import audience, check_heard
from bench.cpu import usage
from bench.driven import Driven, delays_ms, driven
from bench.listener import listening
from bench.report import Figure, Refused, Report
from bench.timing import percentile
from drd.output.session import isolated_config

NAME: Final = "clients"
OUTPUT: Final = "ros2: true, ros2_joints: [left, right]"
# Two periods of the health, so that those that are looked at tell nothing of the clients' start.
SETTLING_S: Final = 2.0
MEASURES: Final = (
    "packet written to pose at a subscriber, p50",
    "packet written to pose at a subscriber, p99",
    "packet read to last message put, mean",
    "CPU of the daemon per pose",
)


def run(quick: bool) -> Report:
    """Measure in pairs, each kind going first in every other one. Raises Refused where a client hears too little."""
    pairs, stretch_s = (1, 2.0) if quick else (6, 10.0)
    stretches: list[tuple[_Stretch, _Stretch]] = []
    with tempfile.TemporaryDirectory() as name, driven(Path(name) / NAME, NAME, output=OUTPUT) as robot:
        with (
            _driving(robot),
            listening((robot.endpoint,), (f"{NAME}/pose",)) as listener,
            zenoh.open(isolated_config("client", (), (robot.endpoint,))) as session,
        ):
            health = session.declare_subscriber(f"{NAME}/health", zenoh.handlers.RingChannel(1000))
            for i in range(pairs):
                pair = {watched: _Stretch(robot, health, stretch_s, watched) for watched in (i % 2 == 1, i % 2 == 0)}
                stretches.append((pair[False], pair[True]))
            heard_ns = listener.arrivals_ns()[f"{NAME}/pose"]
        robot.end()
    costs = [(alone.costs_us(heard_ns), watched.costs_us(heard_ns)) for alone, watched in stretches]
    idle = min(stretch.idle_percent for pair in stretches for stretch in pair)
    return Report(
        "clients: `drd run` with output.ros2; clients: drd web with a browser, drd foxglove with a viewer, drd watch "
        f"--json, a Zenoh session that hears all; {pairs} times {stretch_s:g} s each, 10 poses/s",
        "times what it is with the measuring subscriber only: the median of the pairs' ratios, the least, the largest",
        # On a machine without idle cores the latencies are those of its other work.
        (*figures(costs), Figure("all cores idle, least of all times", idle, "%")),
    )


def figures(pairs: list[tuple[list[float], list[float]]]) -> Iterator[Figure]:
    """`pairs`: without and with clients, each as MEASURES has them, us."""
    for i, name in enumerate(MEASURES):
        alone, watched = [a[i] for a, _ in pairs], [b[i] for _, b in pairs]
        ranked = sorted((b / a, b) for a, b in zip(alone, watched, strict=True))
        yield Figure(f"{name}: without clients", median(alone), "us")
        yield Figure(f"{name}: with clients", median(watched), "us", median(ratio for ratio, _ in ranked))
        for which, (ratio, value) in (("least", ranked[0]), ("largest", ranked[-1])):
            yield Figure(f"{name}: with clients, {which} ratio", value, "us", ratio)


class _Stretch:
    """The daemon for `seconds`, `watched` by all clients or by none. The constructor takes that long."""

    def __init__(self, robot: Driven, health: Any, seconds: float, watched: bool):
        with ExitStack() as stack:
            clients = stack.enter_context(audience(robot.endpoint, NAME)) if watched else None
            time.sleep(SETTLING_S)
            while health.try_recv():
                pass
            first, before, idle_s = len(robot.written_ns), usage(robot.process.pid), _idle_s()
            time.sleep(seconds)
            self._written_ns, after = robot.written_ns[first:], usage(robot.process.pid)
            self._cpu_s = after.cpu_s - before.cpu_s
            self.idle_percent = 100.0 * (_idle_s() - idle_s) / (seconds * (os.cpu_count() or 1))
            self._healths: list[dict[str, Any]] = []
            while sample := health.try_recv():
                self._healths.append(json.loads(sample.payload.to_bytes()))
            if clients is not None:
                check_heard(clients.heard(), len(self._written_ns))

    def costs_us(self, heard_ns: list[int]) -> list[float]:
        """As MEASURES has them. Raises Refused where poses or the health are missing."""
        delays = delays_ms(self._written_ns, heard_ns)
        puts_ms = [ms for health in self._healths if (ms := health["latency_mean_ms"]) is not None]
        if not puts_ms:
            raise Refused("clients: the daemon told no latency")
        costs_ms = percentile(delays, 50), percentile(delays, 99), mean(puts_ms), 1e3 * self._cpu_s / len(delays)
        return [1e3 * ms for ms in costs_ms]


def _idle_s() -> float:
    """Of all cores together, since the machine's start; proc_stat(5)."""
    return int(Path("/proc/stat").read_text(encoding="utf-8").split()[4]) / os.sysconf("SC_CLK_TCK")


@contextmanager
def _driving(robot: Driven) -> Iterator[None]:
    """It drives meanwhile, also while clients start and end."""
    stop = threading.Event()

    def drive() -> None:
        while not stop.is_set():
            robot.round()

    thread = threading.Thread(target=drive)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()
