"""Many Zenoh sessions in one process, which hear poses or, stopped, no longer read: a daemon's crowd of clients."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final

import zenoh

from bench.listener import ENVIRONMENT
from bench.report import Refused
from drd.output.session import isolated_config

# How long a client says that it may be silent: with Zenoh's own 10 s the daemon is soon rid of those that stalled.
LEASE_MS: Final = 3_600_000
# So that some poses fill what lies between daemon and client.
BUFFER_BYTES: Final = 4096


class Crowd:
    """The running process."""

    def __init__(self, process: "subprocess.Popen[str]"):
        self._process = process

    def stall(self) -> None:
        """Read no more, and keep the connections."""
        self._process.send_signal(signal.SIGSTOP)

    def heard(self) -> list[int]:
        """End it; how many poses each session heard. Raises Refused."""
        output, _ = self._process.communicate("", timeout=30)
        if self._process.returncode != 0:
            raise Refused("a process of clients failed")
        found: list[int] = json.loads(output)
        return found


@contextmanager
def crowd(endpoint: str, key: str, count: int) -> Iterator[Crowd]:
    """So many sessions that subscribe to `key`. Raises Refused where they do not get in."""
    command, pipe = [sys.executable, "-m", "bench.crowd", endpoint, key, str(count)], subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True, env=ENVIRONMENT) as process:
        try:
            assert process.stdout is not None
            if process.stdout.readline() != "ready\n":
                raise Refused("a process of clients did not start")
            yield Crowd(process)
        finally:
            process.kill()


def _main(endpoint: str, key: str, count: str) -> None:
    heard = [0] * int(count)
    sessions = []
    for i in range(len(heard)):
        config = isolated_config("client", (), (f"{endpoint}#so_rcvbuf={BUFFER_BYTES}",))
        config.insert_json5("transport/link/tx/lease", str(LEASE_MS))
        sessions.append(session := zenoh.open(config))

        def note(_: Any, i: int = i) -> None:
            heard[i] += 1

        session.declare_subscriber(key, zenoh.handlers.Callback(note, indirect=False))
    time.sleep(0.3)
    print("ready", flush=True)
    sys.stdin.read()
    print(json.dumps(heard), flush=True)
    os._exit(0)  # closing takes a while for each


if __name__ == "__main__":
    _main(*sys.argv[1:])
