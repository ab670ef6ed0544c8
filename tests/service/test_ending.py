"""How a run ends: asked to, by an error in a task or a callback, and with the first one only."""

import asyncio

import pytest

from eps_hil.service.ending import Ending


def test_asked_to_end_it_ends_without_an_error() -> None:
    async def run() -> None:
        ending = Ending()
        assert not ending.asked_for
        asyncio.get_running_loop().call_soon(ending.ask)
        await ending.wait(5.0)
        assert ending.asked_for
        ending.raise_failure()

    asyncio.run(run())


def test_time_that_runs_out_is_no_end() -> None:
    async def run() -> None:
        ending = Ending()
        await ending.wait(0.01)
        assert not ending.asked_for

    asyncio.run(run())


def test_the_first_error_of_a_task_or_a_callback_ends_it_and_is_raised() -> None:
    told: list[str] = []

    async def wrong() -> None:
        raise ZeroDivisionError("first")

    def later() -> None:
        raise ValueError("second")

    async def run() -> None:
        loop = asyncio.get_running_loop()
        ending = Ending(lambda error: told.append(str(error)))
        ending.watch_over(loop)
        ending.task(loop, wrong())
        await ending.wait(5.0)
        assert ending.asked_for
        loop.call_soon(later)
        await asyncio.sleep(0.01)
        assert told == ["first", "second"]
        ending.raise_failure()

    with pytest.raises(ZeroDivisionError, match="first"):
        asyncio.run(run())


def test_a_task_that_is_cancelled_is_no_error() -> None:
    async def run() -> None:
        ending = Ending()
        task = ending.task(asyncio.get_running_loop(), asyncio.sleep(10.0))
        await asyncio.sleep(0)
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        assert not ending.asked_for

    asyncio.run(run())
