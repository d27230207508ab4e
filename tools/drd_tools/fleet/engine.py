"""Calls in other processes: a pool of this machine, or a Dask cluster. What a killed process had is done elsewhere.

The calls, and so the results to the bit, are the same; only their order differs.
"""

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import Any, Final, NamedTuple, TypeVar

from drd.config.schema import ConfigError
from drd_tools.processes import ended_by_sigterm, pool_of

T = TypeVar("T")
R = TypeVar("R")

AHEAD: Final = 2  # calls for each process that are handed over: none waits for the next, and memory stays bounded
KILLS: Final = 2  # of the process that had a call for itself: the call is then taken for the cause


class Engine(NamedTuple):
    """Where calls are done: in `jobs` processes here, on the cluster at `scheduler`, or on one of `cluster` workers."""

    jobs: int = 1
    scheduler: str | None = None
    cluster: int | None = None

    def results(self, call: Callable[[T], R], tasks: Sequence[T], lost: Callable[[T], R]) -> Iterator[tuple[T, R]]:
        """Each task with its result as soon as it is there; `lost`: of one whose processes were killed each time.

        SIGTERM, Ctrl-C and any error end the processes, or take back what was handed to a cluster.
        """
        if self.scheduler is None and self.cluster is None:
            yield from _pooled(call, tasks, lost, self.jobs)
        else:
            yield from _distributed(call, tasks, lost, self)


def _pooled(call: Callable[[T], R], tasks: Sequence[T], lost: Callable[[T], R], jobs: int) -> Iterator[tuple[T, R]]:
    todo, suspects = deque(tasks), deque[T]()
    while todo or suspects:
        # The kill of one process breaks the pool: which call was to blame shows when each is alone in one.
        while suspects:
            task = suspects.popleft()
            yield task, _alone(call, task, lost)
        pending: dict[Future[R], T] = {}
        with pool_of(min(jobs, max(len(todo), 1))) as pool:
            try:
                while todo or pending:
                    while todo and len(pending) < AHEAD * jobs:
                        pending[pool.submit(call, todo[0])] = todo[0]
                        todo.popleft()
                    for future in wait(pending, return_when=FIRST_COMPLETED).done:
                        result = future.result()
                        yield pending.pop(future), result
            except BrokenProcessPool:
                suspects.extend(task for future, task in pending.items() if not _is_done(future))
                finished = [(task, future.result()) for future, task in pending.items() if _is_done(future)]
                pending.clear()
                yield from finished


def _is_done(future: Future[Any]) -> bool:
    return future.done() and not future.cancelled() and future.exception() is None


def _alone(call: Callable[[T], R], task: T, lost: Callable[[T], R]) -> R:
    for _ in range(KILLS):
        with pool_of(1) as pool:
            try:
                return pool.submit(call, task).result()
            except BrokenProcessPool:
                continue
    return lost(task)


def _distributed(
    call: Callable[[T], R], tasks: Sequence[T], lost: Callable[[T], R], engine: Engine
) -> Iterator[tuple[T, R]]:
    from distributed import KilledWorker, as_completed  # noqa: PLC0415  # takes a second to load

    with ended_by_sigterm(), _client(engine) as client:
        todo, pending = deque(tasks), {}
        running = as_completed()
        while todo or pending:
            threads = max(sum(client.nthreads().values()), 1)  # workers come and go
            while todo and len(pending) < AHEAD * threads:
                future = client.submit(call, todo[0], pure=False)
                pending[future.key] = todo.popleft()
                running.add(future)
            future = next(running)
            task = pending.pop(future.key)
            try:
                result = future.result()
            except KilledWorker:
                result = lost(task)
            yield task, result


@contextmanager
def _client(engine: Engine) -> Iterator[Any]:
    """A client of the cluster; one started here ends with it."""
    import dask  # noqa: PLC0415
    from distributed import Client, LocalCluster  # noqa: PLC0415

    # Recordings take what they take: workers are not ended for their memory before the machine has to.
    with dask.config.set({"distributed.worker.memory.terminate": False}):
        if engine.scheduler is None:
            with (
                LocalCluster(n_workers=engine.cluster, threads_per_worker=1, dashboard_address=None) as cluster,
                Client(cluster) as client,
            ):
                yield client
            return
        try:
            client = Client(engine.scheduler, timeout="10s")
        except (OSError, ValueError) as error:
            got = f"{type(error).__name__}: {error}"
            raise ConfigError("--scheduler", "", "the address of a running Dask scheduler", got) from error
        with client:
            yield client
