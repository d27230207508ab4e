"""`drd run CONFIG`: the daemon."""

import asyncio
import contextlib
import logging
import os
import signal
import sys
import threading
from pathlib import Path
from typing import Final, NoReturn

from drd.commands import command, config_argument, placed
from drd.config.file import load_config
from drd.config.keys import Config
from drd.config.schema import Loaded
from drd.service.daemon import CLOSE_DEADLINE_S, Daemon

log = logging.getLogger("drd")

EXIT_DEADLINE_S: Final = 8.0

DESCRIPTION: Final = """\
Run the daemon: read the gyro and the wheel encoders named in CONFIG, estimate the pose, and publish it over Zenoh. If a
device is missing, unplugged or silent, the daemon keeps running, reports it with the pose, and reopens the device.

It runs in the foreground and logs to standard error; under systemd (drd install-service) it also reports readiness and
status and feeds the watchdog. SIGINT (Ctrl-C) and SIGTERM end it; SIGHUP (systemctl reload) makes it reload CONFIG; if
the new CONFIG is invalid, the old one stays in force.
"""
EPILOG: Final = """\
examples:
  drd check mybot.yaml && drd run mybot.yaml
  drd watch                                    in another terminal: the live pose
  drd run /etc/drd/mybot.yaml 2> drd.log

Every key of CONFIG is explained in the example configurations and by `drd check --explain CONFIG`.
Exit code: 0 ended by a signal, 1 failed, 2 CONFIG or a file named in it cannot be used.
"""


def main(argv: list[str]) -> NoReturn:
    """Run until SIGINT or SIGTERM, and end the process. Raises ConfigError before the start."""
    arguments = command("drd run", DESCRIPTION, EPILOG, [config_argument()]).parse_args(argv)
    loaded = load_config(arguments.config)
    with placed(loaded):
        run(loaded, arguments.config.parent)


def run(loaded: Loaded[Config], base: Path) -> NoReturn:
    """Run the daemon until SIGINT or SIGTERM, and end the process. Raises ConfigError before the start.

    SIGHUP reloads the configuration, except when it comes from a terminal that closes.
    """
    daemon = Daemon(loaded, base)

    async def main() -> bool:
        stop, loop = asyncio.Event(), asyncio.get_running_loop()

        def end() -> None:
            # Nothing that hangs after this (a driver, Zenoh) may keep the process alive.
            fuse = threading.Timer(EXIT_DEADLINE_S, os._exit, (1,))
            fuse.daemon = True
            fuse.start()
            stop.set()

        for number in (signal.SIGINT, signal.SIGTERM):
            loop.add_signal_handler(number, end)
        if not os.isatty(0):  # on a terminal a hang-up means that it was closed
            loop.add_signal_handler(signal.SIGHUP, daemon.ask_for_reload)
        return await daemon.run(stop)

    if not asyncio.run(main()):
        log.warning("zenoh did not close within %g s: a neighbour does not read; left it", CLOSE_DEADLINE_S)
    # All our data are written. A neighbour that does not read must not turn an orderly end into a failure; nor must the
    # interpreter's exit, which kills threads inside Zenoh's functions, whereupon Zenoh aborts the process.
    with contextlib.suppress(OSError, ValueError):
        sys.stderr.flush()
    os._exit(0)
