"""A neighbour on the loopback that does its worst, bounded in count and time; `bench flood` says what it delays."""

import contextlib
import json
import math
import random
import re
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import zenoh
from harness import Robot
from links import POSE, a_link, ask, first_sample, free_endpoint, subscribe, wait_for

from drd.output.queries import QUERIES_AT_ONCE, QUERIES_PER_S
from drd.output.session import isolated_config

ROUND = 300
GIVEN_UP_S = 2.0
MAX_GROWTH_BYTES = 30e6


class Served:
    """A daemon process with commands off, its robot, its log and its memory."""

    def __init__(self, robot: Robot, process: "subprocess.Popen[str]", log: Path):
        self.robot, self.process, self.log = robot, process, log

    def resident_bytes(self) -> int:
        found = re.search(r"VmRSS:\s+(\d+) kB", Path(f"/proc/{self.process.pid}/status").read_text())
        assert found
        return int(found[1]) * 1024


@pytest.fixture
def served(robot: Robot, tmp_path: Path) -> Iterator[Served]:
    text = robot.file.read_text()
    assert "commands: true" in text
    robot.file.write_text(text.replace("commands: true, ", "").replace("freeze_gc: false", "freeze_gc: true"))
    robot.emulator.plug_in()
    log = tmp_path / "log"
    with log.open("w") as stderr:
        process = subprocess.Popen([sys.executable, "-m", "drd", "run", str(robot.file)], stderr=stderr, text=True)
    try:
        robot.drive()
        robot.wait("a moving robot", lambda p: p["validity"] == "valid" and p["speed_m_s"] > 0.5, 20.0)
        yield Served(robot, process, log)
    finally:
        process.terminate()
        assert process.wait(15.0) == 0, log.read_text()


def hostile_gets(rng: random.Random) -> list[tuple[str, dict[str, Any]]]:
    """Key and options of queries that should never have been sent."""
    goal = json.dumps({"x_m": 1e3, "y_m": 1e3, "heading_rad": 3.0}).encode()
    one_round: list[tuple[str, dict[str, Any]]] = [
        ("drd/pose", {"payload": b"[" * 3000}),
        ("drd/health", {"payload": rng.randbytes(rng.randrange(1, 5000))}),
        ("drd/config", {"payload": b"9" * 4000}),
        ("drd/pose", {"payload": b" " * 60_000}),
        ("drd/pose", {"payload": b" " * 200_000}),
        ("drd/pose?" + "a=1;" * 2000, {}),
        ("drd/pose", {"attachment": rng.randbytes(60_000)}),
        ("drd/set_pose", {"payload": goal}),
        ("drd/reset", {}),
        ("drd/calibrate_bias", {"payload": b"{"}),
        ("drd/**", {"payload": goal}),
        ("**", {}),
    ]
    return one_round * (ROUND // len(one_round) * 4)


@pytest.mark.process
def test_a_flood_of_bad_queries_changes_nothing(served: Served) -> None:
    robot, before = served.robot, served.resident_bytes()
    first, began_s = robot.poses[-1]["sequence"], time.monotonic()
    gets = hostile_gets(random.Random(1))
    with zenoh.open(isolated_config("client", (), (robot.endpoint,))) as other:
        ended: list[None] = []
        for key, options in gets:
            handler: Any = zenoh.handlers.Callback(lambda _: None, drop=lambda: ended.append(None), indirect=False)
            other.get(key, handler, timeout=GIVEN_UP_S, **options)
        wait_for(lambda: len(ended) == len(gets))
    time.sleep(1.5)  # the next health
    assert robot.health["counters"]["systemd"] == {"notify_errors": 0}
    counters = robot.health["counters"]["zenoh"]
    assert counters["commands"] == 0
    # Each get reaches the desk once for each key that it matches; the message of 200 kB is dropped on the way.
    rounds = len(gets) // 12
    assert counters["queries"] == rounds * (9 + 7 + 7)
    assert counters["put_errors"] == 0
    elapsed_s = time.monotonic() - began_s
    read = counters["queries"] - counters["queries_refused"]
    assert read <= QUERIES_AT_ONCE + QUERIES_PER_S * elapsed_s
    assert counters["query_errors"] > 0
    poses = [p for p in robot.poses if p["sequence"] > first]
    assert poses[-1]["sequence"] - first >= 0.5 * 20.0 * elapsed_s, "the estimator has gone on"
    assert [p["sequence"] for p in poses] == sorted({p["sequence"] for p in poses})
    assert not {p["validity"] for p in poses} & {"invalid", "initialising"}
    last = poses[-1]
    truth = min(robot.emulator.truth.copy(), key=lambda row: abs(row.t_ns - last["monotonic_ns"]))
    assert math.hypot(last["x_m"] - truth.x_m, last["y_m"] - truth.y_m) < last["position_bound_99_m"]
    assert served.resident_bytes() - before < MAX_GROWTH_BYTES
    log = served.log.read_text()
    assert "outcome=refused" in log
    assert "outcome=accepted" not in log
    assert log.count("command=") < 50


@pytest.mark.process
def test_bytes_that_are_not_zenoh_leave_the_daemon_as_it_is(served: Served) -> None:
    rng = random.Random(2)
    host, port = served.robot.endpoint.removeprefix("tcp/").split(":")
    before, count = served.resident_bytes(), len(served.robot.poses)
    with contextlib.ExitStack() as stack:
        for size in [0, 1, 2, 7, 100, 70_000] * 10:
            s = stack.enter_context(socket.create_connection((host, int(port)), timeout=5.0))
            with contextlib.suppress(OSError):  # it may hang up before all is sent
                s.sendall(rng.randbytes(size))
        assert served.robot.get("pose")["sequence"] > 0, "while they are open"
    assert served.robot.get("health")["robot"] == "test"
    served.robot.wait("a later pose", lambda p: p["validity"] == "valid")
    assert len(served.robot.poses) > count
    assert served.resident_bytes() - before < MAX_GROWTH_BYTES


def test_nobody_speaks_to_others_through_the_daemon() -> None:
    endpoint = free_endpoint()
    with (
        a_link(listen=(endpoint,)) as (link, listener),
        zenoh.open(isolated_config("client", (), (endpoint,))) as feigner,
    ):
        heard = subscribe(listener, "drd/pose")
        first_sample(heard, lambda: link.publish_pose(POSE, 5))
        while heard.try_recv() is not None:
            pass
        for key in ("drd/pose", "**", "elsewhere"):
            feigner.put(key, b"{}")
        feigner.declare_queryable("**", lambda query: query.reply("drd/pose", b'{"handler": "feigned"}'))
        token: Any = feigner.liveliness().declare_token("drd/feigned")
        time.sleep(0.2)
        assert [answer["handler"] for _, answer in ask(listener, "drd/pose")] == ["pose"]
        tokens = [str(r.ok.key_expr) for r in listener.liveliness().get("**", timeout=5.0)]
        assert tokens == ["drd/alive"]
        assert heard.try_recv() is None
        token.undeclare()


def test_neighbours_beyond_the_limit_are_not_let_in_and_the_log_says_so(caplog: pytest.LogCaptureFixture) -> None:
    endpoint = free_endpoint()

    def warnings() -> int:
        return sum("output.max_sessions" in record.getMessage() for record in caplog.records)

    with a_link(listen=(endpoint,), max_sessions=2) as (link, other):
        assert (link.neighbours(), warnings()) == (1, 0)
        with zenoh.open(isolated_config("client", (), (endpoint,))):
            with pytest.raises(zenoh.ZError):
                zenoh.open(isolated_config("client", (), (endpoint,)))
            assert (link.neighbours(), warnings()) == (2, 1)
            assert (link.neighbours(), warnings()) == (2, 1)
        assert ask(other, "drd/pose")[0][0]


def test_a_hundred_neighbours_are_let_in() -> None:
    with contextlib.ExitStack() as stack:
        endpoint = free_endpoint()
        link, _ = stack.enter_context(a_link(listen=(endpoint,)))
        others = [stack.enter_context(zenoh.open(isolated_config("client", (), (endpoint,)))) for _ in range(99)]
        first_sample(subscribe(others[-1], "drd/pose"), lambda: link.publish_pose(POSE, 5))
        assert link.neighbours() == 100
