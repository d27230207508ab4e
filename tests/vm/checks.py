"""The list of checks, and what several of them need.

Each check is a test on the host (test_vm.py). One that breaks something returns when that was noticed and when all was
well again, in s; the limits beside its name are generous, because the machine has one slow processor.
"""

import contextlib
import time
from collections.abc import Callable, Iterator
from typing import NamedTuple

from vm.robot import Robot, steps, troubles


class Seen(NamedTuple):
    """What a check saw, for people, and its times."""

    evidence: str
    noticed_s: float | None = None
    recovered_s: float | None = None


class Check(NamedTuple):
    """Something to try on the robot of that name, and how long noticing and recovering may take (s)."""

    robot: str
    work: Callable[[Robot], Seen]
    notice_s: float | None
    recover_s: float | None


CHECKS: dict[str, Check] = {}


def check(
    robot: str, *, notice_s: float | None = None, recover_s: float | None = None
) -> Callable[[Callable[[Robot], Seen]], Callable[[Robot], Seen]]:
    """Put the function on the list; its name is the sentence."""

    def register(work: Callable[[Robot], Seen]) -> Callable[[Robot], Seen]:
        CHECKS[work.__name__] = Check(robot, work, notice_s, recover_s)
        return work

    return register


@contextlib.contextmanager
def undisturbed(robot: Robot) -> Iterator[None]:
    """Poses go on meanwhile, from the same process, without a jump, and nothing is wrong with them."""
    began_s, pid = time.monotonic(), robot.pid()
    yield
    poses = robot.since(began_s)
    gap_s, excess_m = steps(poses)
    assert poses, "no poses"
    assert not troubles(poses), troubles(poses)
    assert gap_s < 2.5, f"no pose for {gap_s:.2f} s"
    assert excess_m == 0, f"a step of {excess_m:.2f} m beyond the top speed"
    assert robot.pid() == pid, "the daemon was restarted"


def noticed(robot: Robot, began_s: float, words: str) -> tuple[str, float]:
    """The journal's first line since then with these words, and how long that was after it."""
    for line_s, line in robot.journal():
        if line_s >= began_s and words in line:
            return line, line_s - began_s
    raise AssertionError(f"{words!r} is not in the journal")
