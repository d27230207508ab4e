"""`drd foxglove`, as its viewers see it: a client of the protocol in Python, and Foxglove's own in JavaScript."""

import asyncio
import contextlib
import json
import os
import re
import shutil
import signal
import socket
import struct
import subprocess
import sys
import threading
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import foxglove
import pytest
import zenoh
from links import free_endpoint
from protobuf_messages import message_class
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from drd.cli import main
from drd.config.keys import Output
from drd.output.session import isolated_config
from drd.output.zenoh_link import ZenohLink
from drd.recording.topics import CHANNELS
from drd.samples import Pose, Reason, Validity
from drd_tools.foxglove_command import DIAGNOSTICS, FORWARDED, Channels, serving
from drd_tools.shipped import shipped_config

WALL_NS = 1_700_000_000_000_000_000
# Of a message on the wire: 1, the subscription's number, the time in ns; then the data.
MESSAGE = struct.Struct("<BIQ")
TOPICS = {*FORWARDED, DIAGNOSTICS}
HEALTH: dict[str, Any] = {
    "robot": "bot",
    "validity": "degraded",
    "reasons": [{"source": "encoders.port", "text": "silent", "since_s": 2.0}],
    "fog_rate_hz": 10.0,
    "fog_temperature_c": None,
    "learned": {"tread_m": {"value": 0.61, "sigma": 0.01}},
    "counters": {"fog": {"samples": 7}, "encoders": {"samples": 3}},
    "wall_ns": WALL_NS,
}


def a_pose(count: int) -> Pose:
    reasons = (Reason("encoders", "silent", 1),)
    return Pose(
        count * 50_000_000, count, 0.05 * count, -0.02 * count, 0.3, 1.0, 0.1, 0.01, 0.01, (0.0,) * 6, 0.5,
        Validity.DEGRADED, reasons,
    )  # fmt: skip


@pytest.fixture
def endpoint() -> Iterator[str]:
    """A daemon that publishes 20 poses a second and its health, with frames of its own names."""
    endpoint, stop, loop = free_endpoint(), threading.Event(), asyncio.new_event_loop()
    output = Output(listen=(endpoint,), frame_id="map_of_mine", child_frame_id="my_robot")
    names = {"frame_id": output.frame_id, "child_frame_id": output.child_frame_id}
    handlers = dict.fromkeys(("pose", "health", "config", "set_pose", "reset", "calibrate_bias"), lambda p: p)
    handlers["config"] = lambda _: {"config": {"output": names}}
    link = ZenohLink(output, handlers, loop)

    def publish() -> None:
        count = 0
        while not stop.wait(0.05):
            count += 1
            link.publish_pose(a_pose(count), WALL_NS + count * 50_000_000)
            link.publish_health(HEALTH)

    threads = [threading.Thread(target=work) for work in (publish, loop.run_forever)]
    for thread in threads:
        thread.start()
    try:
        yield endpoint
    finally:
        stop.set()
        threads[0].join(10.0)
        link.close()
        loop.call_soon_threadsafe(loop.stop)
        threads[1].join(10.0)
        loop.close()


@pytest.fixture
def address(endpoint: str) -> Iterator[str]:
    """Where viewers connect."""
    with (
        zenoh.open(isolated_config("client", (), (endpoint,))) as session,
        serving(session, "drd", "127.0.0.1", 0) as server,
    ):
        yield f"ws://127.0.0.1:{server.port}"


def watch(address: str, topics: set[str], each: int) -> tuple[dict[str, Any], dict[str, list[tuple[int, bytes]]]]:
    """The advertised channels by topic, and at least `each` messages of each topic with their times."""
    channels: dict[str, Any] = {}
    found: dict[str, list[tuple[int, bytes]]] = defaultdict(list)
    with connect(address, subprotocols=[Subprotocol("foxglove.sdk.v1")]) as client:
        assert client.subprotocol == "foxglove.sdk.v1"
        while {topic for topic in topics if len(found[topic]) >= each} < topics:
            data = client.recv(timeout=20.0)
            if isinstance(data, bytes):
                opcode, number, time_ns = MESSAGE.unpack_from(data)
                assert opcode == 1
                found[sorted(channels)[number]].append((time_ns, data[MESSAGE.size :]))
            elif (said := json.loads(data))["op"] == "advertise":
                channels |= {c["topic"]: c for c in said["channels"]}
                assert topics <= channels.keys()
                wanted = [{"id": i, "channelId": channels[topic]["id"]} for i, topic in enumerate(sorted(channels))]
                client.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
    return channels, found


def test_a_viewer_gets_pose_transform_path_bound_and_health(address: str) -> None:
    channels, found = watch(address, TOPICS, 3)
    assert channels.keys() == TOPICS
    recorded = {c.topic: (c.encoding, c.schema_name, c.schema_encoding) for c in CHANNELS}
    for topic in FORWARDED:
        channel = channels[topic]
        assert (channel["encoding"], channel["schemaName"], channel["schemaEncoding"]) == recorded[topic]

    def decoded(topic: str) -> list[Any]:
        schema = {c.topic: c for c in CHANNELS}[topic]
        return [message_class(schema.schema, schema.schema_name).FromString(data) for _, data in found[topic]]

    by_time = {json.loads(data)["wall_ns"]: json.loads(data) for _, data in found["/drd/pose"]}
    assert [time_ns for time_ns, _ in found["/drd/pose"]] == list(by_time)
    agreed = 0
    for transform in decoded("/tf"):
        assert (transform.parent_frame_id, transform.child_frame_id) == ("map_of_mine", "my_robot")
        if (pose := by_time.get(transform.timestamp.ToNanoseconds())) is not None:
            agreed += 1
            assert (transform.translation.x, transform.translation.y) == (pose["x_m"], pose["y_m"])
    assert agreed >= 2
    assert {pose.frame_id for pose in decoded("/pose")} == {"map_of_mine"}
    path, bound = decoded("/scene")[-1].entities
    assert len(path.lines[0].points) > 10
    assert (bound.frame_id, bound.cylinders[0].size.x) == ("my_robot", 1.0)
    assert json.loads(found["/health"][0][1]) == HEALTH


def test_the_health_is_a_table_of_diagnostics(address: str) -> None:
    channels, found = watch(address, {DIAGNOSTICS}, 1)
    assert channels[DIAGNOSTICS]["schemaName"] == "diagnostic_msgs/DiagnosticArray"
    array = json.loads(found[DIAGNOSTICS][0][1])
    assert array["header"]["stamp"] == {"sec": WALL_NS // 10**9, "nanosec": 0}
    rows = {row["name"]: row for row in array["status"]}
    assert [(name, row["level"], row["message"]) for name, row in rows.items()] == [
        ("drd: pose", 1, "degraded; encoders.port: silent"),
        ("drd: fog", 0, ""),
        ("drd: encoders", 1, "silent"),
        ("drd: learned", 0, ""),
    ]
    assert rows["drd: encoders"]["values"] == [{"key": "samples", "value": "3"}]
    assert {"key": "tread_m.value", "value": "0.61"} in rows["drd: learned"]["values"]
    assert {row["hardware_id"] for row in rows.values()} == {"bot"}


@pytest.mark.parametrize(
    "payload",
    [b"", b"\xff", b"[]", b"{}", b'{"wall_ns": -5}', b'{"wall_ns": 1e400}', b'{"wall_ns": "now", "counters": 3}',
     b'{"wall_ns": 1, "validity": "good", "robot": "", "reasons": [], "counters": {}, "learned": {}}',
     b'{"wall_ns": 1, "validity": "valid", "robot": "", "reasons": [{"source": 1, "text": 2}], "counters": {}}',
     b'{"wall_ns": 1, "validity": "valid", "robot": "", "reasons": [], "counters": 3, "learned": {}}',
     b'{"monotonic_ns": 1, "wall_ns": -1, "x_m": 0, "y_m": 0, "heading_rad": 0, "speed_m_s": 0,'
     b' "position_bound_99_m": 0, "validity": "valid"}'],
)  # fmt: skip
def test_what_cannot_be_read_is_counted(payload: bytes) -> None:
    channels = Channels(foxglove.Context(), "odom", "base_link")
    channels.take_pose(payload)
    channels.take_health(payload)
    assert channels.unreadable == 2


def test_a_pose_that_is_not_finite_and_counters_of_another_form_pass() -> None:
    channels = Channels(foxglove.Context(), "odom", "base_link")
    names = ("x_m", "y_m", "heading_rad", "speed_m_s", "position_bound_99_m")
    pose = {"monotonic_ns": 1, "wall_ns": 2, "validity": "invalid"} | dict.fromkeys(names)
    channels.take_pose(json.dumps(pose).encode())
    channels.take_health(json.dumps(HEALTH | {"counters": {"new": {"a": {"b": [1, None]}}}}).encode())
    assert channels.unreadable == 0


@pytest.mark.process
def test_the_command_serves_until_it_is_told_to_end(endpoint: str) -> None:
    command = [sys.executable, "-W", "error", "-m", "drd", "foxglove", "--connect", endpoint, "--listen", "127.0.0.1:0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            line = process.stdout.readline()
            match = re.fullmatch(r"(ws://127\.0\.0\.1:\d+)  layout: (.*)\n", line)
            assert match, line or process.communicate(timeout=10.0)
            assert Path(match[2]).exists()
            _, found = watch(match[1], {"/tf"}, 2)
            assert len(found["/tf"]) >= 2
        finally:
            process.send_signal(signal.SIGTERM)
            _, errors = process.communicate(timeout=15.0)
    assert process.returncode == 0, errors
    assert "Traceback" not in errors


def test_a_daemon_that_is_not_there_and_a_taken_address_are_told(
    endpoint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    nobody = free_endpoint()
    assert main(["foxglove", "--connect", nobody]) == 1
    assert f"drd foxglove: {nobody}, prefix drd: " in capsys.readouterr().err
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert main(["foxglove", "--connect", endpoint, "--listen", f"127.0.0.1:{port}"]) == 1
    assert f"drd foxglove: cannot listen on 127.0.0.1:{port}: " in capsys.readouterr().err


@pytest.mark.parametrize("address", ["8765", ":8765", "127.0.0.1:port", "127.0.0.1:70000"])
def test_an_address_has_host_and_port(address: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(["foxglove", "--listen", address])
    assert end.value.code == 2
    assert "expected HOST:PORT" in capsys.readouterr().err


def test_foxgloves_own_client_gets_every_topic(address: str) -> None:
    """Where node finds @foxglove/ws-protocol (and, before node 22, ws): in a folder that NODE_PATH names."""
    node = shutil.which("node")
    if node is None:
        pytest.skip("node is not installed")
    needed = "require('@foxglove/ws-protocol'); globalThis.WebSocket ?? require('ws')"
    if subprocess.run([node, "-e", needed], check=False, capture_output=True).returncode:
        pytest.skip(f"node finds no @foxglove/ws-protocol or no ws; NODE_PATH={os.environ.get('NODE_PATH', '')!r}")
    command = [node, str(Path(__file__).with_name("foxglove_client.js")), address, "3"]
    result = subprocess.run(command, capture_output=True, text=True, timeout=30.0, check=False)
    assert result.returncode == 0, result.stderr
    counts = json.loads(result.stdout)
    assert counts.keys() == TOPICS
    assert counts["/tf"] > 10


def test_the_layout_shows_topics_that_there_are() -> None:
    layout = json.loads(shipped_config("foxglove-layout.json").read_text())
    panels = list(leaves(layout["layout"]))
    assert sorted(panels) == sorted(layout["configById"])
    text = json.dumps(layout["configById"])
    named = set(re.findall(r'"(/[a-z_/]+)', text))
    assert named
    assert named <= TOPICS
    published = {c.topic: json.loads(c.schema)["properties"] for c in CHANNELS if c.encoding == "json"}
    for topic, field in re.findall(r'"(/[a-z_/]+)\.(\w+)', text):
        assert field in published[topic]


def leaves(tree: Any) -> Iterator[str]:
    if isinstance(tree, str):
        yield tree
    else:
        with contextlib.suppress(KeyError):
            yield from leaves(tree["first"])
            yield from leaves(tree["second"])
