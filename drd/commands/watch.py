"""`drd watch`: a live view of the pose and the health in the terminal, over Zenoh."""

import argparse
import json
import math
import shutil
import sys
import time
from collections import deque
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

import zenoh

from drd.commands import command, number
from drd.commands.pose_lines import print_poses
from drd.output.session import isolated_config, tidy
from drd.units import DEG_PER_RAD, NS_PER_S

DESCRIPTION: Final = """\
Show the live pose of a running drd, with its uncertainty, the reasons for degraded validity, and the counters that
change. Ctrl-C ends it. The daemon is not affected: it publishes the same data however many listen.

With --json, each pose is printed as published, one line of JSON each, until the reader closes the pipe. A reader slower
than the poses gets the newest; gaps in `sequence` show how many it missed.
"""
EPILOG: Final = """\
examples:
  drd watch
  drd watch --connect tcp/192.168.1.10:7447 --prefix fleet/mybot
  drd watch --zenoh-config zenoh-tls-client.json5
  drd watch --plain --seconds 60 > minute.txt
  drd watch --json | jq --unbuffered .position_bound_99_m
  drd watch --json --once --seconds 2

Exit code: 0 good, 1 drd cannot be reached (a wrong --connect included) or sent nothing within
--seconds, 2 bad usage.
"""
_SILENCE_S = 3.0
_RATE_WINDOW_S = 3.0
# How long --once waits without --seconds.
ONCE_S: Final = 5.0


def main(argv: list[str]) -> int:
    """Show poses until Ctrl-C or `--seconds`. Exit code 0; 1 if drd was not reached or sent nothing.

    Raises BrokenPipeError where the reader of standard output has gone.
    """
    arguments = _arguments(argv)
    plain = arguments.plain or not sys.stdout.isatty()
    where = arguments.connect if arguments.zenoh_config is None else str(arguments.zenoh_config)
    seconds = arguments.seconds if arguments.seconds is not None else ONCE_S if arguments.once else math.inf
    view = View(arguments.prefix, where)
    try:
        with zenoh.open(zenoh_config(arguments)) as session:
            if arguments.json:
                heard = print_poses(session, arguments.prefix, seconds, 1 if arguments.once else math.inf) > 0
            else:
                _show(session, view, arguments.prefix, seconds, plain, arguments.once)
                heard = view.has_pose if arguments.once else view.heard
    except zenoh.ZError as error:
        print(f"drd watch: {where}, prefix {arguments.prefix}: {tidy(error)}", file=sys.stderr)
        print("Is drd running there, and is this one of its output.listen endpoints?", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 0
    if not heard and (arguments.json or arguments.once):
        print(f"drd watch: no pose heard under '{arguments.prefix}' at {where} within {seconds:g} s", file=sys.stderr)
    return 0 if heard else 1


def _arguments(argv: list[str]) -> argparse.Namespace:
    parser = command("drd watch", DESCRIPTION, EPILOG, [daemon_arguments()])
    add = parser.add_argument
    text = f"end after N seconds (default: never; with --once {ONCE_S:g})"
    add("--seconds", type=number(0.0, above=True), metavar="N", help=text)
    add("--once", action="store_true", help="end after the first pose; exit code 1 if none comes within --seconds")
    form = parser.add_mutually_exclusive_group().add_argument
    form("--plain", action="store_true", help="one line per second (the default if the output is not a terminal)")
    form("--json", action="store_true", help="one line of JSON per pose")
    return parser.parse_args(argv)


def daemon_arguments() -> argparse.ArgumentParser:
    """Options that select the daemon, for `parents`: --connect, --zenoh-config, --prefix."""
    parser = argparse.ArgumentParser(add_help=False)
    add = parser.add_argument
    text = "Zenoh endpoint of drd (one of its output.listen) or of a router (default: %(default)s)"
    add("--connect", default="tcp/127.0.0.1:7447", metavar="ENDPOINT", help=text)
    text = "Zenoh configuration file instead of --connect, e.g. for certificates"
    add("--zenoh-config", type=Path, metavar="FILE", help=text)
    add("--prefix", default="drd", help="output.prefix of that drd (default: %(default)s)")
    return parser


def zenoh_config(arguments: argparse.Namespace) -> zenoh.Config:
    """Configuration of a client of the daemon selected by `daemon_arguments`. Raises zenoh.ZError."""
    if arguments.zenoh_config is None:
        return isolated_config("client", (), (arguments.connect,))
    return zenoh.Config.from_file(arguments.zenoh_config)


def _show(session: Any, view: "View", prefix: str, seconds: float, plain: bool, once: bool) -> None:
    poses = session.declare_subscriber(f"{prefix}/pose", zenoh.handlers.RingChannel(256))
    health = session.declare_subscriber(f"{prefix}/health", zenoh.handlers.RingChannel(16))
    start_s, drawn = time.monotonic(), 0
    while (now_s := time.monotonic()) - start_s < seconds:
        time.sleep(min(1.0 if plain and not once else 0.1, max(0.0, start_s + seconds - now_s)))
        now_s = time.monotonic()
        while sample := poses.try_recv():
            view.take_pose(sample.payload.to_bytes(), now_s)
        while sample := health.try_recv():
            view.take_health(sample.payload.to_bytes())
        if once:
            if view.has_pose:
                print(view.line(now_s), flush=True)
                return
        elif plain:
            print(view.line(now_s), flush=True)
        else:
            drawn = _redraw(view.lines(now_s), drawn)


def _redraw(lines: list[str], drawn: int) -> int:
    """Overwrite the `drawn` previous lines with `lines`; return how many there are now."""
    width, height = shutil.get_terminal_size()
    lines = [line[: width - 1] for line in lines[: height - 1]]
    up = f"\x1b[{drawn}F\x1b[J" if drawn else ""
    print(up + "\n".join(lines), flush=True)
    return len(lines)


class View:
    """Received messages as text. Whatever arrives is shown or counted as unreadable; nothing raises."""

    def __init__(self, prefix: str, endpoint: str):
        self._where = f"'{prefix}' at {endpoint}"
        self._pose: dict[str, Any] = {}
        self._heard_s: float | None = None  # the newest pose
        self._times_ns: deque[int] = deque(maxlen=4096)  # the poses' own times, of the last seconds
        self._first_s = time.monotonic()
        self._counts: dict[str, int] = {}
        self._changed: dict[str, int] = {}
        self._found: list[str] = []
        self.heard = False
        self.unreadable = 0

    @property
    def has_pose(self) -> bool:
        """Whether a pose was received."""
        return self._heard_s is not None

    def take_pose(self, payload: bytes, now_s: float) -> None:
        """Take a message of `prefix/pose`, received at `now_s` (CLOCK_MONOTONIC)."""
        if (pose := self._object(payload)) is not None:
            self._pose, self._heard_s, self.heard = pose, now_s, True
            self._take_time(pose.get("monotonic_ns"))

    def _take_time(self, t_ns: Any) -> None:
        """Store a pose's own time for the rate, since poses arrive in batches."""
        times = self._times_ns
        if not isinstance(t_ns, int) or (times and t_ns < times[-1]):  # another daemon's clock
            times.clear()
            return
        times.append(t_ns)
        while t_ns - times[0] > _RATE_WINDOW_S * NS_PER_S:
            times.popleft()

    def take_health(self, payload: bytes) -> None:
        """Take the findings and the whole numbers under `counters` from a message of `prefix/health`."""
        if (health := self._object(payload)) is not None:
            counts = dict(_counters(health.get("counters"), ""))
            self._changed = {k: n - self._counts[k] for k, n in counts.items() if n != self._counts.get(k, n)}
            self._counts = counts
            self._found = [*_findings(health.get("findings")), *_suspicion(health.get("monitor"))]
            self.heard = True

    def line(self, now_s: float) -> str:
        """Everything in one line."""
        if self._heard_s is None:
            return self._silence(now_s)
        changed = " ".join(f"{k}{n:+d}" for k, n in list(self._changed.items())[:8])
        return "  ".join(part for part in (*self._pose_lines(now_s), *self._reasons(), *self._found, changed) if part)

    def lines(self, now_s: float) -> list[str]:
        """The same on several lines, with one line for each changed counter."""
        if self._heard_s is None:
            return [self._silence(now_s)]
        counters = [f"  {k:<40} {self._counts[k]:>12} ({n:+d})" for k, n in self._changed.items()]
        heading = ["counters that changed:"] if counters else []
        return [*self._pose_lines(now_s), *(f"  {r}" for r in (*self._reasons(), *self._found)), *heading, *counters]

    def _silence(self, now_s: float) -> str:
        waited_s = now_s - self._first_s
        text = f"no pose heard under {self._where} for {waited_s:.0f} s"
        if self.heard:
            return text + ": the health arrives, so drd runs and has no pose yet"
        return text + (": is that its output.prefix?" if waited_s > _SILENCE_S else "")

    def _pose_lines(self, now_s: float) -> list[str]:
        p, covariance = self._pose, self._pose.get("covariance_m_rad")
        sigma = [_sigma(covariance, i) for i in range(3)]
        age_s = now_s - (self._heard_s or 0.0)
        span_ns = self._times_ns[-1] - self._times_ns[0] if self._times_ns else 0
        rate_hz = (len(self._times_ns) - 1) * NS_PER_S / span_ns if span_ns and age_s < _RATE_WINDOW_S else 0.0
        return [
            f"{_text(p.get('validity')):<12}",
            f"x {_number(p.get('x_m'))} m  y {_number(p.get('y_m'))} m"
            f"  heading {_number(p.get('heading_rad'), DEG_PER_RAD, 2)} deg",
            f"speed {_number(p.get('speed_m_s'))} m/s  rate {_number(p.get('rate_rad_s'), DEG_PER_RAD, 2)} deg/s",
            f"sigma x {_number(sigma[0])} m  y {_number(sigma[1])} m  heading {_number(sigma[2], DEG_PER_RAD)} deg"
            f"  within (99 %) {_number(p.get('position_bound_99_m'))} m",
            f"poses {rate_hz:.1f}/s  age {age_s:.1f} s" + (f"  unreadable {self.unreadable}" * (self.unreadable > 0)),
        ]

    def _reasons(self) -> list[str]:
        reasons = self._pose.get("reasons")
        return [
            f"{_text(r.get('source'))}: {_text(r.get('text'))} (for {_number(r.get('since_s'), digits=1).strip()} s)"
            for r in (reasons if isinstance(reasons, list) else [])
            if isinstance(r, dict)
        ]

    def _object(self, payload: bytes) -> dict[str, Any] | None:
        with suppress(ValueError, RecursionError):
            if isinstance(value := json.loads(payload), dict):
                return value
        self.unreadable += 1
        return None


def _counters(value: Any, path: str, depth: int = 4) -> list[tuple[str, int]]:
    if isinstance(value, dict) and depth:
        return [c for k, v in value.items() for c in _counters(v, f"{path}.{_text(k)}".lstrip("."), depth - 1)]
    return [(path, value)] if isinstance(value, int) and not isinstance(value, bool) else []


def _findings(value: Any) -> list[str]:
    """Findings of the monitor that have not ended."""
    found = [f for f in value if isinstance(f, dict)] if isinstance(value, list) else []
    return [
        f"monitor: {_text(f.get('text'))} (probability {_number(f.get('probability'), digits=2).strip()})"
        for f in found
        if f.get("until_ns") is None
    ]


def _suspicion(monitor: Any) -> list[str]:
    text = monitor.get("suspected") if isinstance(monitor, dict) else None
    return [f"monitor: {_text(text)}"] if text else []


def _sigma(covariance: Any, i: int) -> float | None:
    try:
        return math.sqrt(covariance[i][i])
    except (TypeError, ValueError, IndexError, KeyError, OverflowError):
        return None


def _number(value: Any, factor: float = 1.0, digits: int = 3) -> str:
    """The number, eight characters wide; `-` where there is none."""
    if isinstance(value, bool) or not isinstance(value, int | float) or abs(value) > 1e12:
        return f"{'-':>8}"
    return f"{value * factor:8.{digits}f}"


def _text(value: Any) -> str:
    """Printable text: data from the network must not control the terminal."""
    return "".join(c if c.isprintable() else "?" for c in value[:200]) if isinstance(value, str) else "-"
