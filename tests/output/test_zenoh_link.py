import contextlib
import json
import logging
import os
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import zenoh
import zenoh.ext
from links import HANDLERS, PATIENCE_S, POSE, a_link, ask, event_loop, first_sample, free_endpoint, subscribe, wait_for
from rosbags.typesys import Stores, get_typestore

from drd.config.keys import Output, Ros2Topics
from drd.config.schema import ConfigError
from drd.output.forms import COMMANDS, QUESTIONS, JsonForm
from drd.output.messages import MAX_REQUEST_BYTES, Refused, pose_json
from drd.output.queries import MAX_IN_FLIGHT, QueryDesk
from drd.output.session import MAX_MESSAGE_BYTES, isolated_config
from drd.output.zenoh_link import ZenohLink


def test_a_subscriber_gets_pose_odometry_and_health() -> None:
    with a_link() as (link, other):
        sample = first_sample(subscribe(other, "drd/pose"), lambda: link.publish_pose(POSE, 5))
        assert sample.payload.to_bytes() == pose_json(POSE, 5)
        assert sample.encoding == zenoh.Encoding.APPLICATION_JSON
        assert sample.priority == zenoh.Priority.REAL_TIME
        assert sample.express
        sample = first_sample(subscribe(other, "drd/odom"), lambda: link.publish_pose(POSE, 5))
        message: Any = get_typestore(Stores.ROS2_HUMBLE).deserialize_cdr(
            sample.payload.to_bytes(), "nav_msgs/msg/Odometry"
        )
        assert (message.header.frame_id, message.pose.pose.position.y) == ("odom", 4.0)
        assert str(sample.encoding) == "application/cdr;nav_msgs/msg/Odometry"
        assert sample.attachment is None
        sample = first_sample(subscribe(other, "drd/health"), lambda: link.publish_health({"a": float("nan")}))
        assert json.loads(sample.payload.to_bytes()) == {"a": None}
        assert link.counters["poses"] > 0
        assert link.counters["health"] > 0
        assert link.counters["put_errors"] == 0


def test_the_prefix_is_used_and_liveliness_tells_of_birth_and_death() -> None:
    with a_link(prefix="fleet/one") as (link, other):
        assert [str(r.ok.key_expr) for r in other.liveliness().get("**", timeout=5.0)] == ["fleet/one/alive"]
        watcher = other.liveliness().declare_subscriber("fleet/one/alive", zenoh.handlers.RingChannel(4), history=True)
        assert watcher.recv().kind == zenoh.SampleKind.PUT
        assert link.close(PATIENCE_S)
        assert watcher.recv().kind == zenoh.SampleKind.DELETE


def test_every_queryable_answers_with_what_its_handler_returns() -> None:
    with a_link(commands=True) as (link, other):
        for name in HANDLERS:
            assert ask(other, f"drd/{name}", b'{"x": 1}') == [(True, {"handler": name, "payload": {"x": 1}})]
            assert ask(other, f"drd/{name}") == [(True, {"handler": name, "payload": {}})]
        assert link.counters["queries"] == 2 * len(HANDLERS)
        assert link.counters["commands"] == 2 * len(COMMANDS)
        assert link.counters["query_errors"] == link.counters["queries_refused"] == 0


@pytest.mark.parametrize("name", COMMANDS)
def test_commands_are_refused_unless_the_configuration_allows_them(name: str) -> None:
    called: list[str] = []

    def note(_: dict[str, Any]) -> dict[str, Any]:
        called.append(name)
        return {}

    handlers = HANDLERS | {name: note}
    with a_link(handlers) as (link, other):
        [(good, answer)] = ask(other, f"drd/{name}", b"{}")
        assert not good
        assert "output.commands" in answer["error"]
        assert link.counters["queries_refused"] == 1
        assert link.counters["commands"] == 0
    assert not called


def test_a_get_on_a_wildcard_reads_and_never_commands() -> None:
    with a_link(commands=True) as (link, other):
        answers = ask(other, "drd/**")
        assert sorted(a["handler"] for good, a in answers if good) == sorted(QUESTIONS)
        assert len(answers) == len(QUESTIONS)
        assert link.counters["commands"] == 0
        assert link.counters["queries_refused"] == len(COMMANDS)


def test_commands_are_logged_without_letting_the_payload_break_the_line(
    caplog: pytest.LogCaptureFixture,
) -> None:
    with caplog.at_level(logging.INFO), a_link(commands=True) as (_, other):
        ask(other, "drd/reset", b'{"why": "new\\nline", "a": "\n"}')
        ask(other, "drd/reset", b'{"why": "new\\nline"}')
    lines = [r.getMessage() for r in caplog.records if "command=drd/reset" in r.getMessage()]
    assert ["refused" in line for line in lines] == [True, False]
    assert "outcome=accepted" in lines[1]
    assert all("new" in line and "\n" not in line for line in lines)


def test_what_a_handler_refuses_reaches_the_asker_and_a_broken_handler_stays_inside(
    caplog: pytest.LogCaptureFixture,
) -> None:
    def refuse(_: dict[str, Any]) -> dict[str, Any]:
        raise Refused("no pose yet")

    def broken(_: dict[str, Any]) -> dict[str, Any]:
        raise KeyError("secret")

    with a_link(HANDLERS | {"pose": refuse, "health": broken}) as (link, other):
        assert ask(other, "drd/pose") == [(False, {"error": "no pose yet"})]
        [(good, answer)] = ask(other, "drd/health")
        assert not good
        assert "secret" not in answer["error"]
        assert link.counters["query_errors"] == 2
        assert ask(other, "drd/config")[0][0]
    assert "handler=health" in caplog.text


@pytest.mark.parametrize("payload", [b"{", b"[1]", b"\xff", b'{"x": NaN}', b"[" * 3000, b"x" * (MAX_REQUEST_BYTES + 1)])
def test_a_malformed_or_oversize_payload_is_refused_and_counted(payload: bytes) -> None:
    with a_link() as (link, other):
        [(good, answer)] = ask(other, "drd/pose", payload)
        assert not good
        assert "payload" in answer["error"]
        assert link.counters["query_errors"] == 1
        assert ask(other, "drd/pose")[0][0]


def test_a_huge_payload_is_dropped_before_it_takes_memory() -> None:
    with a_link() as (link, other):
        replies = list(other.get("drd/pose", payload=b" " * (4 * MAX_MESSAGE_BYTES), timeout=0.3))
        assert not any(r.ok for r in replies)
        assert link.counters["queries"] == 0
        assert ask(other, "drd/pose")[0][0]


def test_parameters_are_ignored() -> None:
    with a_link() as (_, other):
        assert ask(other, "drd/pose?x=1;_time=[now(-1s)..now()]")[0][0]


def test_a_flood_of_queries_is_bounded_and_every_getter_ends() -> None:
    release = threading.Event()

    def slow(_: dict[str, Any]) -> dict[str, Any]:
        release.wait(PATIENCE_S)
        return {}

    asked = 3 * MAX_IN_FLIGHT
    with a_link(HANDLERS | {"pose": slow}) as (link, other):
        getters = [other.get("drd/pose", timeout=60.0) for _ in range(asked)]
        wait_for(lambda: link.counters["queries"] == asked)
        release.set()
        replies = [reply for getter in getters for reply in getter]
        assert len(replies) == asked
        assert sum(r.ok is not None for r in replies) == MAX_IN_FLIGHT
        assert link.counters["queries_refused"] == asked - MAX_IN_FLIGHT
        # The last getter ends before the desk has put its answer away.
        wait_for(lambda: ask(other, "drd/pose")[0][0])


def test_a_getter_that_does_not_read_holds_up_the_reply_thread_and_not_the_loop() -> None:
    stalled, reading = threading.Event(), threading.Event()

    class Query(contextlib.nullcontext[None]):
        key_expr, payload, attachment = "drd/pose", None, None

        def reply(self, *_: Any, **__: Any) -> None:
            stalled.set()
            reading.wait(PATIENCE_S)

    with event_loop() as loop:
        desk = QueryDesk(HANDLERS, False, loop, {})
        desk._receive(JsonForm("pose", "drd/pose"), Query())
        assert stalled.wait(PATIENCE_S)
        passed = threading.Event()
        loop.call_soon_threadsafe(passed.set)
        assert passed.wait(PATIENCE_S)
        assert not reading.is_set()
        reading.set()
        desk.close()


def test_queries_that_come_when_the_loop_is_gone_are_refused() -> None:
    with event_loop() as loop:
        pass
    refused: list[bytes] = []
    query: Any = contextlib.nullcontext()
    query.payload, query.attachment, query.key_expr = None, None, "drd/pose"
    query.reply_err = lambda payload, **_: refused.append(payload)
    desk = QueryDesk(HANDLERS, False, loop, {})
    for _ in range(2 * MAX_IN_FLIGHT):
        desk._receive(JsonForm("pose", "drd/pose"), query)
    desk.close()
    assert len(refused) == 2 * MAX_IN_FLIGHT == desk.counters["queries_refused"]
    assert desk._in_flight == 0


@pytest.mark.parametrize(
    ("output", "key"),
    [
        ({"listen": ("rubbish",)}, "output.listen"),
        ({"listen": ("foo/127.0.0.1:1",)}, "output.listen"),
        ({"listen": ("tcp/127.0.0.1:99999",)}, "output.listen"),
        ({"connect": ("rubbish",)}, "output.connect"),
        ({"connect": ("foo/127.0.0.1:1",)}, "output.connect"),
        ({"prefix": "a//b"}, "output.prefix"),
        ({"prefix": "a#b"}, "output.prefix"),
        ({"ros2_topic": "no name"}, "output.ros2_topic"),
        ({"ros2_topics": Ros2Topics(tf="2tf")}, "output.ros2_topics.tf"),
        ({"ros2_joints": ("left",)}, "output.ros2_joints"),
        ({"zenoh_config": "/nonexistent/zenoh.json5"}, "output.zenoh_config"),
    ],
)
def test_what_cannot_be_opened_names_its_key(output: dict[str, Any], key: str) -> None:
    with event_loop() as loop, pytest.raises(ConfigError) as error:
        ZenohLink(Output(**({"listen": (free_endpoint(),)} | output)), HANDLERS, loop)
    assert error.value.path == key
    assert ".rs:" not in str(error.value)


def test_a_port_in_use_names_the_key_and_the_reason() -> None:
    with socket.socket() as taken, event_loop() as loop:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        endpoint = f"tcp/127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(ConfigError, match="in use") as error:
            ZenohLink(Output(listen=(endpoint,)), HANDLERS, loop)
    assert error.value.path == "output.listen"


def test_a_bad_zenoh_file_names_the_file(tmp_path: Path) -> None:
    file = tmp_path / "zenoh.json5"
    file.write_text("{mode: 'quark'}")
    with event_loop() as loop, pytest.raises(ConfigError, match="quark") as error:
        ZenohLink(Output(zenoh_config=str(file)), HANDLERS, loop)
    assert str(tmp_path) in error.value.got


def test_zenohs_own_file_is_taken_as_it_stands(tmp_path: Path) -> None:
    endpoint, ignored = free_endpoint(), free_endpoint()
    file = tmp_path / "zenoh.json5"
    file.write_text(
        f"{{mode: 'peer', listen: {{endpoints: ['{endpoint}']}}, scouting: {{multicast: {{enabled: false}}}}, "
        "transport: {shared_memory: {enabled: false}}}"
    )
    with event_loop() as loop:
        link = ZenohLink(Output(zenoh_config=str(file), listen=(ignored,)), HANDLERS, loop)
        try:
            with zenoh.open(isolated_config("client", (), (endpoint,))) as other:
                assert ask(other, "drd/pose")[0][0]
            with pytest.raises(zenoh.ZError):
                zenoh.open(isolated_config("client", (), (ignored,)))
        finally:
            assert link.close(PATIENCE_S)


def test_a_router_that_appears_later_and_again_gets_the_pose_and_brings_other_peers() -> None:
    router_endpoint = free_endpoint()

    def neighbour(mode: str, listen: tuple[str, ...], connect: tuple[str, ...]) -> Any:
        config = isolated_config(mode, listen, connect)
        config.insert_json5("scouting/gossip/enabled", "true")
        return zenoh.open(config)

    with event_loop() as loop:
        output = Output(listen=("tcp/127.0.0.1:0",), connect=(router_endpoint,))
        link = ZenohLink(output, HANDLERS, loop)
        try:
            link.publish_pose(POSE, 1)
            for _ in range(2):
                with (
                    neighbour("router", (router_endpoint,), ()) as router,
                    neighbour("peer", (), (router_endpoint,)) as peer,
                ):
                    for session in (router, peer):
                        first_sample(subscribe(session, "drd/pose"), lambda: link.publish_pose(POSE, 1))
        finally:
            assert link.close(PATIENCE_S)
        assert link.counters["put_errors"] == 0


def test_after_close_publishing_is_counted_and_close_may_be_called_again() -> None:
    with a_link() as (link, _):
        assert link.close(PATIENCE_S)
        link.publish_pose(POSE, 1)
        link.publish_health({})
        assert link.counters["put_errors"] == 3
        assert link.counters["poses"] == link.counters["health"] == 0
        assert link.close(PATIENCE_S)


def test_a_close_that_hangs_is_given_up_at_the_deadline() -> None:
    with a_link() as (link, _):
        release, session = threading.Event(), link._session

        def hang() -> None:
            release.wait(PATIENCE_S)
            session.close()

        link._session = SimpleNamespace(close=hang)
        assert not link.close(0.05)
        assert not link.close(0.05)
        release.set()
        assert link.close(PATIENCE_S)


def test_a_closed_link_leaves_no_thread_in_zenoh() -> None:
    # Exiting while a thread is in one of Zenoh's functions aborts the process.
    before = set(threading.enumerate())
    with a_link() as (link, _):
        link._desk._outbox.put(lambda: time.sleep(0.3))
        assert link.close(PATIENCE_S)
        names = {thread.name for thread in set(threading.enumerate()) - before}
    assert not names & {"zenoh-replies", "zenoh-close"}


def test_a_process_with_queryables_exits_with_its_code(tmp_path: Path) -> None:
    script = tmp_path / "process.py"
    script.write_text(
        "import asyncio, sys\n"
        "from drd.config.keys import Output\n"
        "from drd.output.zenoh_link import ZenohLink\n"
        "async def run():\n"
        "    handlers = dict.fromkeys(('pose','health','config','set_pose','reset','calibrate_bias'), lambda p: p)\n"
        "    link = ZenohLink(Output(listen=(sys.argv[1],)), handlers, asyncio.get_running_loop())\n"
        "    print('up', flush=True)\n"
        "    await asyncio.to_thread(sys.stdin.readline)\n"
        "    raise SystemExit(7 if link.close() else 8)\n"
        "asyncio.run(run())\n"
    )
    endpoint = free_endpoint()
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    with subprocess.Popen(
        [sys.executable, str(script), endpoint], stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment
    ) as process:
        assert process.stdout
        assert process.stdout.readline() == b"up\n"
        with zenoh.open(isolated_config("client", (), (endpoint,))) as other:
            assert ask(other, "drd/pose")[0][0]
            process.communicate(b"\n", timeout=30)
    assert process.returncode == 7
