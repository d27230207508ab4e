"""Processes that diagnose, which end with the command that began them."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import Any, Final

from drd.config.schema import ConfigError

THREADS: Final = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@contextmanager
def pool_of(jobs: int) -> Iterator[ProcessPoolExecutor]:
    """A pool of so many processes. SIGTERM, Ctrl-C and any error end them in the midst of their calls.

    Raises ConfigError where one was killed.
    """
    # The processes share the cores; a library that takes all of them for one product only gets in the others' way.
    for name in THREADS:
        os.environ.setdefault(name, "1")
    with ended_by_sigterm():
        # A forked child of a process with threads may lock up.
        pool = ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn"), _leave_to_parent)
        try:
            yield pool
        except BaseException as error:
            for worker in multiprocessing.active_children():
                worker.terminate()
            if isinstance(error, BrokenProcessPool):
                got = "a process that was killed: with --jobs 1 each has all of the memory"
                raise ConfigError("--jobs", "", "memory for so many diagnoses", got) from error
            raise
        finally:
            pool.shutdown(cancel_futures=True)


@contextmanager
def ended_by_sigterm() -> Iterator[None]:
    """SIGTERM raises SystemExit, so that what is in use is closed."""
    can_handle = threading.current_thread() is threading.main_thread()
    before = signal.signal(signal.SIGTERM, _end) if can_handle else None
    try:
        yield
    finally:
        if can_handle:
            signal.signal(signal.SIGTERM, before)


def _end(number: int, _: Any) -> None:
    raise SystemExit(128 + number)


def _leave_to_parent() -> None:
    """Let the parent answer Ctrl-C, which goes to all of a terminal's processes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
