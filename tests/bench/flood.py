"""What a neighbour that floods the daemon with queries costs the poses."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from itertools import pairwise
from statistics import mean, median
from typing import Any, Final, NamedTuple

import zenoh

from bench.cpu import emulated_daemon
from bench.listener import ENVIRONMENT, listening
from bench.report import Figure, Refused, Report
from drd.output.session import isolated_config
from drd.units import NS_PER_MS

POSE_KEY: Final = "bench/pose"
SETTLING_S: Final = 1.5
# What is asked, and with which payload. `busy` asks nothing: it shows what a process costs that only computes.
FLOODS: Final[dict[str, tuple[str, bytes]]] = {
    "busy": ("", b""),
    "valid": ("pose", b"{}"),
    "malformed": ("pose", b"[" * 3000),
    "oversized": ("pose", b" " * 60_000),
    "refused commands": ("reset", b"{}"),
}
# Further queries wait until answers have come: else the flooder's own memory would be measured.
UNANSWERED: Final = 2000


class Phase(NamedTuple):
    """What happened while one flood went on, or none."""

    asked: float
    mean_ms: float
    max_ms: float
    longest_gap_ms: float


def run(quick: bool) -> Report:
    """Flood a daemon that another process's emulated robot feeds. Raises Refused where a pose is missing."""
    phase_s, rounds, kinds = (1.5, 1, ("busy", "malformed")) if quick else (5.0, 3, tuple(FLOODS))
    with emulated_daemon(rounds * (len(kinds) + 1) * (phase_s + 2 * SETTLING_S + 5.0)) as (_, endpoint):
        phases = _phases(endpoint, ("", *kinds) * rounds, phase_s)
    return Report(
        "flood: input's arrival to pose published, and time between poses (nominally 50 ms); medians of "
        f"{rounds} times {phase_s:g} s",
        "times what it is beside a process that only takes processor time",
        tuple(_figures(phases, phase_s)),
    )


def _figures(phases: dict[str, list[Phase]], phase_s: float) -> Iterator[Figure]:
    medians = {kind: Phase(*map(median, zip(*found, strict=True))) for kind, found in phases.items()}
    busy = medians["busy"]
    for kind, phase in medians.items():
        name = f"{kind} ({phase.asked / phase_s:.0f} queries/s)" if phase.asked else kind or "quiet"
        for what, value, yardstick in (
            ("mean latency", phase.mean_ms, busy.mean_ms),
            ("longest latency", phase.max_ms, busy.max_ms),
            ("longest time between poses", phase.longest_gap_ms, busy.longest_gap_ms),
        ):
            yield Figure(f"{name}: {what}", value, "ms", None if kind in {"", "busy"} else value / yardstick)


def _phases(endpoint: str, kinds: Sequence[str], phase_s: float) -> dict[str, list[Phase]]:
    """By kind of flood, one for each time that it is named; "" is none."""
    found: list[tuple[str, int, int, int, list[dict[str, Any]]]] = []
    with listening((endpoint,), (POSE_KEY,)) as listener:
        with zenoh.open(isolated_config("client", (), (endpoint,))) as session:
            reports = session.declare_subscriber("bench/health", zenoh.handlers.RingChannel(1000))
            for kind in kinds:
                time.sleep(SETTLING_S)
                while reports.try_recv():
                    pass
                start_ns = time.monotonic_ns()
                asked = _flood(kind, endpoint, phase_s)
                end_ns, healths = time.monotonic_ns(), []
                while sample := reports.try_recv():
                    healths.append(json.loads(sample.payload.to_bytes()))
                found.append((kind, asked, start_ns, end_ns, healths))
        heard_ns = listener.arrivals_ns()[POSE_KEY]
    return {kind: [_phase(heard_ns, *rest) for rest in found if rest[0] == kind] for kind in kinds}


def _phase(heard_ns: list[int], kind: str, asked: int, start_ns: int, end_ns: int, healths: list[Any]) -> Phase:
    times = [t_ns for t_ns in heard_ns if start_ns <= t_ns < end_ns]
    wanted = 0.9 * 20.0 * (end_ns - start_ns) * 1e-9
    if len(times) < wanted or not healths:
        raise Refused(f"flood: {kind or 'quiet'}: {len(times)} poses, {wanted:.0f} or more were expected")
    gap_ns = max(b - a for a, b in pairwise(times))
    means, longest = [h["latency_mean_ms"] for h in healths], [h["latency_max_ms"] for h in healths]
    return Phase(asked, mean(means), max(longest), gap_ns / NS_PER_MS)


def _flood(kind: str, endpoint: str, seconds: float) -> int:
    """Flood, or only wait; returns how many queries were sent."""
    if not kind:
        time.sleep(seconds)
        return 0
    command = [sys.executable, "-m", "bench.flood", kind, endpoint, str(seconds)]
    limit_s = seconds + 20.0
    done = subprocess.run(command, capture_output=True, text=True, timeout=limit_s, check=True, env=ENVIRONMENT)
    return int(done.stdout)


def _main(kind: str, endpoint: str, seconds: str) -> None:
    """The flooding process: prints the number of queries that it sent."""
    name, payload = FLOODS[kind]
    end_s = time.monotonic() + float(seconds)
    asked, answered = 0, 0

    def count(_: Any) -> None:
        nonlocal answered
        answered += 1

    if not name:
        while time.monotonic() < end_s:
            pass
    else:
        with zenoh.open(isolated_config("client", (), (endpoint,))) as session:
            while time.monotonic() < end_s:
                session.get(f"bench/{name}", count, payload=payload, timeout=5.0)
                asked += 1
                if asked - answered > UNANSWERED:
                    time.sleep(0.001)
    print(asked, flush=True)
    os._exit(0)  # answers that are still under way would keep the interpreter


if __name__ == "__main__":
    _main(*sys.argv[1:])
