"""Coroutines that run for ever, started and stopped individually; the end of any is noticed."""

import asyncio
from collections.abc import Coroutine, Sequence
from typing import Any


class Tasks:
    """Tasks of the running loop. `ended` is done once one has ended on its own, with its exception if any."""

    def __init__(self) -> None:
        self.ended: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._running: set[asyncio.Task[None]] = set()

    def start(self, work: Coroutine[Any, Any, None]) -> asyncio.Task[None]:
        """Run a coroutine as a task."""
        task = asyncio.create_task(work)
        self._running.add(task)
        task.add_done_callback(self._on_end)
        return task

    async def cancel(self, tasks: Sequence[asyncio.Task[None]] | None = None) -> None:
        """Cancel these tasks, or all of them, and wait until they have ended."""
        tasks = list(self._running) if tasks is None else tasks
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    def _on_end(self, task: asyncio.Task[None]) -> None:
        self._running.discard(task)
        if task.cancelled() or self.ended.done():
            return
        if (error := task.exception()) is not None:
            self.ended.set_exception(error)
        else:
            self.ended.set_result(None)
