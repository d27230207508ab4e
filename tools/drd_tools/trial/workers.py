"""Calls in processes of their own, and their results as they are ready."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, wait
from typing import TypeVar

from tqdm import tqdm

from drd_tools.processes import pool_of

T = TypeVar("T")
Call = Callable[[], T]


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
    with pool_of(jobs) as pool:
        pending = {pool.submit(call) for call in todo}
        while pending:
            done, pending = wait(pending, return_when=FIRST_COMPLETED)
            for future in done:
                result = future.result()
                more = then(result)
                pending |= {pool.submit(call) for call in more}
                yield result, len(more)
