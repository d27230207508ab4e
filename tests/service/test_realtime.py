import ctypes
import errno
import gc
import os
import resource
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest

from drd.config.keys import Realtime
from drd.service import realtime

NOTHING = Realtime(freeze_gc=False)


@pytest.fixture
def thawed() -> Iterator[None]:
    gc.unfreeze()
    yield
    gc.unfreeze()


def no_library(*_: Any, **__: Any) -> Any:
    raise AssertionError("not to be called")


def test_nothing_asked_is_nothing_done(monkeypatch: pytest.MonkeyPatch) -> None:
    for module, name in ((gc, "freeze"), (os, "sched_setscheduler"), (ctypes, "CDLL")):
        monkeypatch.setattr(module, name, no_library)
    assert realtime.apply(NOTHING) == []


@pytest.mark.usefixtures("thawed")
def test_start_up_objects_leave_the_garbage_collector() -> None:
    assert gc.get_freeze_count() == 0
    assert realtime.apply(Realtime(freeze_gc=True)) == []
    assert gc.get_freeze_count() > 1000


def test_a_priority_that_is_refused_names_key_reason_and_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any) -> None:
        raise PermissionError(errno.EPERM, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    [message] = realtime.apply(Realtime(freeze_gc=False, fifo_priority=30))
    assert message.startswith("realtime.fifo_priority:")
    assert "Operation not permitted" in message
    assert "LimitRTPRIO=30" in message
    assert "RestrictRealtime=no" in message


def test_a_priority_is_for_this_thread_and_not_for_its_children(monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[tuple[int, int, int]] = []

    def note(pid: int, policy: int, parameters: os.sched_param) -> None:
        calls.append((pid, policy, parameters.sched_priority))

    monkeypatch.setattr(os, "sched_setscheduler", note)
    assert realtime.apply(Realtime(freeze_gc=False, fifo_priority=30)) == []
    assert calls == [(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, 30)]


def test_memory_is_not_locked_under_a_limit_that_would_fail_later(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(resource, "getrlimit", lambda _: (8 * 2**20, resource.RLIM_INFINITY))
    monkeypatch.setattr(ctypes, "CDLL", no_library)
    [message] = realtime.apply(Realtime(freeze_gc=False, lock_memory=True))
    assert message.startswith("realtime.lock_memory: only 8192 KiB")
    assert "LimitMEMLOCK=infinity" in message


@pytest.mark.parametrize(("result", "refused"), [(0, False), (-1, True)])
def test_all_memory_present_and_future_is_locked_or_the_refusal_told(
    monkeypatch: pytest.MonkeyPatch, result: int, refused: bool
) -> None:
    flags: list[int] = []

    def mlockall(value: int) -> int:
        flags.append(value)
        ctypes.set_errno(errno.EPERM)
        return result

    monkeypatch.setattr(resource, "getrlimit", lambda _: (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    monkeypatch.setattr(ctypes, "CDLL", lambda *_, **__: SimpleNamespace(mlockall=mlockall))
    messages = realtime.apply(Realtime(freeze_gc=False, lock_memory=True))
    assert flags == [3]
    assert [os.strerror(errno.EPERM) in m for m in messages] == [True] * refused


def test_a_system_without_mlockall_is_a_message(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(resource, "getrlimit", lambda _: (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    monkeypatch.setattr(ctypes, "CDLL", lambda *_, **__: SimpleNamespace())
    [message] = realtime.apply(Realtime(freeze_gc=False, lock_memory=True))
    assert message.startswith("realtime.lock_memory: mlockall is missing")
