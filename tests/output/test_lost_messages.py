"""Nothing is lost between a busy machine's daemon and its readers; where something may be, it is counted."""

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest
import zenoh
from links import PATIENCE_S, POSE, a_link, first_sample, free_endpoint, subscribe

from drd.output.session import isolated_config

POSES = 80
KEYS = ("drd/pose", "drd/odom", "0/odom/**", "0/tf/**")
# All on one processor, which busy processes want too: Zenoh's sending thread then waits for its turn. At
# 20 Hz, as drd, in pairs, as frames come from an adapter.
PUBLISHER = f"""
import asyncio, os, subprocess, sys, time
os.sched_setaffinity(0, {{min(os.sched_getaffinity(0))}})
from links import POSE
from drd.config.keys import Output
from drd.output.zenoh_link import ZenohLink

link = ZenohLink(Output(listen=(sys.argv[1],), ros2=True), {{}}, asyncio.new_event_loop())
print("up", flush=True)
ros2 = link._ros2
publishers = (link._pose, link._odom, ros2.odometry._publisher, ros2._tf._publisher)
while not all(publisher.matching_status.matching for publisher in publishers):
    time.sleep(0.05)
for _ in range(3):
    subprocess.Popen([sys.executable, "-S", "-c", "import os; p = os.getppid()\\nwhile os.getppid() == p: pass"])
for _ in range({POSES // 2}):
    link.publish_pose(POSE, 5)
    link.publish_pose(POSE, 5)
    time.sleep(0.1)
time.sleep(60)
"""
READER = """
import sys, time, zenoh
from drd.output.session import isolated_config
session = zenoh.open(isolated_config("client", (), (sys.argv[1],)))
subscriber = session.declare_subscriber("drd/**", lambda _: None)
print("up", flush=True)
time.sleep(60)
"""

pytestmark = pytest.mark.process


@contextlib.contextmanager
def started(program: str, endpoint: str) -> Iterator[Any]:
    """The program in a process of its own, once it is up."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    command = [sys.executable, "-c", program, endpoint]
    with subprocess.Popen(command, stdout=subprocess.PIPE, env=environment) as process:
        try:
            assert process.stdout
            assert process.stdout.readline() == b"up\n"
            yield process
        finally:
            process.kill()


def test_a_session_that_listens_to_all_keys_misses_nothing_while_the_machine_is_busy() -> None:
    endpoint, heard = free_endpoint(), Counter[str]()
    with (
        started(PUBLISHER, endpoint),
        zenoh.open(isolated_config("client", (), (endpoint,))) as session,
    ):

        def count(sample: Any) -> None:
            heard[str(sample.key_expr).partition("::")[0]] += 1

        for key in KEYS:
            session.declare_subscriber(key, count)
        deadline = time.monotonic() + POSES * 0.05 + PATIENCE_S
        while heard.total() < len(KEYS) * POSES and time.monotonic() < deadline:
            time.sleep(0.05)
    assert dict(heard) == {"drd/pose": POSES, "drd/odom": POSES, "0/odom/nav_msgs": POSES, "0/tf/tf2_msgs": POSES}


def test_messages_that_a_reader_may_have_lost_are_counted() -> None:
    endpoint = free_endpoint()
    with a_link(listen=(endpoint,)) as (link, other), started(READER, endpoint) as reader:
        first_sample(subscribe(other, "drd/pose"), lambda: link.publish_pose(POSE, 5))
        before = link.counters["full_queues"]
        reader.send_signal(signal.SIGSTOP)
        deadline = time.monotonic() + PATIENCE_S
        # More than the kernel keeps for a reader that has stopped.
        while link.counters["full_queues"] == before:
            assert time.monotonic() < deadline
            link.publish_health({"text": "x" * 60_000})


@pytest.mark.parametrize("is_waiting", [True, False])
def test_a_message_that_waits_for_room_is_counted_but_not_one_that_waits_for_the_processor(is_waiting: bool) -> None:
    def put(_: bytes) -> None:
        end = time.monotonic() + 0.005
        while time.monotonic() < end:
            if is_waiting:
                time.sleep(0.001)

    with a_link() as (link, _):
        link._health = SimpleNamespace(put=put)
        link.publish_health({})
        assert link.counters["full_queues"] == is_waiting
