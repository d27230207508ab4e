"""`python -m bench.slow_disk PYTHON -m drd run FILE`: the daemon with a disk that takes 1 MB/s from its recorder."""

import sys
import time
from typing import Any, Final

from drd.cli import main
from drd.recording import file

BYTES_PER_S: Final = 1e6


def _slow_down(sink: Any) -> None:
    """Make what is handed to the disk take its time; as a thread that waits in write(2) does, it lets others run."""
    flush = sink.flush

    def slowly(self: Any) -> None:
        before = self.size
        flush(self)
        time.sleep((self.size - before) / BYTES_PER_S)

    sink.flush = slowly


if __name__ == "__main__":
    _slow_down(file._Sink)
    raise SystemExit(main(sys.argv[4:]))
