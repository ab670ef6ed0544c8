"""What is done beside the estimates: after answers, or by itself, whatever goes wrong."""

import asyncio

from eps_hil.service.periodic_jobs import PeriodicJobs

PERIOD_S = 0.02


def test_a_job_waits_for_an_answer_and_no_longer_than_a_period() -> None:
    async def told() -> tuple[list[str], list[str], list[str]]:
        said: list[str] = []
        jobs = PeriodicJobs(said.append)
        done: list[str] = []
        task = asyncio.create_task(jobs.between("verdict", PERIOD_S, lambda: done.append("told")))
        await asyncio.sleep(1.5 * PERIOD_S)
        waited = list(done)
        jobs.answered()
        jobs.answered()
        answered = list(done)
        await asyncio.sleep(4 * PERIOD_S)  # nobody answers any more
        task.cancel()
        return waited, answered, list(done)

    waited, answered, silent = asyncio.run(told())
    assert waited == []
    assert answered == ["told"]
    assert len(silent) >= 3


def test_what_fails_after_an_answer_is_said_once_and_survived() -> None:
    said: list[str] = []
    jobs = PeriodicJobs(said.append)

    def broken() -> None:
        raise OSError("no room")

    async def fail_twice() -> None:
        task = asyncio.create_task(jobs.between("verdict", 0.001, broken))
        for _ in range(2):
            await asyncio.sleep(0.02)
            jobs.answered()
        task.cancel()

    asyncio.run(fail_twice())
    assert jobs.failures["verdict"] >= 2
    assert len(said) == 1
    assert "verdict" in said[0]


def test_a_job_that_fails_as_it_ends_is_not_begun_again() -> None:
    """Nobody would end it a second time, and the service would wait for it for ever."""
    begun, said = [0], list[str]()

    async def job() -> None:
        begun[0] += 1
        try:
            await asyncio.sleep(60.0)
        finally:
            raise OSError("no room")

    async def ended() -> None:
        task = asyncio.create_task(PeriodicJobs(said.append).keep("levels", job))
        await asyncio.sleep(0.01)
        task.cancel()
        await asyncio.wait_for(asyncio.gather(task, return_exceptions=True), 0.5)

    asyncio.run(ended())
    assert begun == [1]
    assert len(said) == 1
