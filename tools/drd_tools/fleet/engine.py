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
REACH_S: Final = 10.0  # for a scheduler to answer


class Engine(NamedTuple):
    """Place of calls: `jobs` processes here, the cluster at `scheduler`, or one of `cluster` workers."""

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
        yield from _one_by_one(call, suspects, lost)
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


def _one_by_one(call: Callable[[T], R], tasks: deque[T], lost: Callable[[T], R]) -> Iterator[tuple[T, R]]:
    kills = 0
    while tasks:
        with pool_of(1) as pool:
            try:
                while tasks:
                    result = pool.submit(call, tasks[0]).result()
                    yield tasks.popleft(), result
                    kills = 0
            except BrokenProcessPool:
                kills += 1
        if kills == KILLS:
            yield tasks[0], lost(tasks.popleft())
            kills = 0


def _distributed(
    call: Callable[[T], R], tasks: Sequence[T], lost: Callable[[T], R], engine: Engine
) -> Iterator[tuple[T, R]]:
    from distributed import KilledWorker  # noqa: PLC0415  # takes a second to load

    suspects = deque[T]()
    with ended_by_sigterm(), _client(engine) as client:
        for task, future in _submitted(client, call, deque(tasks), AHEAD):
            try:
                yield task, future.result()
            except KilledWorker:
                suspects.append(task)
        # Those that waited at a worker that was killed are blamed as well: alone, only who is to blame fails again.
        for task, future in _submitted(client, call, suspects, 0):
            try:
                result = future.result()
            except KilledWorker:
                result = lost(task)
            yield task, result


def _submitted(client: Any, call: Callable[[T], R], tasks: deque[T], ahead: int) -> Iterator[tuple[T, Any]]:
    """Futures as they are done, of so many calls for each thread of the cluster, but at least of one, at a time."""
    from distributed import as_completed  # noqa: PLC0415

    pending: dict[str, T] = {}
    running = as_completed()
    while tasks or pending:
        most = max(ahead * sum(client.nthreads().values()), 1)  # workers come and go
        while tasks and len(pending) < most:
            future = client.submit(call, tasks[0], pure=False)
            pending[future.key] = tasks.popleft()
            running.add(future)
        future = next(running)
        yield pending.pop(future.key), future


@contextmanager
def _client(engine: Engine) -> Iterator[Any]:
    """A client of the cluster; one started here ends with it."""
    import dask  # noqa: PLC0415
    from distributed import Client, LocalCluster  # noqa: PLC0415

    # Workers are not ended for their memory before the machine has to; one that is, is blamed no longer than a pool's.
    with dask.config.set({"distributed.worker.memory.terminate": False, "distributed.scheduler.allowed-failures": 1}):
        if engine.scheduler is None:
            with (
                LocalCluster(
                    n_workers=engine.cluster, threads_per_worker=1, dashboard_address="127.0.0.1:0"
                ) as cluster,
                Client(cluster) as client,
            ):
                yield client
            return
        try:
            client = Client(engine.scheduler, timeout=REACH_S)
        except (OSError, ValueError) as error:
            got = f"{type(error).__name__}: {error}"
            raise ConfigError("--scheduler", "", "the address of a running Dask scheduler", got) from error
        with client:
            yield client
