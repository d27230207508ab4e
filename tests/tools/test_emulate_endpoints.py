import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import can
import pytest
import serial

from drd.config.keys import Encoders
from drd.config.schema import ConfigError
from drd_tools.emulate.endpoints import BusEndpoint, PtyLink, SlcanAdapter, can_endpoint


@contextmanager
def plugged(end: PtyLink | SlcanAdapter | BusEndpoint) -> Iterator[None]:
    end.open()
    try:
        yield
    finally:
        end.close()


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "fog"


def open_descriptors() -> int:
    return len(os.listdir("/proc/self/fd"))  # noqa: PTH208  # no Path is wanted


def test_bytes_pass_a_link_unchanged_in_both_directions(path: Path) -> None:
    link, every_byte = PtyLink(str(path), "fog.port"), bytes(range(256))
    with plugged(link), serial.Serial(str(path), 9600, timeout=2, exclusive=True) as port:
        assert link.write(every_byte)
        assert port.read(256) == every_byte
        port.write(every_byte)
        received = b""
        give_up = time.monotonic() + 5
        while len(received) < 256 and time.monotonic() < give_up:
            received += link.read()
        assert received == every_byte
        assert link.read() == b""


def test_the_terminal_is_raw_for_programs_that_do_not_ask_for_it(path: Path) -> None:
    link, every_byte = PtyLink(str(path), "fog.port"), bytes(range(256))
    with plugged(link), path.open("r+b", buffering=0) as port:
        os.set_blocking(port.fileno(), False)
        assert link.write(every_byte)
        received, give_up = b"", time.monotonic() + 5
        while len(received) < 256 and time.monotonic() < give_up:
            received += port.read(256) or b""
        assert received == every_byte
        assert link.read() == b""  # no echo


def test_a_daemon_may_come_and_go(path: Path) -> None:
    link = PtyLink(str(path), "fog.port")
    with plugged(link):
        for _ in range(3):
            with serial.Serial(str(path), 9600, timeout=2, exclusive=True) as port:
                assert link.write(b"hello")
                assert port.read(5) == b"hello"


def test_nobody_reading_loses_bytes_but_never_blocks(path: Path) -> None:
    link = PtyLink(str(path), "fog.port")
    with plugged(link):
        before = time.monotonic()
        sent = [link.write(bytes(1000)) for _ in range(1000)]
        assert sent[0]
        assert not sent[-1]
        assert time.monotonic() - before < 5
        with serial.Serial(str(path), 9600, timeout=0.1) as port:
            while port.read(65536):
                pass
            assert link.write(b"again")
            assert port.read(5) == b"again"


def test_unplugging_hangs_up_and_removes_the_link(path: Path) -> None:
    link = PtyLink(str(path), "fog.port")
    link.open()
    with serial.Serial(str(path), 9600, timeout=5) as port:
        link.close()
        assert not path.is_symlink()
        with pytest.raises(serial.SerialException):
            port.read(1)
    assert (link.write(b"x"), link.read()) == (False, b"")


def test_nothing_stays_behind_however_often_it_is_plugged_in(path: Path) -> None:
    link, before = PtyLink(str(path), "fog.port"), open_descriptors()
    for _ in range(5):
        link.open()
        link.open()
        assert path.is_symlink()
        link.close()
        link.close()
    assert open_descriptors() == before
    assert list(path.parent.iterdir()) == []


def identity(path: Path) -> tuple[int, int, int]:
    found = path.lstat()
    return found.st_ino, found.st_mode, found.st_mtime_ns


@pytest.mark.parametrize("kind", ["file", "directory", "link to a file", "link to a terminal", "broken link"])
def test_nothing_else_is_ever_overwritten(path: Path, kind: str) -> None:
    master, slave = os.openpty()
    match kind:
        case "file":
            path.write_text("precious")
        case "directory":
            path.mkdir()
        case "link to a file":
            path.symlink_to(__file__)
        case "link to a terminal":
            path.symlink_to(os.ttyname(slave))
        case "broken link":
            path.symlink_to("/nowhere/at/all")
    before = identity(path)
    with pytest.raises(ConfigError, match=r"fog\.port: expected a path where nothing is yet, got .*fog"):
        PtyLink(str(path), "fog.port")
    assert identity(path) == before
    os.close(master)
    os.close(slave)


def test_a_path_taken_after_the_check_is_not_overwritten_either(path: Path) -> None:
    link, before = PtyLink(str(path), "fog.port"), open_descriptors()
    path.write_text("precious")
    with pytest.raises(ConfigError, match=r"fog\.port"):
        link.open()
    assert path.read_text() == "precious"
    assert open_descriptors() == before


def test_the_link_of_an_emulator_that_was_killed_is_replaced(path: Path) -> None:
    path.symlink_to("/dev/pts/999999")
    with plugged(PtyLink(str(path), "fog.port")):
        assert path.exists()


def test_a_link_that_somebody_else_made_meanwhile_is_left_alone(path: Path) -> None:
    link = PtyLink(str(path), "fog.port")
    with plugged(link):
        path.unlink()
        path.write_text("new")
    assert path.read_text() == "new"


def test_missing_folders_are_made_below_the_temporary_one_only(tmp_path: Path) -> None:
    with plugged(PtyLink(str(tmp_path / "a/b/fog"), "fog.port")):
        assert (tmp_path / "a/b/fog").exists()
    for path in ("/nowhere/fog", str(tmp_path / "../../../../../nowhere/fog"), "socket://localhost:7000"):
        with pytest.raises(ConfigError, match=r"fog\.port"):
            PtyLink(path, "fog.port")
    assert not Path("/nowhere").exists()


def slcan(path: Path) -> Encoders:
    return Encoders(interface="slcan", channel=f"{path}@115200", bitrate=500_000)


def slcan_bus(path: Path, bitrate: int | None = 500_000) -> can.BusABC:
    return can.Bus(interface="slcan", channel=str(path), bitrate=bitrate, sleep_after_open=0, ignore_config=True)


def poll_until(adapter: SlcanAdapter, is_open: bool) -> list[can.Message]:
    frames, give_up = adapter.received(), time.monotonic() + 5
    while adapter.is_open is not is_open:
        assert time.monotonic() < give_up, "the command never came"
        frames += adapter.received()
    return frames


FRAMES = [
    can.Message(arbitration_id=0x181, is_extended_id=False, data=b"\x01\x02\xfe\xff"),
    can.Message(arbitration_id=0x7FF, is_extended_id=False, data=b""),
    can.Message(arbitration_id=0x1B05, is_extended_id=True, data=bytes(range(8))),
]


def test_python_can_reads_the_frames_of_the_slcan_adapter(path: Path) -> None:
    adapter = SlcanAdapter(slcan(path))
    with plugged(adapter):
        with slcan_bus(path) as bus:
            poll_until(adapter, is_open=True)
            for frame in FRAMES:
                assert adapter.send(frame)
                received = bus.recv(5)
                while received is None:  # the answer to a command
                    received = bus.recv(5)
                assert received.equals(frame, timestamp_delta=None, check_channel=False, check_direction=False)
        poll_until(adapter, is_open=False)
        assert not adapter.send(FRAMES[0])


def test_the_slcan_adapter_takes_frames_and_tells_its_version(path: Path) -> None:
    adapter = SlcanAdapter(slcan(path))
    with plugged(adapter), slcan_bus(path, bitrate=None) as bus:
        poll_until(adapter, is_open=True)
        received: list[can.Message] = []
        for frame in FRAMES:
            bus.send(frame)
        give_up = time.monotonic() + 5
        while len(received) < len(FRAMES) and time.monotonic() < give_up:
            received += adapter.received()
        for got, sent in zip(received, FRAMES, strict=True):
            assert got.equals(sent, timestamp_delta=None, check_channel=False, check_direction=False)


@pytest.mark.parametrize(
    ("lines", "answer"),
    [
        (b"V\r", b"V1013\r"),
        (b"N\r", b"N0001\r"),
        (b"C\rS6\r\rO\r", b"\r\r\r\r"),
        (b"what\r", b"\a"),
        (b"t1810\r", b"\a"),  # the channel is closed
        (b"O\rt1812AABB\r", b"\rz\r"),
        (b"L\rT000001811AA\r", b"\rZ\r"),
        (b"O\rt1812AA\rt18\rtxyz0\rt1819000000000000000000\r", b"\r\a\a\a\a"),
        (b"\xff\xfe" * 500 + b"\rV\r", b"\aV1013\r"),
    ],
)
def test_the_slcan_adapter_answers_as_the_manual_says(path: Path, lines: bytes, answer: bytes) -> None:
    adapter = SlcanAdapter(slcan(path))
    with plugged(adapter), serial.Serial(str(path), 115200, timeout=2) as host:
        host.write(lines)
        got, give_up = b"", time.monotonic() + 5
        while len(got) < len(answer) and time.monotonic() < give_up:
            adapter.received()
            got += host.read(host.in_waiting)
        assert got == answer


def test_a_command_may_arrive_in_pieces(path: Path) -> None:
    adapter = SlcanAdapter(slcan(path))
    with plugged(adapter), serial.Serial(str(path), 115200, timeout=5) as host:
        for byte in b"V\r":
            host.write(bytes([byte]))
            give_up = time.monotonic() + 0.05
            while time.monotonic() < give_up:
                adapter.received()
        assert host.read(6) == b"V1013\r"


def test_an_slcan_adapter_that_was_pulled_is_closed_when_it_comes_back(path: Path) -> None:
    adapter = SlcanAdapter(slcan(path))
    with plugged(adapter), serial.Serial(str(path), 115200) as host:
        host.write(b"O\r")
        poll_until(adapter, is_open=True)
        adapter.close()
        assert not adapter.send(FRAMES[0])
        adapter.open()
        assert not adapter.send(FRAMES[0])


def test_a_virtual_bus_carries_frames_both_ways() -> None:
    encoders = Encoders(interface="virtual", channel="endpoint test")
    end = can_endpoint(encoders)
    assert isinstance(end, BusEndpoint)
    with (
        plugged(end),
        can.Bus(interface="virtual", channel="endpoint test", ignore_config=True) as other,
    ):
        assert end.send(FRAMES[0])
        assert other.recv(1) is not None
        other.send(FRAMES[1])
        other.send(can.Message(is_remote_frame=True))
        assert [frame.arbitration_id for frame in end.received()] == [0x7FF]
        end.close()
        assert not end.send(FRAMES[0])
        assert end.received() == []


def test_real_buses_are_refused_unless_allowed_and_absent_ones_are_named(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pcan = Encoders(interface="pcan", channel="PCAN_USBBUS1")
    with pytest.raises(ConfigError, match=r"encoders\.channel: expected a virtual bus.*pcan PCAN_USBBUS1"):
        can_endpoint(pcan)
    can_endpoint(pcan, allow_real_bus=True)
    absent = can_endpoint(replace(pcan, interface="socketcan", channel="vcan999"))
    with pytest.raises(ConfigError, match=r"encoders\.channel: .*socketcan vcan999"):
        absent.open()
    monkeypatch.setattr(Path, "exists", lambda _: True)
    monkeypatch.setattr(Path, "resolve", lambda _: Path("/sys/devices/pci0000:00/net/can0"))
    with pytest.raises(ConfigError, match=r"socketcan can0, a real bus"):
        can_endpoint(Encoders())
    monkeypatch.setattr(Path, "resolve", lambda _: Path("/sys/devices/virtual/net/can0"))
    can_endpoint(Encoders())
