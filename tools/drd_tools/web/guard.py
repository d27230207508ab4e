"""Access control, by the Host header (DNS rebinding), the origin (other sites' pages), and the token."""

import hmac
import ipaddress
import re
import secrets
import socket
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Final

from aiohttp import web

from drd.config.schema import ConfigError

Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]

# The page sets it on each command. Another site's page cannot, unless we answered its browser's preflight request.
HEADER: Final = "X-Drd"
# 128 random bits need no limit on guesses; a file's token must be long enough not to be guessed either.
_TOKEN_BYTES: Final = 16
_SHORTEST_TOKEN: Final = 16
_COOKIE_S: Final = 30 * 86_400
_TOKEN_FORM: Final = """\
<!DOCTYPE html><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark"><title>drd</title>
<form style="font:16px system-ui;max-width:24rem;margin:20vh auto;padding:0 1rem">
<p>drd web printed a token where it was started.</p>
<p><input name="token" type="password" placeholder="token" autofocus required> <button>Open</button></p></form>
"""


class Guard:
    """Access check, whose `middleware` handles each request first. `token`: None to admit everybody on this machine."""

    def __init__(self, token: str | None, names: tuple[str, ...], port: int):
        self._token = token
        own = socket.gethostname().lower()
        self._names = {"localhost", own, f"{own}.local", *(name.lower() for name in names)}
        self._cookie = f"drd_token_{port}"  # cookies are not told apart by port

    @web.middleware
    async def middleware(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        """Refuse, or let the handler answer."""
        try:
            is_new = self._check(request)
            response = await handler(request)
        except web.HTTPException as error:
            _harden(error)
            raise
        if not response.prepared:
            _harden(response)
            if is_new and self._token is not None:
                response.set_cookie(self._cookie, self._token, httponly=True, samesite="Strict", max_age=_COOKIE_S)
        return response

    def _check(self, request: web.Request) -> bool:
        """Whether to store the token in a cookie. Raises HTTPException if the request is refused."""
        host = request.headers.get("Host", "")
        if not self._is_ours(host):
            raise web.HTTPMisdirectedRequest(text=f"{host[:100]!a} is no name of this server: start it with --name\n")
        origin = request.headers.get("Origin")
        if origin is not None and origin.partition("://")[2].lower() != host.lower():
            raise web.HTTPForbidden(text="this is another site's page\n")
        if request.method != "GET" and HEADER not in request.headers:
            raise web.HTTPForbidden(text=f"the header {HEADER} is missing\n")
        return self._token is not None and self._check_token(request)

    def _is_ours(self, host: str) -> bool:
        """Whether it is an address, or a name of this machine. A rebound name is the attacker's own, so neither."""
        found = re.fullmatch(r"\[([0-9a-f:.]+)\](:\d+)?|([^:\[\]]+)(:\d+)?", host.lower())
        if found is None:
            return False
        name = found[1] or found[3]
        try:
            ipaddress.ip_address(name)
        except ValueError:
            return name.removesuffix(".") in self._names
        return True

    def _check_token(self, request: web.Request) -> bool:
        """True if the token came in the address, so that the cookie stores it. Raises HTTPUnauthorized without one."""
        given = request.query.get("token", "")
        if self._is_token(given):
            return True
        kind, _, bearer = request.headers.get("Authorization", "").partition(" ")
        if (kind == "Bearer" and self._is_token(bearer)) or self._is_token(request.cookies.get(self._cookie, "")):
            return False
        if request.path == "/":
            policy = {
                "Content-Security-Policy": "default-src 'none'; style-src 'unsafe-inline'; frame-ancestors 'none'"
            }
            raise web.HTTPUnauthorized(text=_TOKEN_FORM, content_type="text/html", headers=policy)
        raise web.HTTPUnauthorized(text="the token is missing: 'Authorization: Bearer TOKEN', or open / with ?token=\n")

    def _is_token(self, given: str) -> bool:
        assert self._token is not None
        return hmac.compare_digest(given.encode("utf-8", "replace"), self._token.encode())


def _harden(response: web.StreamResponse) -> None:
    """Forbid foreign content, framing of the buttons, caching, and referrers that contain the token."""
    response.headers.setdefault("Content-Security-Policy", "default-src 'none'; frame-ancestors 'none'")
    response.headers["X-Content-Type-Options"] = "nosniff"
    response.headers["Referrer-Policy"] = "no-referrer"
    response.headers["Cache-Control"] = "no-store"


def is_loopback(host: str) -> bool:
    """Whether only this machine can reach this address."""
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return host == "localhost"


def make_token(file: Path | None, host: str) -> str | None:
    """The file's token, a new one if others can reach `host`, or None. Raises ConfigError for a file without one."""
    if file is None:
        return None if is_loopback(host) else secrets.token_urlsafe(_TOKEN_BYTES)
    expected = f"a file whose only line is a token of {_SHORTEST_TOKEN} characters or more: letters, digits, - and _"
    try:
        token = file.read_text("ascii").strip()
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError("--token-file", "", expected, f"{file}: {error}") from error
    if len(token) < _SHORTEST_TOKEN or not re.fullmatch(r"[\w-]+", token):
        raise ConfigError("--token-file", "", expected, f"{file}: another text")
    return token
