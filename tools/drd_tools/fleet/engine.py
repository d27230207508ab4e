"""Run calls in a local process pool or a Dask cluster. Calls of a killed process are repeated in another.

The calls, and so the results bit for bit, are the same; only their order differs.
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

AHEAD: Final = 2  # calls submitted per process: none waits for work, and memory stays bounded
KILLS: Final = 2  # after so many kills of a process that ran a call alone, the call is held to be the cause
REACH_S: Final = 10.0  # timeout for a scheduler's answer


class Engine(NamedTuple):
    """Where calls run: `jobs` local processes, the cluster at `scheduler`, or a new one of `cluster` workers."""

    jobs: int = 1
    scheduler: str | None = None
    cluster: int | None = None

    def results(self, call: Callable[[T], R], tasks: Sequence[T], lost: Callable[[T], R]) -> Iterator[tuple[T, R]]:
        """Yield each task with its result as it becomes ready; `lost`: result of one whose process was always killed.

        SIGTERM, Ctrl-C and any error end the processes, or withdraw the calls submitted to a cluster.
        """
        if self.scheduler is None and self.cluster is None:
            yield from _pooled(call, tasks, lost, self.jobs)
        else:
            yield from _distributed(call, tasks, lost, self)


def _pooled(call: Callable[[T], R], tasks: Sequence[T], lost: Callable[[T], R], jobs: int) -> Iterator[tuple[T, R]]:
    todo, suspects = deque(tasks), deque[T]()
    while todo or suspects:
        # The kill of one process breaks the pool: running each call alone shows which was to blame.
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
        # Calls that waited at a killed worker are blamed as well: alone, only the culprit fails again.
        for task, future in _submitted(client, call, suspects, 0):
            try:
                result = future.result()
            except KilledWorker:
                result = lost(task)
            yield task, result


def _submitted(client: Any, call: Callable[[T], R], tasks: deque[T], ahead: int) -> Iterator[tuple[T, Any]]:
    """Yield futures as they complete, with `ahead` calls per thread of the cluster, but at least one, in flight."""
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
    """Connect to the cluster, or start one, which ends with the context."""
    import dask  # noqa: PLC0415
    from distributed import Client, LocalCluster  # noqa: PLC0415

    # Only the machine may kill workers for their memory; a call is blamed for a kill as quickly as in a pool.
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
