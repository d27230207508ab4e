"""Fixtures: the running daemon and its emulated hardware."""

import asyncio
import signal
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from harness import Robot
from hypothesis import settings

from drd.service.daemon import Daemon

# A busy machine may take half a second instead of a millisecond: a slow test is not a failed one.
settings.register_profile("drd", deadline=None)
settings.load_profile("drd")

# A shell that runs the tests in the background may ignore SIGINT, and processes started by them would inherit that.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture
def robot(tmp_path: Path) -> Iterator[Robot]:
    made = Robot(tmp_path)
    try:
        yield made
    finally:
        made.close()


@pytest.fixture
def running(robot: Robot) -> Iterator[Robot]:
    """A driving robot whose daemon runs in this process, in a thread with its own event loop."""
    loop = asyncio.new_event_loop()
    stop = asyncio.Event()
    closed: list[bool] = []

    def work() -> None:
        asyncio.set_event_loop(loop)
        closed.append(loop.run_until_complete(Daemon(robot.loaded, robot.file.parent).run(stop)))
        loop.close()

    robot.emulator.plug_in()
    thread = threading.Thread(target=work, name="daemon under test")
    thread.start()
    try:
        robot.drive()
        yield robot
    finally:
        loop.call_soon_threadsafe(stop.set)
        thread.join(15.0)
        assert closed == [True]
