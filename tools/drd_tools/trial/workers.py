"""Calls in processes of their own, which end with the command that began them."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import Any, Final, TypeVar

from tqdm import tqdm

from drd.config.schema import ConfigError

T = TypeVar("T")
Call = Callable[[], T]

THREADS: Final = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def completed(todo: Sequence[Call[T]], jobs: int, then: Callable[[T], Sequence[Call[T]]] = lambda _: ()) -> Iterator[T]:
    """Results as they are ready. `then`: what a result gives to do besides.

    SIGTERM and Ctrl-C end the workers in the midst of their calls. Raises ConfigError where one was killed.
    """
    with tqdm(total=len(todo), desc="trial", unit="case", disable=None) as bar:
        for result, more in _each(list(todo), jobs, then):
            bar.total = (bar.total or 0) + more
            bar.update()
            yield result


def _each(todo: list[Call[T]], jobs: int, then: Callable[[T], Sequence[Call[T]]]) -> Iterator[tuple[T, int]]:
    if jobs == 1:
        while todo:
            result = todo.pop(0)()
            more = then(result)
            todo += more
            yield result, len(more)
        return
    with _pool(jobs) as pool:
        pending = {pool.submit(call) for call in todo}
        while pending:
            done, pending = wait(pending, return_when=FIRST_COMPLETED)
            for future in done:
                result = future.result()
                more = then(result)
                pending |= {pool.submit(call) for call in more}
                yield result, len(more)


@contextmanager
def _pool(jobs: int) -> Iterator[ProcessPoolExecutor]:
    # The processes share the cores; a library that takes all of them for one product only gets in the others' way.
    for name in THREADS:
        os.environ.setdefault(name, "1")
    can_handle = threading.current_thread() is threading.main_thread()
    before = signal.signal(signal.SIGTERM, _end) if can_handle else None
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
        if can_handle:
            signal.signal(signal.SIGTERM, before)


def _end(number: int, _: Any) -> None:
    raise SystemExit(128 + number)


def _leave_to_parent() -> None:
    """Let the parent answer Ctrl-C, which goes to all of a terminal's processes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
