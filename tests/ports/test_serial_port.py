import asyncio
import threading
import time
from pathlib import Path
from typing import Any

import pytest
import serial

from drd.config.keys import Fog
from drd.ports.serial_port import SerialPort


class Record:
    """What a port reported."""

    def __init__(self) -> None:
        self.pieces: list[tuple[bytes, int]] = []
        self.states: list[str | None] = []

    @property
    def data(self) -> bytes:
        return b"".join(data for data, _ in self.pieces)

    def port(self, path: str | Path, **keys: Any) -> SerialPort:
        return SerialPort(
            Fog(port=str(path), **keys),
            lambda data, t_ns: self.pieces.append((data, t_ns)),
            self.states.append,
        )


def test_bytes_arrive_in_order_with_the_time_of_their_arrival(make_pty: Any, run_port: Any, eventually: Any) -> None:
    async def scenario() -> None:
        line, record = make_pty(), Record()
        port = record.port(line.path)
        async with run_port(port):
            await eventually(lambda: record.states == [None])
            sent: list[bytes] = []
            for number in range(20):
                sent.append(bytes([0x80 | number, number]) * 4)
                before_ns = time.monotonic_ns()
                line.write(sent[-1])
                await eventually(lambda: record.data == b"".join(sent))
                assert before_ns <= record.pieces[-1][1] <= time.monotonic_ns()
        assert port.counters["bytes"] == len(record.data)
        assert port.counters["opens"] == 1

    asyncio.run(scenario())


def test_every_byte_value_passes_unchanged(make_pty: Any, run_port: Any, eventually: Any) -> None:
    async def scenario() -> None:
        line, record = make_pty(), Record()
        sent = bytes(range(256)) * 64
        async with run_port(record.port(line.path)):
            await eventually(lambda: record.states == [None])
            await line.stream(sent)
            await eventually(lambda: len(record.data) >= len(sent))
        assert record.data == sent

    asyncio.run(scenario())


def test_a_replugged_adapter_is_found_again_behind_its_link(
    make_pty: Any, run_port: Any, eventually: Any, tmp_path: Path
) -> None:
    async def scenario() -> None:
        first, second, record, link = make_pty(), make_pty(), Record(), tmp_path / "fog"
        link.symlink_to(first.path)
        port = record.port(link)
        async with run_port(port):
            await eventually(lambda: record.states == [None])
            first.write(b"before")
            await eventually(lambda: record.data == b"before")
            first.hang_up()
            link.unlink()
            await eventually(lambda: port.counters["open_errors"] > 0)
            link.symlink_to(second.path)
            await eventually(lambda: record.states[-1] is None)
            second.write(b"after")
            await eventually(lambda: record.data == b"beforeafter")
        assert port.counters["losses"] == 1
        assert port.counters["opens"] == 2
        assert record.states[0] is None
        assert record.states[1] is not None
        assert record.states[1].startswith(f"lost {link}: ")
        assert record.states[2:] == [f"cannot open {link}: No such file or directory", None]

    asyncio.run(scenario())


@pytest.mark.usefixtures("quick_checks")
def test_a_link_that_moves_to_another_device_without_a_hang_up_is_followed(
    make_pty: Any, run_port: Any, eventually: Any, tmp_path: Path
) -> None:
    async def scenario() -> None:
        first, second, record, link = make_pty(), make_pty(), Record(), tmp_path / "fog"
        link.symlink_to(first.path)
        async with run_port(record.port(link)):
            await eventually(lambda: record.states == [None])
            link.unlink()
            link.symlink_to(second.path)
            await eventually(lambda: len(record.states) == 3)
            second.write(b"after")
            await eventually(lambda: record.data == b"after")
        assert record.states == [None, f"lost {link}: another device has taken its name", None]

    asyncio.run(scenario())


def test_waits_double_to_two_seconds_and_begin_anew_after_data(
    make_pty: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    line, link, waits_s = make_pty(), tmp_path / "fog", list[float]()

    def speak(state: str | None) -> None:
        if state is None:
            line.write(b"x")

    async def sleep(wait_s: float) -> None:
        waits_s.append(wait_s)
        if len(waits_s) == 7:
            link.symlink_to(line.path)
        elif len(waits_s) == 8:
            raise asyncio.CancelledError

    monkeypatch.setattr(asyncio, "sleep", sleep)
    port = SerialPort(Fog(port=str(link)), lambda *_: line.hang_up(), speak)
    with pytest.raises(asyncio.CancelledError):
        asyncio.run(port.run())
    assert waits_s == [0.1, 0.2, 0.4, 0.8, 1.6, 2.0, 2.0, 0.1]


@pytest.mark.usefixtures("quick_checks")
def test_a_device_that_stays_is_not_taken_for_vanished(make_pty: Any, run_port: Any, eventually: Any) -> None:
    async def scenario() -> None:
        line, record = make_pty(), Record()
        async with run_port(record.port(line.path)):
            await eventually(lambda: record.states == [None])
            await asyncio.sleep(0.1)
        assert record.states == [None]

    asyncio.run(scenario())


def test_a_device_that_does_not_exist_at_the_start_is_waited_for(
    make_pty: Any, run_port: Any, eventually: Any, tmp_path: Path
) -> None:
    async def scenario() -> None:
        line, record, link = make_pty(), Record(), tmp_path / "fog"
        port = record.port(link)
        async with run_port(port):
            await eventually(lambda: port.counters["open_errors"] >= 2)
            link.symlink_to(line.path)
            await eventually(lambda: record.states[-1] is None)
            line.write(b"hello")
            await eventually(lambda: record.data == b"hello")
        # The same reason twice is one state.
        assert record.states == [f"cannot open {link}: No such file or directory", None]

    asyncio.run(scenario())


def test_a_port_that_another_program_holds_exclusively_is_waited_for(
    make_pty: Any, run_port: Any, eventually: Any
) -> None:
    async def scenario() -> None:
        line, record = make_pty(), Record()
        port = record.port(line.path)
        with serial.Serial(line.path, exclusive=True):
            async with run_port(port):
                await eventually(lambda: port.counters["open_errors"] > 0)
        assert record.states == [f"cannot open {line.path}: in use by another program"]
        # Another port: a thread of the first may still be closing what it has.
        async with run_port(record.port(line.path)):
            await eventually(lambda: record.states[-1] is None)
            with pytest.raises(serial.SerialException, match="exclusively"):
                serial.Serial(line.path, exclusive=True)

    asyncio.run(scenario())


def test_what_is_no_serial_device_is_reported_and_not_raised(run_port: Any, eventually: Any, tmp_path: Path) -> None:
    async def scenario(path: str) -> None:
        record = Record()
        port = record.port(path)
        async with run_port(port) as task:
            await eventually(lambda: port.counters["open_errors"] > 0)
            assert not task.done()
        assert record.states[0] is not None
        assert record.states[0].startswith(f"cannot open {path}: ")

    file = tmp_path / "file"
    file.write_bytes(b"no tty")
    for path in (str(tmp_path), str(file), "/dev/null", "nul\0byte"):
        asyncio.run(scenario(path))


def test_a_driver_without_low_latency_mode_is_counted_and_read_all_the_same(
    make_pty: Any, run_port: Any, eventually: Any
) -> None:
    async def scenario(low_latency: bool) -> int:
        line, record = make_pty(), Record()
        port = record.port(line.path, low_latency=low_latency)
        async with run_port(port):
            await eventually(lambda: record.states == [None])
            line.write(b"x")
            await eventually(lambda: record.data == b"x")
        return port.counters["low_latency_refused"]

    assert asyncio.run(scenario(low_latency=True)) == 1
    assert asyncio.run(scenario(low_latency=False)) == 0


def test_cancelling_closes_the_port(make_pty: Any, run_port: Any, eventually: Any) -> None:
    async def scenario() -> None:
        line, record = make_pty(), Record()
        port = record.port(line.path)
        for _ in range(3):
            async with run_port(port):
                await eventually(lambda: port.counters["opens"] > len(record.pieces))
                line.write(b"x")
                await eventually(lambda: len(record.pieces) == port.counters["opens"])
            serial.Serial(line.path, exclusive=True).close()

    before = set(Path("/proc/self/fd").iterdir())
    asyncio.run(scenario())
    # make_pty keeps its master open until the test ends.
    assert len(set(Path("/proc/self/fd").iterdir()) - before) <= 1


def test_cancelling_while_the_port_is_being_opened_closes_it_too(
    make_pty: Any, run_port: Any, eventually: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    opening, go_on = threading.Event(), threading.Event()
    opened = []
    real = serial.Serial

    def slow(*arguments: Any, **keys: Any) -> serial.Serial:
        opening.set()
        go_on.wait(20)
        opened.append(real(*arguments, **keys))
        return opened[-1]

    async def scenario() -> None:
        line, record = make_pty(), Record()
        async with run_port(record.port(line.path)) as task:
            await eventually(opening.is_set)
            task.cancel()
            await asyncio.sleep(0.01)
            task.cancel()  # an impatient second time
            go_on.set()
        await eventually(lambda: opened and not opened[0].is_open)
        assert record.states == []

    monkeypatch.setattr(serial, "Serial", slow)
    asyncio.run(scenario())


@pytest.mark.parametrize("is_lost", [False, True])
def test_whenever_it_is_cancelled_it_ends_with_the_port_closed(make_pty: Any, eventually: Any, is_lost: bool) -> None:
    async def scenario(after_s: float) -> None:
        line, record = make_pty(), Record()
        port = record.port(line.path)
        close = port._close

        def slow_close() -> None:
            time.sleep(0.01)  # as some drivers take
            close()

        port._close = slow_close  # type: ignore[method-assign]
        task = asyncio.create_task(port.run())
        if is_lost:
            await eventually(lambda: record.states == [None])
            line.hang_up()
        cancel_s = time.monotonic() + after_s
        while time.monotonic() < cancel_s:
            await asyncio.sleep(0)
        task.cancel()
        assert not (await asyncio.wait({task}, timeout=20))[1]
        assert task.cancelled()
        assert port._port is None
        line.hang_up()

    for step in range(60):
        asyncio.run(scenario(step * 0.0004))


def test_an_error_in_the_callback_is_heard_of_and_does_not_stop_the_reading(
    make_pty: Any, run_port: Any, eventually: Any
) -> None:
    async def scenario() -> None:
        line, states, heard = make_pty(), [], []
        received = []

        def on_bytes(data: bytes, _t_ns: int) -> None:
            received.append(data)
            if len(received) == 1:
                raise RuntimeError("a bug")

        def on_state(state: str | None) -> None:
            states.append(state)

        def handler(_loop: object, context: dict[str, Any]) -> None:
            heard.append(context["exception"])

        asyncio.get_running_loop().set_exception_handler(handler)
        async with run_port(SerialPort(Fog(port=line.path), on_bytes, on_state)):
            await eventually(lambda: states == [None])
            line.write(b"first")
            await eventually(lambda: heard)
            line.write(b"second")
            await eventually(lambda: received[1:] == [b"second"])
        assert [str(error) for error in heard] == ["a bug"]

    asyncio.run(scenario())
