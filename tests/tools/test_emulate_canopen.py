"""The emulated CANopen encoders as a master sees them, and what the daemon makes of them. Bytes as in CiA 301."""

import itertools
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import can
import pytest
from perfect_hardware import PERFECT

from drd.config.keys import Config
from drd.config.schema import loads
from drd.encoders.stream import EncoderStream
from drd.samples import CanFrame
from drd_tools.emulate.hardware import Emulator
from drd_tools.simulate.missions import demo_drive

LEFT, RIGHT = 0x181, 0x182
CONFIG = """
robot: {{wheel_radius_m: 0.1, tread_m: 0.6}}
fog: {{protocol: none}}
encoders: {{interface: virtual, channel: "{channel}", layout: cia406, counts_per_revolution: 1000,
  cia406: {{start_nodes: {start}}}}}
"""
CHANNELS = (f"canopen {number}" for number in itertools.count())


class Network:
    """An emulator in simulated time, and another program on its bus."""

    def __init__(self, start: bool, fields: dict[str, Any]):
        self.config = loads(CONFIG.format(channel=next(CHANNELS), start=str(start).lower()), Config).value
        self.emulator = Emulator(self.config, Path(), demo_drive(60.0, stand_s=1.0), PERFECT)
        for name, value in fields.items():
            setattr(self.emulator, name, value)
        self.bus = can.Bus(interface="virtual", channel=self.config.encoders.channel, ignore_config=True)
        self.emulator.plug_in()

    def close(self) -> None:
        self.bus.shutdown()
        self.emulator.stop()

    def send(self, can_id: int, data: str) -> None:
        self.bus.send(can.Message(arbitration_id=can_id, data=bytes.fromhex(data), is_extended_id=False))

    def until(self, now_s: float) -> list[tuple[int, str]]:
        """Identifier and bytes of each frame since the last call; of a position, only the identifier."""
        self.emulator.step(now_s + 1e-6)
        frames = iter(lambda: self.bus.recv(0), None)
        return [(f.arbitration_id, "" if f.arbitration_id in (LEFT, RIGHT) else bytes(f.data).hex()) for f in frames]


@pytest.fixture
def network() -> Iterator[Callable[..., Network]]:
    made: list[Network] = []

    def make(*, start: bool = False, **fields: Any) -> Network:
        made.append(Network(start, fields))
        return made[-1]

    yield make
    for one in made:
        one.close()


def test_by_themselves_the_nodes_boot_and_send_positions(network: Callable[..., Network]) -> None:
    assert network().until(0.05) == [(0x701, "00"), (0x702, "00"), (LEFT, ""), (RIGHT, "")]


def test_positions_come_only_while_a_node_is_operational(network: Callable[..., Network]) -> None:
    net = network(nodes_autostart=False)
    assert net.until(1.0) == [(0x701, "00"), (0x702, "00")]
    net.send(0x000, "0101")  # start node 1
    assert net.until(1.05) == [(LEFT, "")]
    net.send(0x000, "0100")  # start all
    assert net.until(1.10) == [(LEFT, ""), (RIGHT, "")]
    net.send(0x000, "0202")  # stop node 2
    assert net.until(1.15) == [(LEFT, "")]
    net.send(0x000, "8000")  # all pre-operational
    assert net.until(1.20) == []
    net.send(0x000, "0105")  # another node
    net.send(0x000, "01")
    assert net.until(1.25) == []


@pytest.mark.parametrize("reset", ["81", "82"])
def test_after_a_reset_a_node_boots_again(reset: str, network: Callable[..., Network]) -> None:
    net = network(nodes_autostart=False)
    net.until(0.0)
    net.send(0x000, "0100")
    net.until(0.0)
    net.send(0x000, f"{reset}01")
    assert net.until(0.05) == [(0x701, "00"), (RIGHT, "")]


def test_heartbeats_tell_the_state(network: Callable[..., Network]) -> None:
    net = network(nodes_autostart=False, heartbeat_s=0.5, wheels_silent=True)
    assert net.until(0.0) == [(0x701, "00"), (0x702, "00")]
    assert net.until(0.4) == []
    assert net.until(0.51) == [(0x701, "7f"), (0x702, "7f")]
    net.send(0x000, "0101")
    net.send(0x000, "0202")
    assert net.until(1.01) == [(0x701, "05"), (0x702, "04")]
    assert len(net.until(3.01)) == 8


def test_a_master_sets_the_heartbeat_time_of_one_node(network: Callable[..., Network]) -> None:
    net = network(wheels_silent=True)
    net.until(0.0)
    net.send(0x601, "2b171000c8000000")  # 200 ms into object 1017h
    net.send(0x601, "4017100000000000")
    assert net.until(0.0) == [(0x581, "6017100000000000"), (0x581, "4b171000c8000000")]
    assert net.until(0.41) == [(0x701, "05"), (0x701, "05")]
    net.send(0x000, "8101")  # a reset forgets it
    assert net.until(1.0) == [(0x701, "00")]


@pytest.mark.parametrize(
    ("request_", "answer"),
    [
        ("4018100100000000", "8018100100000206"),  # no such object
        ("4017100100000000", "8017100111000906"),  # no such subindex
        ("2f17100001000000", "8017100001000405"),  # one byte: a command that is not known
    ],
)
def test_other_sdo_requests_are_aborted_with_the_reason(
    request_: str, answer: str, network: Callable[..., Network]
) -> None:
    net = network(wheels_silent=True)
    net.until(0.0)
    net.send(0x601, request_)
    assert net.until(0.0) == [(0x581, answer)]
    net.send(0x601, "8017100000000000")  # an abort is not answered
    net.send(0x000, "0200")
    net.send(0x601, "4017100000000000")  # nor is anything while stopped
    assert net.until(0.0) == []


def test_the_daemon_starts_the_nodes_and_takes_heartbeats_for_nothing_else(network: Callable[..., Network]) -> None:
    net = network(start=True, nodes_autostart=False, heartbeat_s=0.1)
    stream = EncoderStream(net.config.encoders, net.config.robot, Path())
    samples = []
    for frame in stream.start_frames():
        net.send(frame.can_id, frame.data.hex())
    for step in range(100):
        net.emulator.step(0.05 * step + 1e-6)
        for message in iter(lambda: net.bus.recv(0), None):
            t_ns = 50_000_000 * step
            samples += stream.feed(CanFrame(t_ns, message.arbitration_id, False, bytes(message.data)))
            for reply in stream.take_replies():
                net.send(reply.can_id, reply.data.hex())
    assert len(samples) >= 95
    counters = {name: count for name, count in stream.counters.items() if count and name not in ("frames", "samples")}
    assert counters == {"boot_ups": 2, "left_restarts": 1, "right_restarts": 1}
