"""Endpoints to which the daemon connects: pseudo-terminals with stable names, an SLCAN adapter on one, CAN buses."""

import os
import tempfile
import tty
from pathlib import Path
from typing import Any, Final

import can

from drd.config.keys import Encoders
from drd.config.schema import ConfigError

READ_BYTES: Final = 4096
# Longer than any SLCAN line (T + 8 + 1 + 16 digits); longer ones are no commands.
LINE_BYTES: Final = 64
RECEIVED_FRAMES: Final = 1000


class PtyLink:
    """A raw pseudo-terminal whose other side is linked at `path`, like the serial port of a device.

    It keeps the other side open, so that a daemon may come and go; closing hangs up, like unplugging.
    Raises ConfigError, which names `key`, if `path` is taken or cannot be made.
    """

    def __init__(self, path: str, key: str):
        self._key = key
        if "://" in path:
            raise self._refusal("a path that a link can be made at", path)
        self.path = Path(path)
        self._master: int | None = None
        self._slave: int | None = None
        self._claim()

    def open(self) -> None:
        """Make the pseudo-terminal and its link, unless it is open."""
        if self._master is not None:
            return
        self._claim()
        self._master, self._slave = os.openpty()
        try:
            tty.setraw(self._slave)
            os.set_blocking(self._master, False)
            self.path.symlink_to(self.device)
        except OSError as error:
            self.close()
            raise self._refusal("a path that a link can be made at", f"{self.path}: {error.strerror}") from error

    def close(self) -> None:
        """Hang up and remove the link."""
        if self._master is None or self._slave is None:
            return
        if self.path.is_symlink() and str(self.path.readlink()) == self.device:
            self.path.unlink()
        os.close(self._slave)
        os.close(self._master)
        self._master = self._slave = None

    @property
    def device(self) -> str:
        """Name of the pseudo-terminal to which the link points."""
        return "unplugged" if self._slave is None else os.ttyname(self._slave)

    def write(self, data: bytes) -> bool:
        """Send without waiting; return False if data was lost because nobody reads or it is unplugged."""
        if self._master is None:
            return False
        try:
            return os.write(self._master, data) == len(data)
        except BlockingIOError:
            return False

    def read(self) -> bytes:
        """Read what the other side has written since; may be empty. Never waits."""
        if self._master is None:
            return b""
        try:
            return os.read(self._master, READ_BYTES)
        except BlockingIOError:
            return b""

    def _claim(self) -> None:
        """Check that the link can be made: the path is free, or a stale link of an emulator, which is removed."""
        expected = "a path where nothing is yet"
        if self.path.is_symlink():
            target = self.path.readlink()
            if target.parent != Path("/dev/pts") or target.exists():
                raise self._refusal(expected, f"{self.path}, a link to {target}")
            self.path.unlink()
        elif self.path.exists():
            raise self._refusal(expected, f"{self.path}, which exists")
        parent = self.path.absolute().parent.resolve()
        if parent.is_dir():
            return
        homes = [tempfile.gettempdir(), os.environ.get("XDG_RUNTIME_DIR")]
        if not any(home and parent.is_relative_to(Path(home).resolve()) for home in homes):
            raise self._refusal("a path in a directory that exists", str(self.path))
        parent.mkdir(parents=True)

    def _refusal(self, expected: str, got: str) -> ConfigError:
        return ConfigError("emulator", self._key, expected, got)


class SlcanAdapter:
    """A serial CAN adapter that speaks SLCAN (Lawicel CAN232 manual): frames flow while its channel is open."""

    def __init__(self, encoders: Encoders):
        self._pty = PtyLink(encoders.channel.partition("@")[0], "encoders.channel")
        self._line = bytearray()
        self.is_open = False

    def open(self) -> None:
        """Plug in; the channel is closed until the host opens it."""
        self._pty.open()

    def close(self) -> None:
        """Unplug."""
        self.is_open = False
        self._line.clear()
        self._pty.close()

    @property
    def place(self) -> str:
        """Link and pseudo-terminal."""
        return f"{self._pty.path} -> {self._pty.device}"

    def send(self, message: can.Message) -> bool:
        """Send a frame to the host; return False if it was lost or the channel is closed."""
        if not self.is_open:
            return False
        kind, digits = ("T", 8) if message.is_extended_id else ("t", 3)
        line = f"{kind}{message.arbitration_id:0{digits}X}{message.dlc}{message.data.hex().upper()}\r"
        return self._pty.write(line.encode())

    def received(self) -> list[can.Message]:
        """Answer the host's commands; return the frames that it sent."""
        frames = []
        for byte in self._pty.read():
            if byte != ord("\r"):
                self._line.append(byte)
                continue
            line, self._line = self._line.decode("latin-1"), bytearray()
            answer, frame = self._obey(line)
            self._pty.write(answer)
            if frame is not None:
                frames.append(frame)
        del self._line[:-LINE_BYTES]
        return frames

    def _obey(self, line: str) -> tuple[bytes, can.Message | None]:
        """Answer to a command, and the frame that it transmits, if any."""
        command = line[:1]
        if command in {"O", "L", "C"}:
            self.is_open = command != "C"
        elif command == "V":
            return b"V1013\r", None
        elif command == "N":
            return b"N0001\r", None
        elif command in {"t", "T"}:
            frame = _frame_of(line) if self.is_open else None
            return (b"\a", None) if frame is None else ((b"z\r" if command == "t" else b"Z\r"), frame)
        elif command not in {"", "S", "s", "Z", "M", "m"}:
            return b"\a", None
        return b"\r", None


class BusEndpoint:
    """A node on a bus supported by python-can: socketcan, virtual (within this process) and others."""

    def __init__(self, encoders: Encoders, allow_real_bus: bool):
        self._encoders = encoders
        self._bus: can.BusABC | None = None
        if not allow_real_bus and encoders.interface != "virtual":
            # The kernel lists virtual interfaces apart from devices; frames on a real bus may move a robot.
            interface = Path("/sys/class/net", encoders.channel)
            if encoders.interface != "socketcan" or (interface.exists() and "virtual" not in interface.resolve().parts):
                got = f"{encoders.interface} {encoders.channel}, a real bus"
                raise ConfigError("emulator", "encoders.channel", "a virtual bus, unless real ones are allowed", got)

    @property
    def place(self) -> str:
        """Interface and channel."""
        return f"{self._encoders.interface} {self._encoders.channel}"

    def open(self) -> None:
        """Join the bus, unless already joined."""
        if self._bus is not None:
            return
        e = self._encoders
        bitrate: dict[str, Any] = {}
        if e.bitrate is not None and e.interface != "socketcan":
            bitrate["bitrate"] = e.bitrate
        try:
            self._bus = can.Bus(channel=e.channel, interface=e.interface, ignore_config=True, **bitrate)
        except (can.CanError, OSError, ValueError) as error:
            got = f"{self.place}: {error}"
            raise ConfigError("emulator", "encoders.channel", "a CAN bus that can be opened", got) from error

    def close(self) -> None:
        """Leave the bus."""
        bus, self._bus = self._bus, None
        if bus is not None:
            bus.shutdown()

    def send(self, message: can.Message) -> bool:
        """Send a frame."""
        if self._bus is None:
            return False
        try:
            self._bus.send(message)
        except can.CanError:
            return False
        return True

    def received(self) -> list[can.Message]:
        """Data frames received from others."""
        frames: list[can.Message] = []
        try:
            while self._bus is not None and len(frames) < RECEIVED_FRAMES:
                message = self._bus.recv(0)
                if message is None:
                    break
                if not (message.is_error_frame or message.is_remote_frame):
                    frames.append(message)
        except can.CanError:
            pass  # the interface is down; losses are counted when sending
        return frames


def can_endpoint(encoders: Encoders, allow_real_bus: bool = False) -> SlcanAdapter | BusEndpoint:
    """Make the endpoint to which the configured daemon listens. Raises ConfigError."""
    if encoders.interface == "slcan":
        return SlcanAdapter(encoders)
    return BusEndpoint(encoders, allow_real_bus)


def _frame_of(line: str) -> can.Message | None:
    digits = 8 if line[0] == "T" else 3
    try:
        data = bytes.fromhex(line[digits + 2 :])
        if len(data) != int(line[digits + 1]):
            return None
        return can.Message(
            arbitration_id=int(line[1 : digits + 1], 16), is_extended_id=digits == 8, data=data, check=True
        )
    except (ValueError, IndexError):
        return None
