"""A subscriber in a process of its own, so that what is published really travels: notes when samples arrive."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Final

import zenoh

from bench.report import Refused
from drd.output.session import isolated_config

# A process of its own finds this package as this one does.
ENVIRONMENT: Final = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
# Until the publishers know of the subscription.
SUBSCRIPTION_S: Final = 0.3


class Listener:
    """The running process, seen from the benchmark."""

    def __init__(self, process: "subprocess.Popen[str]"):
        self._process = process

    def arrivals_ns(self) -> dict[str, list[int]]:
        """End it; CLOCK_MONOTONIC of each sample's arrival, by key."""
        output, _ = self._process.communicate(timeout=20)
        found: dict[str, list[int]] = json.loads(output)
        return found


@contextmanager
def listening(endpoints: Sequence[str], keys: Sequence[str]) -> Iterator[Listener]:
    """Subscribe to `keys` at these Zenoh end points, which must be open already. Raises Refused if that fails."""
    command = [sys.executable, "-m", "bench.listener", ",".join(endpoints), *keys]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True, env=ENVIRONMENT) as process:
        try:
            assert process.stdout is not None
            if process.stdout.readline() != "ready\n":
                raise Refused("the subscriber's process did not start")
            time.sleep(SUBSCRIPTION_S)
            yield Listener(process)
        finally:
            process.kill()


def _main(endpoints: str, *keys: str) -> None:
    """Subscribe, wait until standard input ends, print the arrivals as JSON."""
    arrivals: dict[str, list[int]] = {key: [] for key in keys}

    def note(sample: Any) -> None:
        arrivals[str(sample.key_expr)].append(time.monotonic_ns())

    with zenoh.open(isolated_config("peer", (), tuple(endpoints.split(",")))) as session:
        for key in keys:
            session.declare_subscriber(key, zenoh.handlers.Callback(note, indirect=False))
        print("ready", flush=True)
        sys.stdin.read()
    print(json.dumps(arrivals))


if __name__ == "__main__":
    _main(*sys.argv[1:])
