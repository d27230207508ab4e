"""A disk with a write cache that a power cut empties: a network block device (NBD) of our own, both ends of it.

What the guest has not flushed may be on the disk after the cut or not, each write by itself and any part of it: disks
and memory cards put writes off, and in another order. A flush (the kernel's answer to fsync) makes all before it last.
The machine sees an ordinary block device, /dev/nbd0.

`python volatile_disk.py FOLDER HOST PORT` serves FOLDER/disk until it is killed.
"""

import fcntl
import os
import random
import socket
import struct
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Final

# https://github.com/NetworkBlockDevice/nbd/blob/master/doc/proto.md, transmission phase; the ioctls: linux/nbd.h.
REQUEST: Final = struct.Struct(">IHH8sQI")
REPLY: Final = struct.Struct(">II8s")
REQUEST_MAGIC, REPLY_MAGIC = 0x25609513, 0x67446698
READ, WRITE, DISCONNECT, FLUSH = range(4)
SET_SOCK, SET_BLOCK_BYTES, DO_IT, SET_BLOCKS, SET_FLAGS = 0xAB00, 0xAB01, 0xAB03, 0xAB07, 0xAB0A
HAS_FLAGS, SEND_FLUSH = 1, 4
BLOCK_BYTES: Final = 4096
# What a disk writes whole or not at all.
SECTOR_BYTES: Final = 512
# Durable content; what the machine sees; writes since the last flush; counts of writes, their bytes and flushes.
DISK, SEEN, UNFLUSHED, COUNTS = "disk", "seen", "unflushed", "counts"
WRITE_HEAD: Final = struct.Struct(">QI")


def serve(folder: Path, address: tuple[str, int]) -> None:
    """Serve `folder`/disk to one machine."""
    (folder / SEEN).write_bytes((folder / DISK).read_bytes())
    (folder / UNFLUSHED).write_bytes(b"")
    with (
        socket.create_server(address) as server,
        (folder / SEEN).open("r+b", buffering=0) as seen,
        (folder / UNFLUSHED).open("ab", buffering=0) as unflushed,
        server.accept()[0] as connection,
    ):
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        counts = [0, 0, 0]
        while True:
            magic, _, kind, cookie, offset, length = REQUEST.unpack(received(connection, REQUEST.size))
            assert magic == REQUEST_MAGIC
            answer = b""
            if kind == DISCONNECT:
                return
            if kind == READ:
                answer = os.pread(seen.fileno(), length, offset)
            elif kind == WRITE:
                data = received(connection, length)
                unflushed.write(WRITE_HEAD.pack(offset, length) + data)
                os.pwrite(seen.fileno(), data, offset)
                counts[0], counts[1] = counts[0] + 1, counts[1] + length
            elif kind == FLUSH:
                apply(folder / DISK, writes(folder / UNFLUSHED))
                unflushed.truncate(0)
                counts[2] += 1
                (folder / COUNTS).write_text(" ".join(map(str, counts)))
            connection.sendall(REPLY.pack(REPLY_MAGIC, 0, cookie) + answer)


def received(connection: socket.socket, length: int) -> bytes:
    """So many bytes; the process ends where the machine does."""
    data = bytearray()
    while len(data) < length:
        part = connection.recv(length - len(data))
        if not part:
            sys.exit()
        data += part
    return bytes(data)


def writes(file: Path) -> Iterator[tuple[int, bytes]]:
    """Offset and data of each; one that was cut off while it was logged is left out."""
    log, at = file.read_bytes(), 0
    while at + WRITE_HEAD.size <= len(log):
        offset, length = WRITE_HEAD.unpack_from(log, at)
        at += WRITE_HEAD.size + length
        if at <= len(log):
            yield offset, log[at - length : at]


def apply(disk: Path, these: Iterator[tuple[int, bytes]]) -> None:
    """Write them onto the disk."""
    with disk.open("r+b") as stream:
        for offset, data in these:
            stream.seek(offset)
            stream.write(data)


def some_of(these: Iterator[tuple[int, bytes]], share: float, chance: random.Random) -> Iterator[tuple[int, bytes]]:
    """What a power cut leaves of them: each with that probability, and a tenth of these torn at a sector."""
    for offset, data in these:
        if chance.random() < share:
            sectors = len(data) // SECTOR_BYTES
            kept = chance.randrange(sectors + 1) if chance.random() < 0.1 else sectors
            yield offset, data[: kept * SECTOR_BYTES]


def connect(address: tuple[str, int], size_bytes: int) -> None:
    """In the guest: be the client of /dev/nbd0, until the machine ends."""
    connection = socket.create_connection(address)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    device = os.open("/dev/nbd0", os.O_RDWR)
    for number, argument in (
        (SET_BLOCK_BYTES, BLOCK_BYTES),
        (SET_BLOCKS, size_bytes // BLOCK_BYTES),
        (SET_FLAGS, HAS_FLAGS | SEND_FLUSH),
        (SET_SOCK, connection.fileno()),
        (DO_IT, 0),
    ):
        fcntl.ioctl(device, number, argument)


if __name__ == "__main__":
    serve(Path(sys.argv[1]), (sys.argv[2], int(sys.argv[3])))
