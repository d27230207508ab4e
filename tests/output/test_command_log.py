import logging
import re
from types import SimpleNamespace
from typing import Any

import pytest

from drd.output.command_log import MAX_NEIGHBOURS, MAX_SHOWN, REFUSALS_AT_ONCE, REFUSALS_PER_S, CommandLog, neighbours


class Clock:
    now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


def payload(data: bytes) -> Any:
    return SimpleNamespace(to_bytes=lambda: data)


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def command_log(clock: Clock, caplog: pytest.LogCaptureFixture) -> CommandLog:
    caplog.set_level(logging.INFO)
    return CommandLog(lambda: ["'ann' at tls/1", "'unknown' at tcp/2"], lambda work: work(), clock)


def test_a_line_holds_key_outcome_payload_and_neighbours(
    command_log: CommandLog, caplog: pytest.LogCaptureFixture
) -> None:
    command_log.accepted("a/set_pose", payload(b'{"x_m": 1}'))
    command_log.refused("a/reset", None, "not now")
    assert [r.getMessage() for r in caplog.records] == [
        "zenoh: command=a/set_pose outcome=accepted payload='{\"x_m\": 1}' "
        "neighbours=['ann' at tls/1, 'unknown' at tcp/2]",
        "zenoh: command=a/reset outcome=refused reason='not now' payload='' "
        "neighbours=['ann' at tls/1, 'unknown' at tcp/2]",
    ]
    assert {r.levelno for r in caplog.records} == {logging.WARNING}


def test_whatever_a_payload_holds_makes_one_short_printable_line(
    command_log: CommandLog, caplog: pytest.LogCaptureFixture
) -> None:
    command_log.accepted("k", payload(bytes(range(256)) * 16))
    command_log.refused("k", payload("ü\x1b[2J\r\nlevel=ERROR".encode()), "a\nb ü")
    for record in caplog.records:
        line = record.getMessage()
        assert line.isascii()
        assert line.isprintable()
        assert len(line) < 4 * MAX_SHOWN + 200


def test_a_flood_of_refusals_is_counted_and_not_written(
    command_log: CommandLog, clock: Clock, caplog: pytest.LogCaptureFixture
) -> None:
    for _ in range(1000):
        command_log.refused("k", None, "no")
    assert len(caplog.records) == REFUSALS_AT_ONCE
    clock.now_s += 1.0 / REFUSALS_PER_S
    command_log.refused("k", None, "no")
    command_log.refused("k", None, "no")
    assert len(caplog.records) == REFUSALS_AT_ONCE + 1
    found = re.search(r"unwritten_before=(\d+)", caplog.records[-1].getMessage())
    assert found
    assert int(found[1]) == 1000 - REFUSALS_AT_ONCE
    clock.now_s += 1e6
    for _ in range(1000):
        command_log.refused("k", None, "no")
    assert len(caplog.records) == 2 * REFUSALS_AT_ONCE + 1


def test_every_accepted_command_is_written(command_log: CommandLog, caplog: pytest.LogCaptureFixture) -> None:
    for _ in range(100):
        command_log.accepted("k", None)
    assert len(caplog.records) == 100


def test_many_neighbours_are_counted() -> None:
    lines: list[str] = []
    log = logging.getLogger("drd.output.command_log")
    handler = logging.Handler()
    handler.emit = lambda record: lines.append(record.getMessage())  # type: ignore[method-assign]
    log.addHandler(handler)
    try:
        CommandLog(lambda: [f"n{i}" for i in range(MAX_NEIGHBOURS + 3)], lambda work: work()).accepted("k", None)
    finally:
        log.removeHandler(handler)
    assert lines[0].endswith(f"n{MAX_NEIGHBOURS - 1}, 3 more]")


def test_a_neighbour_is_the_certificates_name_and_the_address() -> None:
    links = [
        SimpleNamespace(auth_identifier="ann\n", dst="tls/127.0.0.1:5"),
        SimpleNamespace(auth_identifier=None, dst="tcp/127.0.0.1:6"),
    ]
    session = SimpleNamespace(info=SimpleNamespace(links=lambda: links))
    assert neighbours(session) == ["'ann\\n' at tls/127.0.0.1:5", "'unknown' at tcp/127.0.0.1:6"]
