"""Worker processes of the diagnosis, which end with the command that started them."""

import multiprocessing
import operator
import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import partial
from typing import Any, Final, Protocol, TypeVar

from tqdm import tqdm

from drd.config.schema import ConfigError

S = TypeVar("S")
T = TypeVar("T")

THREADS: Final = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


class Map(Protocol):
    """The built-in `map`, or that of a process pool."""

    def __call__(self, function: Callable[[S], T], items: Iterable[S], /) -> Iterable[T]:
        """The results of the function, in the order of the items."""
        ...


@contextmanager
def pool_of(jobs: int) -> Iterator[ProcessPoolExecutor]:
    """Provide a pool of `jobs` processes. SIGTERM, Ctrl-C and any error end them, even during a call.

    Raises ConfigError if one was killed.
    """
    # The processes share the cores; a library that uses all of them for one product slows the others down.
    for name in THREADS:
        os.environ.setdefault(name, "1")
    with ended_by_sigterm():
        # A forked child of a process with threads may deadlock.
        pool = ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn"), _as_worker)
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
def mapped(jobs: int, at_once: int = 1) -> Iterator[Map]:
    """Provide the `map` of `jobs` processes, which work ahead, on `at_once` items each; if 1, the built-in one."""
    if jobs == 1:
        yield map
        return
    with pool_of(jobs) as pool:
        yield partial(pool.map, chunksize=at_once)


def called(calls: Sequence[Callable[[], T]], jobs: int, at_once: int = 1) -> Iterator[T]:
    """Results of calls, in order, from `jobs` processes that take `at_once` calls at a time; if 1, from this one."""
    with mapped(jobs, at_once) as each:
        yield from each(operator.call, calls)


@contextmanager
def ended_by_sigterm() -> Iterator[None]:
    """Let SIGTERM raise SystemExit, so that resources are closed."""
    can_handle = threading.current_thread() is threading.main_thread()
    before = signal.signal(signal.SIGTERM, _end) if can_handle else None
    try:
        yield
    finally:
        if can_handle:
            signal.signal(signal.SIGTERM, before)


def _end(number: int, _: Any) -> None:
    raise SystemExit(128 + number)


def _as_worker() -> None:
    """Let the parent answer Ctrl-C, which goes to all of a terminal's processes.

    A progress bar's lock between processes would be reported as leaked when the worker is ended.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    tqdm.set_lock(threading.RLock())
