"""`drd foxglove`: show a running daemon's pose in Foxglove over its WebSocket protocol, as a Zenoh client."""

import argparse
import contextlib
import math
import signal
import sys
import threading
from collections.abc import Iterator, Mapping
from typing import Any, Final

import foxglove
import msgspec
import zenoh
from foxglove.websocket import WebSocketServer

from drd.commands import command
from drd.commands.watch import daemon_arguments, zenoh_config
from drd.config.keys import Output
from drd.output.ask import ask
from drd.output.cdr import Diagnostic
from drd.output.diagnostics import OK, WARN, diagnostics
from drd.output.exposure import is_local
from drd.output.messages import Refused, encode
from drd.output.session import tidy
from drd.recording.topics import CHANNELS, POSE, ForViewers
from drd.samples import Pose, Validity
from drd.units import NS_PER_S
from drd_tools import options
from drd_tools.shipped import shipped_config

LAYOUT: Final = "foxglove-layout.json"
HEALTH: Final = "/health"
DIAGNOSTICS: Final = "/diagnostics"
# With this schema name, Foxglove's diagnostics panels accept JSON too.
DIAGNOSTIC_ARRAY: Final = "diagnostic_msgs/DiagnosticArray"
FORWARDED: Final = (POSE, "/pose", "/tf", "/scene", HEALTH)
# About 40 kB/s for a path of full length, yet smooth to the eye.
SCENE_PERIOD_NS: Final = NS_PER_S // 2
DESCRIPTION: Final = """\
Show a running drd in Foxglove: pose, transform, the path, the 99 % bound, and the health as a table of diagnostics.
In Foxglove, open a connection to ws://127.0.0.1:8765 and import the layout file whose path is printed. Viewers are
read-only. This is a separate process: however many viewers connect, the daemon has one more subscriber.

topics:
  /pose /tf /scene   foxglove.PoseInFrame, FrameTransform and SceneUpdate (path and bound), as in recordings
  /drd/pose /health  the messages published by drd, for plots
  /diagnostics       the health as a table: parts with level, reason and values
"""
EPILOG: Final = """\
examples:
  drd foxglove
  drd foxglove --connect tcp/192.168.1.10:7447 --prefix fleet/mybot
  drd foxglove --listen 0.0.0.0:8765          others on the network can watch as well

Exit code: 0 ended by Ctrl-C or SIGTERM, 1 drd cannot be reached or the address is taken, 2 bad usage.
"""


class Published(msgspec.Struct):
    """The drawn part of the JSON under `prefix/pose`; null stands for what is not finite."""

    monotonic_ns: int
    wall_ns: int
    x_m: float | None
    y_m: float | None
    heading_rad: float | None
    speed_m_s: float | None
    position_bound_99_m: float | None
    validity: Validity

    def pose(self) -> Pose:
        """Make the pose; fields that are not drawn are NaN."""
        x_m, y_m, heading_rad, speed_m_s, bound_m = (
            math.nan if value is None else value
            for value in (self.x_m, self.y_m, self.heading_rad, self.speed_m_s, self.position_bound_99_m)
        )
        unknown = math.nan
        return Pose(
            self.monotonic_ns, 0, x_m, y_m, heading_rad, speed_m_s, unknown, unknown, unknown, (unknown,) * 6,
            bound_m, self.validity, (),
        )  # fmt: skip


class Channels:
    """The topics of one server. Whatever arrives is passed on or counted as unreadable; nothing raises."""

    def __init__(self, context: foxglove.Context, frame_id: str, child_frame_id: str):
        self._viewers = ForViewers(frame_id, child_frame_id, SCENE_PERIOD_NS)
        self._decoder = msgspec.json.Decoder(Published)
        self._by_topic = {
            c.topic: foxglove.Channel(
                c.topic,
                message_encoding=c.encoding,
                schema=foxglove.Schema(name=c.schema_name, encoding=c.schema_encoding, data=c.schema),
                context=context,
            )
            for c in CHANNELS
            if c.topic in FORWARDED
        }
        table = foxglove.Schema(name=DIAGNOSTIC_ARRAY, encoding="jsonschema", data=b'{"type":"object"}')
        self._by_topic[DIAGNOSTICS] = foxglove.Channel(
            DIAGNOSTICS, message_encoding="json", schema=table, context=context
        )
        self.unreadable = 0

    def take_pose(self, payload: bytes) -> None:
        """Take a message of `prefix/pose`."""
        try:
            heard = self._decoder.decode(payload)
            messages = self._viewers.pose(heard.pose(), heard.wall_ns)
            self._by_topic[POSE].log(payload, log_time=heard.wall_ns)
            for message in messages:
                self._by_topic[message.topic].log(message.data, log_time=heard.wall_ns)
        except (msgspec.DecodeError, OverflowError, ValueError):
            self.unreadable += 1

    def take_health(self, payload: bytes) -> None:
        """Take a message of `prefix/health`."""
        try:
            health = msgspec.json.decode(payload, type=dict[str, Any])
            wall_ns = int(health["wall_ns"])
            self._by_topic[HEALTH].log(payload, log_time=wall_ns)
            self._by_topic[DIAGNOSTICS].log(encode(diagnostic_array(health, wall_ns)), log_time=wall_ns)
        except (msgspec.DecodeError, KeyError, OverflowError, RecursionError, TypeError, ValueError):
            self.unreadable += 1


def diagnostic_array(health: Mapping[str, Any], wall_ns: int) -> dict[str, Any]:
    """Make a diagnostic_msgs/DiagnosticArray as JSON."""
    seconds, nanoseconds = divmod(wall_ns, NS_PER_S)
    rows = [
        row._asdict() | {"values": [{"key": key, "value": value} for key, value in row.values.items()]}
        for row in (*diagnostics(health), *_parts(health))
    ]
    return {"header": {"stamp": {"sec": seconds, "nanosec": nanoseconds}, "frame_id": ""}, "status": rows}


def _parts(health: Mapping[str, Any]) -> Iterator[Diagnostic]:
    """Rows of each part's counters, with its reasons, and one of the learned values."""
    reasons = [(str(r["source"]).partition(".")[0], str(r["text"])) for r in health["reasons"]]
    for part, values in dict(health["counters"]).items():
        why = "; ".join(text for source, text in reasons if source == part)
        yield Diagnostic(WARN if why else OK, f"drd: {part}", why, health["robot"], dict(_flat(values)))
    yield Diagnostic(OK, "drd: learned", "", health["robot"], dict(_flat(health["learned"])))


def _flat(value: Any, path: str = "") -> Iterator[tuple[str, str]]:
    """Values by their path, as in `left.wraps`."""
    if isinstance(value, dict):
        for name, part in value.items():
            yield from _flat(part, f"{path}.{name}" if path else name)
    else:
        yield path, f"{value:.6g}" if isinstance(value, float) else str(value)


def main(argv: list[str]) -> int:
    """Serve until Ctrl-C or SIGTERM. Returns exit code 0, or 1 if drd or the address is not available."""
    arguments = _arguments(argv)
    host, port = arguments.listen
    where = arguments.connect if arguments.zenoh_config is None else str(arguments.zenoh_config)
    stop = threading.Event()
    try:
        with (
            zenoh.open(zenoh_config(arguments)) as session,
            _signals(stop),
            serving(session, arguments.prefix, host, port) as server,
        ):
            print(f"ws://{host}:{server.port}  layout: {shipped_config(LAYOUT)}", flush=True)
            if not is_local(f"tcp/{host}:{port}"):
                print("note: whoever reaches this address can watch; nothing is encrypted", flush=True)
            stop.wait()
    except zenoh.ZError as error:
        print(f"drd foxglove: {where}, prefix {arguments.prefix}: {tidy(error)}", file=sys.stderr)
        print("Is drd running there, and is this one of its output.listen endpoints?", file=sys.stderr)
        return 1
    except (OSError, RuntimeError) as error:
        print(f"drd foxglove: cannot listen on {host}:{port}: {error}", file=sys.stderr)
        return 1
    return 0


@contextlib.contextmanager
def serving(session: zenoh.Session, prefix: str, host: str, port: int) -> Iterator[WebSocketServer]:
    """Serve viewers. Raises OSError or RuntimeError if the address is not available."""
    context = foxglove.Context()
    channels = Channels(context, *frames(session, prefix))
    server = foxglove.start_server(name=f"drd: {prefix}", host=host.strip("[]"), port=port, context=context)
    try:
        with (
            session.declare_subscriber(f"{prefix}/pose", lambda s: channels.take_pose(s.payload.to_bytes())),
            session.declare_subscriber(f"{prefix}/health", lambda s: channels.take_health(s.payload.to_bytes())),
        ):
            yield server
    finally:
        server.stop()


def frames(session: zenoh.Session, prefix: str) -> tuple[str, str]:
    """Ask the daemon for the names of its frames; return the defaults if it does not answer."""
    with contextlib.suppress(Refused, KeyError, TypeError):
        output = ask(session, f"{prefix}/config")["config"]["output"]
        return str(output["frame_id"]), str(output["child_frame_id"])
    return Output().frame_id, Output().child_frame_id


@contextlib.contextmanager
def _signals(stop: threading.Event) -> Iterator[None]:
    """Let Ctrl-C and SIGTERM set `stop`."""
    before = [(n, signal.signal(n, lambda *_: stop.set())) for n in (signal.SIGINT, signal.SIGTERM)]
    try:
        yield
    finally:
        for number, handler in before:
            signal.signal(number, handler)


def _arguments(argv: list[str]) -> argparse.Namespace:
    parents = [daemon_arguments(), options.listen(8765)]
    return command("drd foxglove", DESCRIPTION, EPILOG, parents).parse_args(argv)
