"""All who can watch a daemon, one of each kind, as processes of their own; counts what each of them hears."""

import asyncio
import json
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from typing import Any, Final

import aiohttp
import zenoh

from bench.listener import ENVIRONMENT
from bench.report import Refused
from drd.output.session import isolated_config

# Messages for each pose: in Foxglove and in ROS 2 there are several, and those of the health come on top.
HEARD_PER_POSE: Final = {"browser": 1, "foxglove": 3, "watch": 1, "pose": 1, "odom": 1, "ros2": 4}
ROS2_KEYS: Final = "0/**"  # ROS_DOMAIN_ID 0


class Audience:
    """The running processes: `watch` writes into the pipe that `hearer` reads."""

    def __init__(self, watch: "subprocess.Popen[str]", hearer: "subprocess.Popen[str]"):
        self._watch, self._hearer = watch, hearer

    def heard(self) -> dict[str, int]:
        """End it; how many messages each one heard. Raises Refused."""
        self._watch.terminate()
        output, _ = self._hearer.communicate(timeout=20)
        if self._hearer.returncode != 0:
            raise Refused("the process of browser, viewer and Zenoh session failed")
        found: dict[str, int] = json.loads(output)
        return found


@contextmanager
def audience(endpoint: str, prefix: str) -> Iterator[Audience]:
    """`drd web` and its browser, `drd foxglove` and its viewer, `drd watch --json`, a Zenoh session. Raises Refused."""
    environment = ENVIRONMENT | {"FOXGLOVE_LOG_LEVEL": "error"}
    with ExitStack() as stack:

        def start(*command: str, stdin: Any = None) -> "subprocess.Popen[str]":
            line = [sys.executable, "-m", *command]
            process = subprocess.Popen(line, stdin=stdin, stdout=subprocess.PIPE, text=True, env=environment)
            stack.enter_context(process)
            stack.callback(process.kill)
            return process

        at = ("--connect", endpoint, "--prefix", prefix)
        servers = [start("drd", name, *at, "--listen", "127.0.0.1:0") for name in ("web", "foxglove")]
        watch = start("drd", "watch", *at, "--json")
        addresses = [_first_word(server) for server in servers]
        hearer = start("bench.audience", endpoint, prefix, *addresses, stdin=watch.stdout)
        _first_word(hearer)
        yield Audience(watch, hearer)


def _first_word(process: "subprocess.Popen[str]") -> str:
    """Of its output, once there is one."""
    assert process.stdout is not None
    words = process.stdout.readline().split()
    if not words:
        raise Refused(f"one of those who watch did not start: {process.args!r}")
    return words[0]


def check_heard(heard: Mapping[str, int], poses: int) -> None:
    """Whoever missed more than one in ten did not really watch. Raises Refused."""
    for name, each in HEARD_PER_POSE.items():
        if heard.get(name, 0) < 0.9 * each * poses:
            raise Refused(f"{name} heard {heard.get(name, 0)} messages of {poses} poses, expected {each} of each")


async def _browse(socket: aiohttp.ClientWebSocketResponse, heard: Counter[str]) -> None:
    async for message in socket:
        heard["browser"] += json.loads(message.data)["type"] == "pose"


async def _view(socket: aiohttp.ClientWebSocketResponse, heard: Counter[str]) -> None:
    """Subscribe to all topics."""
    async for message in socket:
        if message.type is aiohttp.WSMsgType.BINARY:
            heard["foxglove"] += 1
        elif (said := json.loads(message.data))["op"] == "advertise":
            wanted = [{"id": channel["id"], "channelId": channel["id"]} for channel in said["channels"]]
            await socket.send_json({"op": "subscribe", "subscriptions": wanted})


def _read(heard: Counter[str]) -> None:
    for _ in sys.stdin:
        heard["watch"] += 1


async def _hear(page: str, server: str, heard: Counter[str]) -> None:
    """Until standard input, which `drd watch` writes, ends."""
    async with (
        aiohttp.ClientSession() as http,
        http.ws_connect(f"{page}stream") as browser,
        http.ws_connect(server, protocols=("foxglove.sdk.v1",)) as viewer,
    ):
        tasks = [asyncio.create_task(work) for work in (_browse(browser, heard), _view(viewer, heard))]
        print("ready", flush=True)
        await asyncio.to_thread(_read, heard)
        for task in tasks:
            task.cancel()


def _main(endpoint: str, prefix: str, page: str, server: str) -> None:
    """Listen, then print what each one heard as JSON."""
    heard: Counter[str] = Counter()
    keys = {"pose": f"{prefix}/pose", "odom": f"{prefix}/odom", "ros2": ROS2_KEYS}
    with zenoh.open(isolated_config("client", (), (endpoint,))) as session:
        for name, key in keys.items():

            def count(_: Any, name: str = name) -> None:
                heard[name] += 1

            session.declare_subscriber(key, zenoh.handlers.Callback(count, indirect=False))
        asyncio.run(_hear(page, server, heard))
    print(json.dumps(heard))


if __name__ == "__main__":
    _main(*sys.argv[1:])
