"""What a power cut leaves of the disk that the virtual machine's power is cut with."""

import random
import socket
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from vm import volatile_disk as disk

SIZE = 4 * disk.BLOCK_BYTES


class Client:
    """The kernel's side of the connection."""

    def __init__(self, folder: Path):
        with socket.create_server(("127.0.0.1", 0)) as free:
            address = free.getsockname()
        (folder / disk.DISK).write_bytes(bytes(SIZE))
        self.thread = threading.Thread(target=disk.serve, args=(folder, address))
        self.thread.start()
        while True:
            try:
                self.socket = socket.create_connection(address)
                return
            except ConnectionRefusedError:
                assert self.thread.is_alive()

    def ask(self, kind: int, offset: int = 0, data: bytes = b"", length: int = 0) -> bytes:
        self.socket.sendall(disk.REQUEST.pack(disk.REQUEST_MAGIC, 0, kind, b"cookie 1", offset, length or len(data)))
        self.socket.sendall(data)
        head = disk.received(self.socket, disk.REPLY.size)
        assert disk.REPLY.unpack(head) == (disk.REPLY_MAGIC, 0, b"cookie 1")
        return disk.received(self.socket, length)


@pytest.fixture
def client(tmp_path: Path) -> Iterator[Client]:
    made = Client(tmp_path)
    yield made
    made.socket.sendall(disk.REQUEST.pack(disk.REQUEST_MAGIC, 0, disk.DISCONNECT, b"cookie 2", 0, 0))
    made.socket.close()
    made.thread.join()


def test_only_what_was_flushed_is_sure_and_all_is_seen(tmp_path: Path, client: Client) -> None:
    client.ask(disk.WRITE, 0, b"a" * 4096)
    client.ask(disk.FLUSH)
    client.ask(disk.WRITE, 4096, b"b" * 8192)
    client.ask(disk.WRITE, 0, b"c" * 512)
    assert client.ask(disk.READ, 0, length=8192) == b"c" * 512 + b"a" * 3584 + b"b" * 4096
    file = tmp_path / disk.DISK
    assert file.read_bytes() == b"a" * 4096 + bytes(SIZE - 4096)
    unflushed = list(disk.writes(tmp_path / disk.UNFLUSHED))
    assert [(offset, len(data)) for offset, data in unflushed] == [(4096, 8192), (0, 512)]
    disk.apply(file, iter(unflushed))
    assert file.read_bytes() == (tmp_path / disk.SEEN).read_bytes()


def test_a_write_that_was_cut_off_while_it_was_noted_is_left_out(tmp_path: Path) -> None:
    whole = disk.WRITE_HEAD.pack(0, 2) + b"xy"
    for cut in range(1, len(whole)):
        (tmp_path / "log").write_bytes(whole + whole[:cut])
        assert list(disk.writes(tmp_path / "log")) == [(0, b"xy")]


def test_a_cut_keeps_some_writes_and_tears_some_at_a_sector() -> None:
    these = [(i * 4096, bytes([i]) * 4096) for i in range(200)]
    assert list(disk.some_of(iter(these), 0.0, random.Random(1))) == []
    kept = list(disk.some_of(iter(these), 0.5, random.Random(1)))
    assert 60 < len(kept) < 140
    torn = [data for _, data in kept if len(data) < 4096]
    assert 0 < len(torn) < 40
    assert all(len(data) % disk.SECTOR_BYTES == 0 for data in torn)
