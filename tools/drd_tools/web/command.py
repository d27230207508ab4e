"""`drd web`: serve the page and the metrics until Ctrl-C or SIGTERM."""

import argparse
import asyncio
import logging
import signal
import socket
import sys
from pathlib import Path
from typing import Final

import zenoh

from drd.commands import command
from drd.commands.watch import daemon_arguments, zenoh_config
from drd.config.schema import ConfigError
from drd.output.session import tidy
from drd_tools import options
from drd_tools.web.daemon import DaemonLink
from drd_tools.web.guard import Guard, make_token
from drd_tools.web.server import Server, serving

DESCRIPTION: Final = """\
Show a running drd in the browser: the path on a map with the 99 % bound, the last hour to scrub through, validity with
its reasons, rates, latency, learned parameters and counters; and buttons, if the daemon accepts commands
(output.commands). /metrics has the same for Prometheus. This is a separate process: the daemon is not affected.

Only this machine can reach it unless --listen says otherwise; then a token is required. The connection is not
encrypted: on a shared network, use ssh (`ssh -L 8080:127.0.0.1:8080 ROBOT`) or a proxy with TLS.
"""
EPILOG: Final = """\
examples:
  drd web                                                and open http://127.0.0.1:8080
  drd web --connect tcp/192.168.1.10:7447
  drd web --listen 0.0.0.0:8080                          prints the address with its token
  drd web --listen 0.0.0.0:8080 --token-file token --name robot7.example

Exit code: 0 ended by Ctrl-C or SIGTERM, 1 the address is not available, 2 bad usage.
"""
# All addresses of this machine: none that a browser elsewhere could open.
_EVERYWHERE: Final = ("0.0.0.0", "[::]")


def main(argv: list[str]) -> int:
    """Run the command. Returns exit code 0, or 1 if the address is taken. Raises ConfigError."""
    arguments = _arguments(argv)
    host, port = arguments.listen
    token = make_token(arguments.token_file, host)
    try:
        link = DaemonLink(zenoh_config(arguments), arguments.prefix)
    except zenoh.ZError as error:
        raise ConfigError("--connect", "", "a Zenoh endpoint, or a good --zenoh-config", tidy(error)) from error
    # Anybody who can connect could fill aiohttp's log.
    logging.getLogger("aiohttp").setLevel(logging.CRITICAL)
    try:
        asyncio.run(_serve(link, host, port, token, tuple(arguments.name)))
    except OSError as error:
        print(f"drd web: cannot listen on {host}:{port}: {error.strerror or error}", file=sys.stderr)
        return 1
    return 0


async def _serve(link: DaemonLink, host: str, port: int, token: str | None, names: tuple[str, ...]) -> None:
    stop = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, stop.set)
    server = Server(link, Guard(token, names, port))
    async with serving(server, host.strip("[]"), port) as chosen:
        name = socket.gethostname() if host in _EVERYWHERE else host
        print(f"http://{name}:{chosen}/" + (f"?token={token}" if token else ""), flush=True)
        stopping = asyncio.create_task(stop.wait())
        await asyncio.wait((stopping, server.work), return_when=asyncio.FIRST_COMPLETED)
        if server.work.done():
            server.work.result()  # a bug of ours: let it be seen


def _arguments(argv: list[str]) -> argparse.Namespace:
    parser = command("drd web", DESCRIPTION, EPILOG, [daemon_arguments(), options.listen(8080)])
    add = parser.add_argument
    text = "file with the token, asked for on this machine too (default: a new one, where others reach --listen)"
    add("--token-file", type=Path, metavar="FILE", help=text)
    text = "another name by which browsers reach it, beside addresses and this machine's name; may be repeated"
    add("--name", action="append", default=[], metavar="HOST", help=text)
    return parser.parse_args(argv)
