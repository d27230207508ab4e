import os
import socket
import time
from pathlib import Path

import pytest

from drd.service.systemd import Notifier


def receiver(address: str) -> socket.socket:
    s = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    s.bind(address)
    s.settimeout(5.0)
    return s


@pytest.mark.parametrize("abstract", [False, True])
def test_systemd_hears_ready_status_watchdog_and_stopping(tmp_path: Path, abstract: bool) -> None:
    name = f"@drd-test-{os.getpid()}" if abstract else str(tmp_path / "notify")
    with receiver(name.replace("@", "\0") if abstract else name) as s:
        notifier = Notifier({"NOTIFY_SOCKET": name})
        notifier.ready("waiting for standstill")
        notifier.status("valid")
        notifier.watchdog()
        notifier.stopping()
        said = [s.recv(4096) for _ in range(4)]
    assert said == [b"READY=1\nSTATUS=waiting for standstill", b"STATUS=valid", b"WATCHDOG=1", b"STOPPING=1"]
    assert notifier.counters == {"notify_errors": 0}


def test_a_reload_carries_the_time_that_systemd_asks_for(tmp_path: Path) -> None:
    with receiver(str(tmp_path / "notify")) as s:
        before_us = time.clock_gettime_ns(time.CLOCK_MONOTONIC) // 1000
        Notifier({"NOTIFY_SOCKET": str(tmp_path / "notify")}).reloading()
        first, second = s.recv(4096).decode().split("\n")
    assert first == "RELOADING=1"
    name, microseconds = second.split("=")
    assert name == "MONOTONIC_USEC"
    assert before_us <= int(microseconds) <= time.clock_gettime_ns(time.CLOCK_MONOTONIC) // 1000


def test_a_status_cannot_smuggle_in_another_assignment(tmp_path: Path) -> None:
    with receiver(str(tmp_path / "notify")) as s:
        Notifier({"NOTIFY_SOCKET": str(tmp_path / "notify")}).status("a\nMAINPID=1\r\nb")
        assert s.recv(4096) == b"STATUS=a MAINPID=1 b"


def test_without_systemd_nothing_is_sent_or_counted() -> None:
    notifier = Notifier({})
    notifier.ready("x")
    notifier.watchdog()
    assert notifier.watchdog_period_s is None
    assert notifier.counters == {"notify_errors": 0}


@pytest.mark.parametrize("address", ["/nonexistent/notify", "@drd-nobody-listens", "/tmp/\0", "x" * 300])
def test_a_socket_that_cannot_be_reached_is_counted_and_not_raised(address: str) -> None:
    notifier = Notifier({"NOTIFY_SOCKET": address})
    notifier.ready("x")
    notifier.watchdog()
    assert notifier.counters == {"notify_errors": 2}


def test_a_full_socket_does_not_hold_the_daemon_up(tmp_path: Path) -> None:
    with receiver(str(tmp_path / "notify")):
        notifier = Notifier({"NOTIFY_SOCKET": str(tmp_path / "notify")})
        for _ in range(10_000):
            notifier.watchdog()
            if notifier.counters["notify_errors"]:
                break
        assert notifier.counters["notify_errors"] == 1


@pytest.mark.parametrize(
    ("environment", "period_s"),
    [
        ({"WATCHDOG_USEC": "5000000"}, 2.5),
        ({"WATCHDOG_USEC": "5000000", "WATCHDOG_PID": str(os.getpid())}, 2.5),
        ({"WATCHDOG_USEC": "5000000", "WATCHDOG_PID": str(os.getpid() + 1)}, None),
        ({"WATCHDOG_PID": str(os.getpid())}, None),
        ({"WATCHDOG_USEC": "soon"}, None),
        ({"WATCHDOG_USEC": "0"}, None),
        ({"WATCHDOG_USEC": "5000000", "WATCHDOG_PID": "me"}, None),
    ],
)
def test_the_watchdog_is_fed_twice_in_its_time_if_it_watches_us(
    environment: dict[str, str], period_s: float | None
) -> None:
    assert Notifier(environment).watchdog_period_s == period_s
