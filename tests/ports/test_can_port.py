import asyncio
import errno
import socket
import threading
import time
from collections import deque
from typing import Any

import can
import pytest


def error_frame(can_id: int, data: str = "0000000000000000") -> can.Message:
    return can.Message(arbitration_id=can_id, data=bytes.fromhex(data), is_extended_id=False, is_error_frame=True)


def network_is_down() -> can.CanOperationError:
    """What python-can's socketcan raises for a link that goes down."""
    error = can.CanOperationError("Error receiving: Network is down", errno.ENETDOWN)
    error.__cause__ = OSError(errno.ENETDOWN, "Network is down")
    return error


def test_data_frames_arrive_in_order_with_the_time_of_their_reception(
    run_port: Any, eventually: Any, can_record: Any, garage: Any, can_message: Any
) -> None:
    async def scenario() -> None:
        port = can_record.port(open_bus=garage.open)
        async with run_port(port):
            await eventually(lambda: can_record.states == [None])
            received_ns = time.monotonic_ns()
            early = can_message(0, timestamp=time.time())
            await asyncio.sleep(0.05)
            garage.buses[0].feed(early, can_message(1, can_id=0x12345678, is_extended_id=True))
            await eventually(lambda: len(can_record.frames) == 2)
        first, second = can_record.frames
        assert (first.can_id, first.extended, first.data) == (0x181, False, bytes(4))
        assert (second.can_id, second.extended, second.data) == (0x12345678, True, b"\1\0\0\0")
        # The first waited 50 ms in the kernel: its stamp says when it came.
        assert abs(first.t_ns - received_ns) < 40_000_000
        assert second.t_ns - first.t_ns > 40_000_000
        assert port.counters["frames"] == 2
        assert garage.buses[0].is_closed

    asyncio.run(scenario())


def test_a_burst_larger_than_one_wake_up_takes_is_read_to_the_end(
    run_port: Any, eventually: Any, can_record: Any, garage: Any, can_message: Any
) -> None:
    async def scenario() -> None:
        port = can_record.port(open_bus=garage.open, queue_frames=16)
        async with run_port(port):
            await eventually(lambda: can_record.states == [None])
            garage.buses[0].feed(*(can_message(number) for number in range(200)))
            await eventually(lambda: len(can_record.frames) == 200)
        assert can_record.numbers == list(range(200))
        assert max(can_record.batches) <= 16
        assert port.counters["queue_dropped"] == 0

    asyncio.run(scenario())


def test_socketcan_is_opened_with_filters_of_the_wanted_identifiers(
    run_port: Any, eventually: Any, can_record: Any, garage: Any
) -> None:
    async def scenario() -> None:
        async with run_port(can_record.port([(0x181, False), (0x18FF1234, True)], garage.open, bitrate=500_000)):
            await eventually(lambda: garage.buses)
        assert garage.buses[0].arguments == {
            "interface": "socketcan",
            "channel": "can0",
            "ignore_config": True,
            "can_filters": [
                {"can_id": 0x181, "can_mask": 0x7FF, "extended": False},
                {"can_id": 0x18FF1234, "can_mask": 0x1FFFFFFF, "extended": True},
            ],
        }

    asyncio.run(scenario())


def test_the_bus_is_opened_again_after_the_link_was_down(
    run_port: Any, eventually: Any, can_record: Any, garage: Any, can_message: Any
) -> None:
    async def scenario() -> None:
        port = can_record.port(open_bus=garage.open)
        async with run_port(port):
            await eventually(lambda: can_record.states == [None])
            garage.refusals = [OSError(errno.ENODEV, "No such device")] * 2
            garage.buses[0].feed(can_message(1), network_is_down())
            await eventually(lambda: len(garage.buses) == 2)
            await eventually(lambda: can_record.states[-1] is None)
            garage.buses[1].feed(can_message(2))
            await eventually(lambda: len(can_record.frames) == 2)
        assert can_record.numbers == [1, 2]
        assert can_record.states == [
            None,
            "lost can0: Network is down",
            "cannot open can0: No such device",
            None,
        ]
        assert (port.counters["opens"], port.counters["losses"], port.counters["open_errors"]) == (2, 1, 2)
        assert all(bus.is_closed for bus in garage.buses)

    asyncio.run(scenario())


def test_a_link_that_is_down_is_noticed_where_sending_took_the_error_before_the_reader(
    run_port: Any, eventually: Any, can_record: Any, garage: Any, can_message: Any
) -> None:
    # Linux clears a socket's error with the first call that returns it, here the send's.
    told = deque([network_is_down()])

    def tell_once() -> None:
        if told:
            raise told.popleft()

    async def scenario() -> None:
        port = can_record.port(open_bus=garage.open)
        async with run_port(port):
            await eventually(lambda: can_record.states == [None])
            garage.buses[0].before_send = tell_once
            for _ in range(3):
                port.send(0x80, b"")
            await eventually(lambda: len(garage.buses) == 2 and can_record.states[-1] is None)
            garage.buses[1].feed(can_message(2))
            await eventually(lambda: can_record.numbers == [2])
        assert can_record.states == [None, "lost can0: Network is down", None]
        assert (port.counters["opens"], port.counters["losses"], port.counters["send_errors"]) == (2, 1, 1)

    asyncio.run(scenario())


class DownSocket(socket.socket):
    """Bound to an interface that is down: the first look at its error tells."""

    def getsockopt(self, level: int, name: int, *rest: int) -> Any:
        if (level, name) == (socket.SOL_SOCKET, socket.SO_ERROR):
            return errno.ENETDOWN
        return super().getsockopt(level, name, *rest)


def test_an_interface_that_is_down_is_reported_at_opening_without_calling_it_open(
    run_port: Any, eventually: Any, can_record: Any, garage: Any
) -> None:
    async def scenario() -> None:

        def open_down(**arguments: Any) -> Any:
            bus = garage.open(**arguments)
            bus.socket = DownSocket(fileno=bus.socket.detach())
            return bus

        port = can_record.port(open_bus=open_down)
        async with run_port(port):
            await eventually(lambda: port.counters["open_errors"] == 2)
        assert can_record.states == ["cannot open can0: Network is down"]
        # The end may come while the worker is closing the second bus.
        await eventually(lambda: all(bus.is_closed for bus in garage.buses))

    asyncio.run(scenario())


@pytest.mark.usefixtures("quick_checks")
@pytest.mark.parametrize("later", [[4], [OSError(errno.ENODEV, "No such device"), 4]])
def test_an_interface_that_was_deleted_and_made_anew_is_opened_again(
    later: list[int | OSError],
    run_port: Any,
    eventually: Any,
    monkeypatch: pytest.MonkeyPatch,
    can_record: Any,
    garage: Any,
    can_message: Any,
) -> None:
    answers: deque[int | OSError] = deque([3])

    def if_nametoindex(name: str) -> int:
        assert name == "can0"
        answer = answers[0] if len(answers) == 1 else answers.popleft()
        if isinstance(answer, OSError):
            raise answer
        return answer

    async def scenario() -> None:
        async with run_port(can_record.port(open_bus=garage.open)):
            await eventually(lambda: can_record.states == [None])
            await asyncio.sleep(0.1)
            assert len(garage.buses) == 1, "the same index is the same interface"
            answers.extend(later)
            answers.popleft()
            await eventually(lambda: len(garage.buses) == 2 and can_record.states[-1] is None)
            garage.buses[1].feed(can_message(5))
            await eventually(lambda: can_record.numbers == [5])
        assert can_record.states == [None, "lost can0: the interface was deleted or recreated", None]

    monkeypatch.setattr(socket, "if_nametoindex", if_nametoindex)
    asyncio.run(scenario())


def test_bus_trouble_is_counted_and_reported_until_data_or_a_restart(
    run_port: Any, eventually: Any, can_record: Any, garage: Any, can_message: Any
) -> None:
    async def scenario() -> None:
        port = can_record.port(open_bus=garage.open)
        async with run_port(port):
            await eventually(lambda: can_record.states == [None])
            feed = garage.buses[0].feed
            for frame, states in [
                (error_frame(0x204, "0008000000006000"), ["error-warning"]),
                (error_frame(0x204, "0020000000008000"), ["error-passive"]),
                (error_frame(0x040), ["bus-off"]),
                (error_frame(0x080), []),
                (error_frame(0x100), [None]),
                (error_frame(0x020), ["no node acknowledges"]),
                (can_message(7), [None]),
            ]:
                expected = can_record.states + states
                handled = sum(port.counters[name] for name in ("error_frames", "frames"))
                feed(frame)
                await eventually(
                    lambda: sum(port.counters[name] for name in ("error_frames", "frames")) > handled  # noqa: B023 - awaited at once
                )
                await eventually(lambda: can_record.states == expected)  # noqa: B023 - awaited at once
        assert {name: count for name, count in port.counters.items() if count} == {
            "opens": 1, "frames": 1, "error_frames": 6, "error_warning": 1, "error_passive": 1, "bus_off": 1,
            "bus_error": 1, "restarted": 1, "no_acknowledgement": 1,
        }  # fmt: skip

    asyncio.run(scenario())


def test_frames_that_are_no_data_or_impossible_are_counted_and_kept_back(
    run_port: Any, eventually: Any, can_record: Any, garage: Any, can_message: Any
) -> None:
    async def scenario() -> None:
        port = can_record.port(open_bus=garage.open)
        async with run_port(port):
            await eventually(lambda: can_record.states == [None])
            garage.buses[0].feed(
                can_message(data=None, is_remote_frame=True, dlc=4),
                can_message(data=b"\1\2", dlc=8),
                can_message(can_id=0x800),
                can_message(can_id=-0x12),
                can_message(can_id=0x20000000, is_extended_id=True),
                can_message(9),
            )
            await eventually(lambda: can_record.frames)
        assert can_record.numbers == [9]
        assert (port.counters["remote_frames"], port.counters["bad_frames"]) == (1, 4)

    asyncio.run(scenario())


def test_a_stamp_that_is_no_wall_clock_time_is_counted(
    run_port: Any, eventually: Any, can_record: Any, garage: Any, can_message: Any
) -> None:
    async def scenario() -> None:
        port = can_record.port(open_bus=garage.open)
        async with run_port(port):
            await eventually(lambda: can_record.states == [None])
            before_ns = time.monotonic_ns()
            garage.buses[0].feed(can_message(timestamp=0.0))
            await eventually(lambda: can_record.frames)
        assert before_ns <= can_record.frames[0].t_ns <= time.monotonic_ns()
        assert port.counters["stepped_stamps"] == 1

    asyncio.run(scenario())


@pytest.mark.parametrize("error", [ZeroDivisionError("a driver's bug"), ValueError(), can.CanOperationError("gone")])
def test_whatever_a_driver_raises_is_a_loss_and_not_an_end(
    error: Exception, run_port: Any, eventually: Any, can_record: Any, garage: Any
) -> None:
    async def scenario() -> None:
        async with run_port(can_record.port(open_bus=garage.open)) as task:
            await eventually(lambda: can_record.states == [None])
            garage.refusals = [error]
            garage.buses[0].feed(error)
            await eventually(lambda: len(garage.buses) == 2)
            assert not task.done()
        assert can_record.states[1] == f"lost can0: {str(error) or 'ValueError'}"

    asyncio.run(scenario())


def test_a_bus_that_fails_to_shut_down_is_counted_and_left(
    run_port: Any, eventually: Any, can_record: Any, garage: Any
) -> None:
    def fail() -> None:
        raise RuntimeError("cannot")

    async def scenario() -> None:
        port = can_record.port(open_bus=garage.open)
        async with run_port(port):
            await eventually(lambda: can_record.states == [None])
            garage.buses[0].after_shutdown = fail
        assert port.counters["close_errors"] == 1

    asyncio.run(scenario())


def test_cancelling_while_the_bus_is_being_opened_shuts_it_down(
    run_port: Any, eventually: Any, can_record: Any, garage: Any
) -> None:
    async def scenario() -> None:
        opening, go_on = threading.Event(), threading.Event()

        def slow(**arguments: Any) -> Any:
            opening.set()
            go_on.wait(20)
            return garage.open(**arguments)

        async with run_port(can_record.port(open_bus=slow)) as task:
            await eventually(opening.is_set)
            task.cancel()
            await asyncio.sleep(0.01)
            task.cancel()  # an impatient second time
            go_on.set()
        await eventually(lambda: garage.buses and garage.buses[0].is_closed)
        assert can_record.states == []

    asyncio.run(scenario())
