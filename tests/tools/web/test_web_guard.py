"""Who may ask: other sites' pages, rebound names and strangers may not."""

import asyncio
import contextlib
from collections.abc import AsyncIterator
from pathlib import Path

import aiohttp
import pytest
from links import free_endpoint
from web_robot import COMMAND, a_robot, a_web, next_message

from drd.config.schema import ConfigError
from drd_tools.web.guard import is_loopback, make_token

TOKEN = "correct-horse-battery"


@contextlib.asynccontextmanager
async def a_session(token: str | None = None) -> AsyncIterator[aiohttp.ClientSession]:
    """A browser with cookies, and a server without a daemon."""
    jar = aiohttp.CookieJar(unsafe=True)  # of addresses too
    async with a_web(free_endpoint(), token) as url, aiohttp.ClientSession(url, cookie_jar=jar) as session:
        yield session


async def status(session: aiohttp.ClientSession, method: str, path: str, **headers: str) -> int:
    async with session.request(
        method, path, headers={name.replace("_", "-"): v for name, v in headers.items()}
    ) as answer:
        return answer.status


@pytest.mark.parametrize(
    ("host", "expected"),
    [
        ("127.0.0.1:8080", 200),
        ("[::1]:8080", 200),
        ("localhost:9000", 200),
        ("LOCALHOST", 200),
        ("192.168.1.7", 200),
        ("attacker.example:8080", 421),
        ("localhost.attacker.example", 421),
        ("127.0.0.1.attacker.example", 421),
        ("a b", 421),
        ("[::1", 421),
    ],
)
def test_a_rebound_name_is_refused(host: str, expected: int) -> None:
    async def test() -> None:
        async with a_session() as session:
            for path in ("/", "/metrics", "/history"):
                assert await status(session, "GET", path, Host=host) == expected

    asyncio.run(test())


def test_another_sites_page_reads_nothing_and_commands_nothing() -> None:
    async def test() -> None:
        with a_robot(free_endpoint()) as robot:
            async with a_web(robot.endpoint) as url, aiohttp.ClientSession(url) as session:
                async with session.ws_connect("/stream") as socket:
                    await next_message(socket, "pose")
                foreign = {"Origin": "http://attacker.example"}
                assert await status(session, "GET", "/history", **foreign) == 403
                assert await status(session, "POST", "/command/reset", **foreign, **COMMAND) == 403
                assert await status(session, "POST", "/command/reset", Origin="null", **COMMAND) == 403
                assert await status(session, "POST", "/command/reset") == 403  # a form needs no preflight request
                assert await status(session, "OPTIONS", "/command/reset", **foreign) == 403
                with pytest.raises(aiohttp.WSServerHandshakeError) as caught:
                    await session.ws_connect("/stream", headers=foreign)
                assert caught.value.status == 403
                assert robot.requests == []
                assert await status(session, "POST", "/command/reset", Origin=url, **COMMAND) == 200
                assert robot.requests == [("reset", {})]

    asyncio.run(test())


def test_without_the_token_nothing_is_told() -> None:
    async def test() -> None:
        async with a_session(TOKEN) as session:
            for path in ("/", "/history", "/metrics", "/page/page.js", "/stream", "/?token=wrong", "/?token=%ff"):
                assert await status(session, "GET", path) == 401
            assert await status(session, "GET", "/metrics", Authorization="Bearer wrong") == 401
            assert await status(session, "POST", "/command/reset", **COMMAND) == 401

    asyncio.run(test())


def test_the_token_in_the_address_becomes_a_cookie_and_a_bearer_needs_none() -> None:
    async def test() -> None:
        async with a_session(TOKEN) as session:
            assert await status(session, "GET", "/metrics", Authorization=f"Bearer {TOKEN}") == 200
            assert await status(session, "GET", "/metrics") == 401
            async with session.get(f"/?token={TOKEN}") as answer:
                cookie = answer.headers["Set-Cookie"]
            assert "HttpOnly" in cookie
            assert "SameSite=Strict" in cookie
            for path in ("/", "/history", "/metrics", "/page/page.js"):
                assert await status(session, "GET", path) == 200
            assert await status(session, "POST", "/command/reset") == 403, "the cookie alone must not command"

    asyncio.run(test())


def test_every_answer_is_hardened() -> None:
    async def test() -> None:
        async with a_session() as session:
            for path in ("/", "/page/page.js", "/metrics", "/nothing"):
                async with session.get(path) as answer:
                    assert "frame-ancestors 'none'" in answer.headers["Content-Security-Policy"]
                    assert "unsafe" not in answer.headers["Content-Security-Policy"]
                    assert answer.headers["X-Content-Type-Options"] == "nosniff"
                    assert answer.headers["Cache-Control"] == "no-store"
                    assert answer.headers["Referrer-Policy"] == "no-referrer"

    asyncio.run(test())


def test_only_loopback_needs_no_token(tmp_path: Path) -> None:
    for host in ("127.0.0.1", "127.8.8.8", "[::1]", "localhost"):
        assert is_loopback(host)
        assert make_token(None, host) is None
    for host in ("0.0.0.0", "[::]", "192.168.1.2", "robot.local"):
        first, second = make_token(None, host), make_token(None, host)
        assert first != second
        assert len(first or "") >= 20
    file = tmp_path / "token"
    file.write_text(TOKEN + "\n")
    assert make_token(file, "127.0.0.1") == make_token(file, "0.0.0.0") == TOKEN


@pytest.mark.parametrize("text", ["", "short", "sixteen letters and blanks", "zwölfundzwanzigbuchstaben", None])
def test_a_poor_token_is_refused(text: str | None, tmp_path: Path) -> None:
    file = tmp_path / "token"
    if text is not None:
        file.write_text(text)
    with pytest.raises(ConfigError, match="16 characters"):
        make_token(file, "127.0.0.1")
