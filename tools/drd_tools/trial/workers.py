"""Run calls in worker processes, and yield their results as they become ready."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from contextlib import AbstractContextManager, nullcontext
from typing import TypeVar

from tqdm import tqdm

from drd_tools.processes import pool_of

T = TypeVar("T")
Call = Callable[[], T]


def completed(todo: Sequence[Call[T]], jobs: int, then: Callable[[T], Sequence[Call[T]]] = lambda _: ()) -> Iterator[T]:
    """Yield results as they become ready. `then`: further calls that a result gives rise to.

    SIGTERM and Ctrl-C end the workers in mid-call. Raises ConfigError if one was killed.
    """
    calls, pending = list(todo), set[Future[T]]()
    processes: AbstractContextManager[Executor | None] = nullcontext() if jobs == 1 else pool_of(jobs)
    with tqdm(total=len(calls), desc="trial", unit="case", disable=None) as bar, processes as pool:
        while calls or pending:
            results: Iterable[T]
            if pool is None:
                results = [calls.pop(0)()]
            else:
                pending |= {pool.submit(call) for call in calls}
                calls.clear()
                done, pending = wait(pending, return_when=FIRST_COMPLETED)
                results = (future.result() for future in done)
            for result in results:
                more = then(result)
                calls += more
                bar.total = (bar.total or 0) + len(more)
                bar.update()
                yield result
