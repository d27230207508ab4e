"""`drd web` between a robot that is there and browsers that are only clients."""

import asyncio
import json
import os
import signal
import socket as sockets
import subprocess
import sys

import aiohttp
import numpy as np
import pytest
from aiohttp import web
from links import free_endpoint
from prometheus_client.parser import text_string_to_metric_families
from web_robot import COMMAND, RADIUS_M, a_robot, a_web, next_message, pose_at

from drd.samples import Validity
from drd_tools.web import hub as hubs
from drd_tools.web.command import main
from drd_tools.web.history import COLUMNS
from drd_tools.web.hub import QUEUE, Hub


def test_a_browser_gets_the_past_the_pose_the_health_and_the_status() -> None:
    async def test() -> None:
        with a_robot(free_endpoint()) as robot:
            async with a_web(robot.endpoint) as url, aiohttp.ClientSession(url) as session:
                async with session.ws_connect("/stream") as first:
                    for _ in range(8):
                        await next_message(first, "pose")
                async with session.ws_connect("/stream") as socket:
                    hello = await next_message(socket, "hello")
                    assert hello["columns"] == list(COLUMNS)
                    assert hello["health"]["robot"] == "carousel"
                    assert hello["events"][-1]["validity"] == "valid"
                    pose = await next_message(socket, "pose")
                    assert np.hypot(pose["x_m"], pose["y_m"] - RADIUS_M) == pytest.approx(RADIUS_M)
                    assert pose["covariance"] == list(np.array(pose_at(1, 1).covariance)[[0, 1, 3, 5]])
                    assert (await next_message(socket, "health"))["health"]["counters"]["fog"]["samples"] == 77
                    status = await next_message(socket, "status")
                    assert status["alive"]
                    assert status["pose_age_s"] < 20
                async with session.get("/history") as answer:
                    rows = np.frombuffer(await answer.read(), "<f8").reshape(-1, len(COLUMNS))
                assert len(rows) >= 2
                np.testing.assert_allclose(np.hypot(rows[:, 1], rows[:, 2] - RADIUS_M), RADIUS_M)

    asyncio.run(test())


def test_a_change_of_validity_is_told_with_its_reasons() -> None:
    async def test() -> None:
        with a_robot(free_endpoint()) as robot:
            async with (
                a_web(robot.endpoint) as url,
                aiohttp.ClientSession(url) as session,
                session.ws_connect("/stream") as socket,
            ):
                await next_message(socket, "pose")
                robot.validity, robot.reasons = Validity.DEGRADED, (("fog", "silent"),)
                while (event := await next_message(socket, "event"))["validity"] != "degraded":
                    pass
                assert event["reasons"] == [{"source": "fog", "text": "silent"}]

    asyncio.run(test())


def test_twenty_browsers_get_every_message() -> None:
    async def listen(session: aiohttp.ClientSession) -> list[int]:
        async with session.ws_connect("/stream") as socket:
            return [(await next_message(socket, "pose"))["number"] for _ in range(15)]

    async def test() -> None:
        with a_robot(free_endpoint()) as robot:
            connector = aiohttp.TCPConnector(limit=0)
            async with a_web(robot.endpoint) as url, aiohttp.ClientSession(url, connector=connector) as session:
                heard = await asyncio.gather(*(listen(session) for _ in range(20)))
                for numbers in heard:
                    assert numbers == list(range(numbers[0], numbers[0] + 15))
                async with session.get("/metrics") as answer:
                    families = {f.name: f for f in text_string_to_metric_families(await answer.text())}
                assert families["drd_web_messages_dropped"].samples[0].value == 0
                assert families["drd_up"].samples[0].value == 1

    asyncio.run(test())


def test_a_stalled_browser_holds_a_few_messages_slows_nobody_and_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hubs, "STALLED_S", 1.0)
    hub, messages, letters = Hub(), 200, "x" * 100_000

    async def test() -> None:
        async def serve(request: web.Request) -> web.StreamResponse:
            return await hub.serve(request, "hello")

        app = web.Application()
        app.router.add_get("/stream", serve)
        runner = web.AppRunner(app, shutdown_timeout=0.1)
        await runner.setup()
        await web.TCPSite(runner, "127.0.0.1", 0).start()
        host, port = runner.addresses[0][:2]
        stalled = sockets.socket()
        stalled.setsockopt(sockets.SOL_SOCKET, sockets.SO_RCVBUF, 4096)
        stalled.connect((host, port))
        head = "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: "
        stalled.sendall(f"GET /stream HTTP/1.1\r\nHost: x\r\n{head}AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n".encode())
        async with aiohttp.ClientSession() as session, session.ws_connect(f"ws://{host}:{port}/stream") as socket:
            assert await socket.receive_str() == "hello"
            while len(hub) < 2:
                await asyncio.sleep(0.01)
            for number in range(messages):
                hub.send(f"{number} {letters}")
                heard = await socket.receive_str(timeout=20.0)
                assert heard.startswith(f"{number} ")
            assert hub.dropped > 0
            assert all(len(client._queue) <= QUEUE for client in hub._clients)
            async with asyncio.timeout(20.0):
                while len(hub) > 1:
                    await asyncio.sleep(0.01)
            hub.send("still here")
            assert await socket.receive_str(timeout=20.0) == "still here"
        stalled.close()
        await runner.cleanup()

    asyncio.run(test())


def test_more_browsers_than_allowed_are_told_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hubs, "MAX_CLIENTS", 1)

    async def test() -> None:
        async with (
            a_web(free_endpoint()) as url,
            aiohttp.ClientSession(url) as session,
            session.ws_connect("/stream") as socket,
        ):
            await next_message(socket, "hello")
            with pytest.raises(aiohttp.WSServerHandshakeError) as caught:
                await session.ws_connect("/stream")
            assert caught.value.status == 503

    asyncio.run(test())


def test_it_waits_for_a_daemon_and_finds_it_again_after_a_restart() -> None:
    async def test() -> None:
        endpoint = free_endpoint()
        async with (
            a_web(endpoint) as url,
            aiohttp.ClientSession(url) as session,
            session.ws_connect("/stream") as socket,
        ):
            assert not (await next_message(socket, "status"))["alive"]
            for _ in range(2):
                with a_robot(endpoint):
                    await next_message(socket, "pose")
                    while not (await next_message(socket, "status"))["alive"]:
                        pass
                while (await next_message(socket, "status"))["alive"]:
                    pass

    asyncio.run(test())


@pytest.mark.parametrize("allowed", [True, False])
def test_commands_are_offered_where_the_daemon_takes_them_and_its_answer_comes_back(allowed: bool) -> None:
    async def test() -> None:
        with a_robot(free_endpoint(), allowed) as robot:
            async with a_web(robot.endpoint) as url, aiohttp.ClientSession(url, headers=COMMAND) as session:
                async with session.ws_connect("/stream") as socket:
                    await next_message(socket, "pose")
                    while allowed and not (await next_message(socket, "status"))["commands"]:
                        pass
                    assert (await next_message(socket, "status"))["commands"] == allowed
                request = {"x_m": 1.5, "y_m": -2.0, "heading_rad": 0.5}
                async with session.post("/command/set_pose", data=json.dumps(request)) as answer:
                    assert answer.status == (200 if allowed else 409)
                    text = await answer.text()
                    assert json.loads(text) == request if allowed else "output.commands is false" in text
                async with session.post("/command/calibrate_bias") as answer:
                    assert answer.status == 409
                    assert ("the robot moves" in await answer.text()) == allowed
                for path, data, expected in (("config", "", 404), ("set_pose", "x" * 5000, 413)):
                    async with session.post(f"/command/{path}", data=data) as answer:
                        assert answer.status == expected
            assert robot.requests == ([("set_pose", request)] if allowed else [])

    asyncio.run(test())


def start(*arguments: str) -> "subprocess.Popen[str]":
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    line = [sys.executable, "-m", "drd", "web", "--connect", free_endpoint(), *arguments]
    return subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, env=environment, text=True)


@pytest.mark.parametrize(("listen", "told"), [("127.0.0.1:0", "http://127.0.0.1:"), ("0.0.0.0:0", "?token=")])
def test_the_command_prints_its_address_and_ends_with_0(listen: str, told: str) -> None:
    with start("--listen", listen) as process:
        assert process.stdout
        line = process.stdout.readline()
        process.send_signal(signal.SIGTERM)
        assert process.wait(30) == 0
    assert told in line
    assert ("token" in line) == ("token" in told)


def test_a_taken_address_is_said_and_a_wrong_one_is_bad_usage(capsys: pytest.CaptureFixture[str]) -> None:
    with sockets.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        address = f"127.0.0.1:{taken.getsockname()[1]}"
        assert main(["--listen", address, "--connect", free_endpoint()]) == 1
    assert address in capsys.readouterr().err
    for wrong in ("8080", "127.0.0.1:x", "127.0.0.1:70000", "::1:80"):
        with pytest.raises(SystemExit) as caught:
            main(["--listen", wrong])
        assert caught.value.code == 2


@pytest.mark.parametrize("header", ["Sec-WebSocket-Key", "Sec-WebSocket-Version"])
def test_a_handshake_that_is_not_ascii_is_refused(header: str) -> None:
    headers = {"Host": "localhost", "Upgrade": "websocket", "Connection": "Upgrade", "Sec-WebSocket-Version": "13"}
    lines = "".join(f"{k}: {v}\r\n" for k, v in (headers | {header: "\xe7"}).items())

    async def test() -> bytes:
        with a_robot(free_endpoint()) as robot:
            async with a_web(robot.endpoint) as url:
                reader, writer = await asyncio.open_connection("127.0.0.1", int(url.rstrip("/").rpartition(":")[2]))
                writer.write(f"GET /stream HTTP/1.1\r\n{lines}\r\n".encode("latin-1"))
                answer = await reader.readline()
                writer.close()
        return answer

    assert asyncio.run(test()).startswith(b"HTTP/1.1 400")
