"""Tasks that run for ever: started and stopped one by one, and the end of any is noticed."""

import asyncio

import pytest

from drd.service.tasks import Tasks


def test_a_task_that_fails_is_noticed_with_its_exception() -> None:
    async def fail() -> None:
        await asyncio.sleep(0)
        raise RuntimeError("a bug")

    async def main() -> None:
        tasks = Tasks()
        tasks.start(asyncio.sleep(3600.0))
        tasks.start(fail())
        with pytest.raises(RuntimeError, match="a bug"):
            await asyncio.wait_for(tasks.ended, 10.0)
        await tasks.cancel()
        assert len(asyncio.all_tasks()) == 1

    asyncio.run(main())


def test_cancelling_some_leaves_the_others_and_is_no_end() -> None:
    async def main() -> None:
        tasks = Tasks()
        first, second = (tasks.start(asyncio.sleep(3600.0)) for _ in range(2))
        await tasks.cancel([first])
        await asyncio.sleep(0)
        assert first.cancelled()
        assert not second.done()
        assert not tasks.ended.done()
        await tasks.cancel()
        assert second.cancelled()

    asyncio.run(main())


def test_a_task_that_simply_ends_is_noticed_too() -> None:
    async def main() -> None:
        tasks = Tasks()
        tasks.start(asyncio.sleep(0))
        await asyncio.wait_for(tasks.ended, 10.0)

    asyncio.run(main())
