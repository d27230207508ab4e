"""Bytes in equal portions at equal times, from a process of its own: a fast gyro, or a bus that is full."""

import os
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from bench.listener import ENVIRONMENT


@contextmanager
def feeding(fd: int, portions: Sequence[bytes], per_s: float) -> Iterator[None]:
    """Write the portions, all of one size, over and over to `fd`; what it does not take is lost."""
    command = [sys.executable, "-m", "bench.feed", str(fd), str(len(portions[0])), str(per_s)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, env=ENVIRONMENT, pass_fds=(fd,)) as process:
        assert process.stdin is not None
        process.stdin.write(b"".join(portions))
        process.stdin.close()
        try:
            yield
        finally:
            process.kill()


def _main(fd: str, size: str, per_s: str) -> None:
    data = sys.stdin.buffer.read()
    portions = [data[i : i + int(size)] for i in range(0, len(data), int(size))]
    start_s = time.monotonic()
    sent = 0
    while True:
        for _ in range(sent, int((time.monotonic() - start_s) * float(per_s))):
            try:
                os.write(int(fd), portions[sent % len(portions)])
            except BlockingIOError:
                pass
            except OSError:  # it was unplugged
                return
            sent += 1
        time.sleep(1.0 / float(per_s))


if __name__ == "__main__":
    _main(*sys.argv[1:])
