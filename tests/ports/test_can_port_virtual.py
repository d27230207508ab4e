import asyncio
import itertools
import threading
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest

from drd.config.keys import Encoders
from drd.ports.can_port import CanPort
from drd.samples import CanFrame

RECORDING = Path(__file__).resolve().parents[2].parent / "shared/recordings/raw/comma2k19/segment40.npz"
channels = (f"test {number}" for number in itertools.count())


def test_frames_are_sent_in_order_to_the_bus(run_port: Any, eventually: Any, can_record: Any) -> None:
    async def scenario() -> None:
        channel = next(channels)
        port = can_record.port(interface="virtual", channel=channel)
        with can.Bus(interface="virtual", channel=channel) as other:
            port.send(0x80, b"")
            assert port.counters["send_dropped"] == 1
            async with run_port(port):
                await eventually(lambda: can_record.states == [None])
                port.send(0x000, b"\1\0")
                port.send(0x18FF0001, b"\2", extended=True)
                await eventually(lambda: port.counters["sent"] == 2)
                for number in range(3, 40):
                    port.send(0x80, b"")
                    await eventually(lambda: port.counters["sent"] == number)  # noqa: B023 - awaited at once
            first, second = other.recv(0), other.recv(0)
            assert first is not None
            assert second is not None
            assert (first.arbitration_id, first.is_extended_id, bytes(first.data)) == (0, False, b"\1\0")
            assert (second.arbitration_id, second.is_extended_id, bytes(second.data)) == (
                0x18FF0001,
                True,
                b"\2",
            )
            port.send(0x80, b"")
            assert port.counters["send_dropped"] == 2

    asyncio.run(scenario())


def test_a_bus_that_is_stuck_in_sending_holds_up_neither_reading_nor_memory(
    run_port: Any, eventually: Any, can_record: Any, garage: Any, can_message: Any
) -> None:
    go_on = threading.Event()

    def wait_and_fail_once() -> None:
        go_on.wait(20)
        if len(garage.buses[0].sent) == 3 and port.counters["send_errors"] == 0:
            raise can.CanOperationError("Transmit buffer full")

    port = can_record.port(open_bus=garage.open)

    async def scenario() -> None:
        async with run_port(port):
            await eventually(lambda: can_record.states == [None])
            garage.buses[0].before_send = wait_and_fail_once
            for _ in range(100):
                port.send(0x80, b"")
            garage.buses[0].feed(can_message(3))
            await eventually(lambda: can_record.numbers == [3])
            go_on.set()
        assert (port.counters["send_dropped"], port.counters["sent"], port.counters["send_errors"]) == (
            84,
            15,
            1,
        )
        assert len(garage.buses[0].sent) == 15

    asyncio.run(scenario())


def test_only_the_wanted_identifiers_are_received(
    run_port: Any, eventually: Any, can_record: Any, can_message: Any
) -> None:
    async def scenario() -> None:
        channel = next(channels)
        port = can_record.port([(0x181, False)], interface="virtual", channel=channel)
        with can.Bus(interface="virtual", channel=channel) as other:
            async with run_port(port):
                await eventually(lambda: can_record.states == [None])
                for frame in (
                    can_message(1),
                    can_message(2, can_id=0x182),
                    can_message(3, is_extended_id=True),
                    can_message(4),
                ):
                    other.send(frame)
                await eventually(lambda: can_record.numbers == [1, 4])

    asyncio.run(scenario())


def test_a_bus_without_a_file_number_is_lost_and_opened_again(
    run_port: Any, eventually: Any, can_record: Any, can_message: Any
) -> None:
    async def scenario() -> None:
        channel = next(channels)
        opened: list[can.BusABC] = []

        def open_bus(**arguments: Any) -> can.BusABC:
            opened.append(can.Bus(**arguments))
            return opened[-1]

        with can.Bus(interface="virtual", channel=channel) as other:
            async with run_port(can_record.port(open_bus=open_bus, interface="virtual", channel=channel)):
                await eventually(lambda: can_record.states == [None])
                opened[0].shutdown()
                await eventually(lambda: len(can_record.states) == 3)
                other.send(can_message(6))
                await eventually(lambda: can_record.numbers == [6])
            assert can_record.states == [None, f"lost {channel}: Cannot operate on a closed bus", None]
        assert not [thread for thread in threading.enumerate() if thread.name == f"drd {channel} reader"]

    asyncio.run(scenario())


def test_frames_read_before_a_loss_are_delivered_and_do_not_hide_it(
    run_port: Any, eventually: Any, can_record: Any, can_message: Any
) -> None:
    async def scenario() -> None:
        channel = next(channels)
        opened: list[can.BusABC] = []

        def open_once(**arguments: Any) -> can.BusABC:
            if opened:
                raise OSError("gone")
            opened.append(can.Bus(**arguments))
            return opened[0]

        port = can_record.port(open_bus=open_once, interface="virtual", channel=channel)
        with can.Bus(interface="virtual", channel=channel) as other:
            async with run_port(port):
                await eventually(lambda: can_record.states == [None])
                for number in range(1000):
                    other.send(can_message(number))
                while port.counters["frames"] < 1000:
                    time.sleep(0.001)
                opened[0].shutdown()
                time.sleep(0.2)
                await eventually(lambda: port.counters["open_errors"] > 0)
                await eventually(lambda: len(can_record.frames) == 1000)
        assert can_record.numbers == list(range(1000))
        lost = f"lost {channel}: Cannot operate on a closed bus"
        assert can_record.states == [None, lost, f"cannot open {channel}: gone"]

    asyncio.run(scenario())


@pytest.fixture
def recorded(can_message: Any) -> list[can.Message]:
    """All CAN frames of one minute of driving (comma2k19)."""
    if not RECORDING.exists():
        pytest.skip("the shared recordings are not here")
    with np.load(RECORDING) as recording:
        identifiers, payloads = recording["CAN__raw_can__address"], recording["CAN__raw_can__data"]
    return [can_message(can_id=int(i), data=bytes(d)) for i, d in zip(identifiers, payloads, strict=True)]


@pytest.mark.recordings
def test_a_recorded_minute_of_a_car_sent_at_full_speed_arrives_complete_and_in_order(
    run_port: Any, eventually: Any, can_record: Any, recorded: list[can.Message]
) -> None:
    async def scenario() -> None:
        channel = next(channels)
        port = can_record.port(interface="virtual", channel=channel, queue_frames=200_000)
        with can.Bus(interface="virtual", channel=channel) as other:
            async with run_port(port):
                await eventually(lambda: can_record.states == [None])
                await asyncio.to_thread(lambda: [other.send(frame) for frame in recorded])
                await eventually(lambda: len(can_record.frames) == len(recorded))
        assert len(recorded) == 135_468
        assert port.counters["frames"] == 135_468
        assert port.counters["queue_dropped"] == 0
        sent = [(frame.arbitration_id, bytes(frame.data)) for frame in recorded]
        assert [(frame.can_id, frame.data) for frame in can_record.frames] == sent
        assert Counter(frame.can_id for frame in can_record.frames) == Counter(can_id for can_id, _ in sent)
        times = [frame.t_ns for frame in can_record.frames]
        assert times == sorted(times)

    asyncio.run(scenario())


@pytest.mark.parametrize("queue_frames", [16, 1000])
def test_when_the_estimator_is_slow_the_oldest_frames_are_dropped_and_each_is_counted(
    queue_frames: int, run_port: Any, eventually: Any, can_record: Any, can_message: Any
) -> None:
    messages = [can_message(number, can_id=0x100 + number % 165) for number in range(20_000)]

    async def scenario() -> None:
        channel = next(channels)

        def slow(frames: Sequence[CanFrame]) -> None:
            can_record.on_frames(frames)
            time.sleep(0.05)

        encoders = Encoders(interface="virtual", channel=channel, queue_frames=queue_frames)
        port = CanPort(encoders, (), slow, can_record.states.append)
        with can.Bus(interface="virtual", channel=channel) as other:
            async with run_port(port):
                await eventually(lambda: can_record.states == [None])
                await asyncio.to_thread(lambda: [other.send(frame) for frame in messages])
                await eventually(lambda: len(can_record.frames) + port.counters["queue_dropped"] == len(messages))
                await asyncio.sleep(0.2)
        received = can_record.numbers
        assert port.counters["frames"] == len(messages)
        assert port.counters["queue_dropped"] > 0
        assert len(received) + port.counters["queue_dropped"] == len(messages)
        assert received == sorted(set(received))
        assert received[-queue_frames:] == list(range(len(messages) - queue_frames, len(messages))), (
            "the newest are kept"
        )

    asyncio.run(scenario())


def test_files_and_threads_are_given_back(run_port: Any, eventually: Any, can_record: Any, garage: Any) -> None:
    async def scenario() -> None:
        for _ in range(5):
            channel = next(channels)
            can_record.states.clear()
            fake = can_record.port(open_bus=garage.open)
            virtual = can_record.port(interface="virtual", channel=channel)
            async with run_port(fake), run_port(virtual):
                await eventually(lambda: can_record.states == [None, None])

    threads, files = threading.active_count(), len(list(Path("/proc/self/fd").iterdir()))
    asyncio.run(scenario())
    give_up = time.monotonic() + 20
    while threading.active_count() > threads and time.monotonic() < give_up:
        time.sleep(0.01)
    assert threading.active_count() <= threads
    assert len(list(Path("/proc/self/fd").iterdir())) <= files
