import asyncio
import logging
import os
import select
import time
import tty
from collections.abc import Callable
from pathlib import Path
from typing import Any

import can
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from drd.config.keys import Encoders
from drd.ports import can_port
from drd.ports.can_port import CanPort
from drd.ports.slcan import SlcanBus, open_bus


def slcan_line(number: int) -> bytes:
    return f"t1814{number.to_bytes(4, 'little').hex()}\r".encode()


def opener() -> tuple[list[SlcanBus], Callable[..., can.BusABC]]:
    """A can.Bus that remembers what it opened."""
    buses: list[SlcanBus] = []

    def opened(**arguments: Any) -> can.BusABC:
        bus = open_bus(**arguments)
        assert isinstance(bus, SlcanBus)
        buses.append(bus)
        return bus

    return buses, opened


def read_all(line: Any, enough: bytes) -> bytes:
    """What the adapter was sent, up to and with `enough`."""
    data, give_up = b"", time.monotonic() + 20
    while enough not in data and time.monotonic() < give_up:
        if select.select([line.master], [], [], 0.01)[0]:
            data += os.read(line.master, 4096)
    return data


def test_frames_arrive_in_whatever_pieces_the_adapter_sends_them(
    make_pty: Any, run_port: Any, eventually: Any, can_record: Any
) -> None:
    async def scenario() -> None:
        line = make_pty()
        port = can_record.port(interface="slcan", channel=line.path)
        async with run_port(port):
            await eventually(lambda: can_record.states == [None])
            before_ns = time.monotonic_ns()
            stream = b"".join(slcan_line(number) for number in range(100)) + b"T18FF1234201FF\r"
            for start in range(0, len(stream), 7):
                await line.stream(stream[start : start + 7])
            await eventually(lambda: len(can_record.frames) == 101)
        assert can_record.numbers[:100] == list(range(100))
        assert can_record.frames[100][1:] == (0x18FF1234, True, b"\x01\xff")
        # Frames that a slow host reads together are dated back, one nominal period each.
        earliest_ns = before_ns - 100 * 1_000_000_000 // 20
        times = [frame.t_ns for frame in can_record.frames]
        assert earliest_ns <= times[0]
        assert times[:100] == sorted(times[:100])
        assert max(times) <= time.monotonic_ns()
        assert port.counters["bad_frames"] == 0

    asyncio.run(scenario())


def test_a_burst_that_waits_in_the_line_is_read_without_further_bytes(
    make_pty: Any, run_port: Any, eventually: Any, can_record: Any
) -> None:
    async def scenario() -> None:
        line = make_pty()
        # Unwanted frames and acknowledgements end a python-can recv(0) early.
        port = can_record.port([(0x181, False)], interface="slcan", channel=line.path)
        async with run_port(port):
            await eventually(lambda: can_record.states == [None])
            line.write(b"".join(b"\r" + slcan_line(number) + b"z\rt2000\r\a" for number in range(100)))
            await eventually(lambda: can_record.numbers == list(range(100)))

    asyncio.run(scenario())


@pytest.mark.parametrize(
    "garbage",
    [
        b"\xff\xfe\x80\r",  # not UTF-8: python-can keeps it in its buffer
        b"t1818AABB\r",  # truncated: python-can makes a frame with two bytes of eight
        b"t181G\r",
        b"t1814GGGGGGGG\r",
        b"t1814AABBC\r",
        b"t-124AABBCCDD\r",
        b"t1819AABBCCDDEEFF0011\r",
        b"t18\r",
        b"t\r",
        b"r181\r",
        b"d181H\r",
        b"T1FFFFFFFF0\r",
    ],
)
def test_a_line_that_is_no_frame_is_counted_and_the_next_frame_arrives(
    garbage: bytes, make_pty: Any, run_port: Any, eventually: Any, can_record: Any
) -> None:
    async def scenario() -> None:
        line = make_pty()
        port = can_record.port(interface="slcan", channel=line.path)
        async with run_port(port):
            await eventually(lambda: can_record.states == [None])
            line.write(garbage + slcan_line(1) + garbage + slcan_line(2))
            await eventually(lambda: len(can_record.frames) == 2)
        assert can_record.numbers == [1, 2]
        assert port.counters["bad_frames"] == 2
        assert can_record.states == [None]

    asyncio.run(scenario())


def test_a_bus_full_of_foreign_frames_costs_none_of_the_own_ones(
    make_pty: Any, run_port: Any, eventually: Any, can_record: Any
) -> None:
    async def scenario() -> None:
        line = make_pty()
        port = can_record.port([(0x181, False), (0x18FF1234, True)], interface="slcan", channel=line.path)
        async with run_port(port):
            await eventually(lambda: can_record.states == [None])
            foreign = b"".join(b"t%03X1FF\r" % (0x200 + i) for i in range(20)) + b"T18FF12351FF\r"
            for number in range(400):
                await line.stream(foreign + slcan_line(number))
            line.write(b"T18ff12340\r")
            await eventually(lambda: len(can_record.frames) == 401)
        assert can_record.numbers[:400] == list(range(400))
        assert port.counters["frames"] == 401
        assert port.counters["bad_frames"] == 0

    asyncio.run(scenario())


def test_more_frames_than_one_wake_up_takes_are_all_read_though_nothing_follows(
    make_pty: Any, run_port: Any, eventually: Any, can_record: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def scenario() -> None:
        monkeypatch.setattr(can_port, "FRAMES_PER_WAKE_UP", 10)
        line = make_pty()
        async with run_port(can_record.port(interface="slcan", channel=line.path)):
            await eventually(lambda: can_record.states == [None])
            line.write(b"".join(map(slcan_line, range(200))))
            await eventually(lambda: can_record.numbers == list(range(200)))

    asyncio.run(scenario())


noise = st.binary(min_size=1, max_size=30).map(lambda data: b"!" + data.replace(b"\r", b"").replace(b"\a", b"") + b"\r")
truncated = st.integers(1, 12).map(lambda length: slcan_line(0)[:length] + b"\r")


@settings(
    max_examples=30,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
@given(st.lists(st.one_of(st.just(None), noise, truncated), max_size=30), st.integers(1, 64))
def test_no_good_frame_is_lost_among_any_garbage(
    make_pty: Any, run_port: Any, eventually: Any, can_record: Any, garbage: list[bytes | None], piece: int
) -> None:
    lines, count = [], 0
    for line in [*garbage, None]:
        if line is None:
            count += 1
        lines.append(slcan_line(count) if line is None else line)
    stream = b"".join(lines)

    async def scenario() -> None:
        can_record.frames.clear()
        can_record.states.clear()
        line = make_pty()
        async with run_port(can_record.port(interface="slcan", channel=line.path)):
            await eventually(lambda: can_record.states == [None])
            for start in range(0, len(stream), piece):
                line.write(stream[start : start + piece])
            await eventually(lambda: count in can_record.numbers)
        line.hang_up()
        assert can_record.numbers == list(range(1, count + 1))

    asyncio.run(scenario())


def test_noise_without_line_ends_does_not_fill_the_memory(
    make_pty: Any, run_port: Any, eventually: Any, can_record: Any
) -> None:
    async def scenario() -> None:
        line = make_pty()
        buses, opened = opener()
        port = can_record.port(open_bus=opened, interface="slcan", channel=line.path)
        async with run_port(port):
            await eventually(lambda: can_record.states == [None])
            # A reader that is late takes up to 8 kB at a time for one bad frame.
            for _ in range(100):
                await line.stream(bytes(1000))
                assert len(buses[0]._buffer) < 8192
            await line.stream(b"\r" + slcan_line(3))
            await eventually(lambda: can_record.numbers == [3])
            assert port.counters["bad_frames"] >= 3
            assert buses[0].serialPortOrig.timeout == 0, "python-can would wait on the event loop"

    asyncio.run(scenario())


def test_an_adapter_that_is_unplugged_is_opened_again_when_it_returns(
    make_pty: Any,
    run_port: Any,
    eventually: Any,
    can_record: Any,
    tmp_path: Path,
    caplog: pytest.LogCaptureFixture,
) -> None:
    async def scenario() -> None:
        first, second, link = make_pty(), make_pty(), tmp_path / "adapter"
        link.symlink_to(first.path)
        buses, opened = opener()
        port = can_record.port(open_bus=opened, interface="slcan", channel=str(link))
        async with run_port(port):
            await eventually(lambda: can_record.states == [None])
            first.write(slcan_line(1))
            await eventually(lambda: can_record.numbers == [1])
            link.unlink()
            first.hang_up()
            await eventually(lambda: port.counters["open_errors"] > 0)
            link.symlink_to(second.path)
            await eventually(lambda: can_record.states[-1] is None)
            second.write(slcan_line(2))
            await eventually(lambda: can_record.numbers == [1, 2])
        assert can_record.states == [
            None,
            f"lost {link}: Input/output error",
            f"cannot open {link}: No such file or directory",
            None,
        ]
        # slcan writes its farewell to a port that is gone.
        assert port.counters["close_errors"] == 1
        assert not any(bus.serialPortOrig.is_open for bus in buses)

    with caplog.at_level(logging.WARNING, logger="can"):
        files = set(Path("/proc/self/fd").iterdir())
        asyncio.run(scenario())
        assert len(set(Path("/proc/self/fd").iterdir()) - files) <= 1, "only the second line's far end is open"
    assert "not properly shut down" not in caplog.text


def test_the_adapter_is_told_its_bit_rate_and_opened_without_delay_and_closed_at_the_end(
    make_pty: Any, run_port: Any, eventually: Any, can_record: Any
) -> None:
    async def scenario() -> None:
        line = make_pty()
        port = can_record.port(interface="slcan", channel=line.path, bitrate=500_000)
        async with run_port(port):
            start = time.monotonic()
            await eventually(lambda: can_record.states == [None])
            assert time.monotonic() - start < 1.9, "python-can sleeps 2 s unless told otherwise"
            port.send(0x080, b"")
            port.send(0x18FF0001, b"\x01\xab", extended=True)
            await eventually(lambda: port.counters["sent"] == 2)
            told = await asyncio.to_thread(read_all, line, b"AB\r")
        told += await asyncio.to_thread(read_all, line, b"C\r")
        assert told.startswith(b"C\rS6\r")
        assert told.endswith(b"O\rt0800\rT18FF0001201AB\rC\r")

    asyncio.run(scenario())


def test_an_unknown_bit_rate_is_reported_and_not_raised(
    make_pty: Any, run_port: Any, eventually: Any, can_record: Any
) -> None:
    async def scenario() -> None:
        line = make_pty()
        port = can_record.port(interface="slcan", channel=line.path, bitrate=123_456)
        async with run_port(port):
            await eventually(lambda: port.counters["open_errors"] == 2)
        assert len(can_record.states) == 1
        assert "Invalid bitrate" in can_record.states[0]

    asyncio.run(scenario())


def test_an_adapter_in_use_is_refused_before_a_byte_is_written_to_it(tmp_path: Path) -> None:
    master, slave = os.openpty()
    tty.setraw(slave)
    path = tmp_path / "can"
    path.symlink_to(os.ttyname(slave))
    states: list[str | None] = []

    async def scenario() -> None:
        encoders = Encoders(interface="slcan", channel=str(path), counts_per_revolution=100.0)
        first = asyncio.create_task(CanPort(encoders, (), lambda _: None, lambda _: None).run())
        await asyncio.sleep(0.3)
        os.read(master, 4096)
        os.set_blocking(master, False)
        second = asyncio.create_task(CanPort(encoders, (), lambda _: None, states.append).run())
        await asyncio.sleep(0.5)
        with pytest.raises(BlockingIOError):
            os.read(master, 4096)
        for task in (second, first):
            task.cancel()
        await asyncio.gather(first, second, return_exceptions=True)

    try:
        asyncio.run(scenario())
    finally:
        os.close(master)
        os.close(slave)
    assert states
    assert "in use by another program" in str(states[0])


def test_an_adapter_that_falls_silent_is_opened_again(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(can_port, "SLCAN_SILENCE_NS", 0)
    master, slave = os.openpty()
    tty.setraw(slave)
    path = tmp_path / "can"
    path.symlink_to(os.ttyname(slave))

    async def scenario() -> CanPort:
        encoders = Encoders(interface="slcan", channel=str(path), counts_per_revolution=100.0)
        port = CanPort(encoders, (), lambda _: None, lambda _: None)
        task = asyncio.create_task(port.run())
        await asyncio.sleep(2.5)
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        return port

    try:
        port = asyncio.run(scenario())
        written = os.read(master, 4096)
    finally:
        os.close(master)
        os.close(slave)
    assert port.counters["opens"] >= 2
    assert written.count(b"O\r") >= 2
