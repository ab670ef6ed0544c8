"""The bus has its turn first, and whatever it raises ends in the loop's exception handler."""

import asyncio
import socket
from collections.abc import Iterator
from typing import Any

import pytest

from eps_hil.bus.eager_loop import EagerLoop


@pytest.fixture
def pair() -> Iterator[tuple[socket.socket, socket.socket]]:
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    ours.setblocking(False)
    with ours, theirs:
        yield ours, theirs


def run(job: Any) -> Any:
    with asyncio.Runner(loop_factory=EagerLoop) as runner:
        return runner.run(job)


def test_datagrams_and_everything_else_of_the_loop(
    pair: tuple[socket.socket, socket.socket],
) -> None:
    ours, theirs = pair
    seen: list[bytes] = []

    async def job() -> list[str]:
        loop = asyncio.get_running_loop()
        assert isinstance(loop, EagerLoop)
        other, peer = socket.socketpair()
        other.setblocking(False)
        loop.add_eager_reader(ours.fileno(), lambda: seen.append(ours.recv(99)))
        order: list[str] = []
        loop.add_reader(other.fileno(), lambda: order.append(f"other after {len(seen)}"))
        loop.call_later(0.01, order.append, "timer")
        theirs.send(b"one")
        peer.send(b"x")
        await asyncio.sleep(0)
        other.recv(9)
        await asyncio.sleep(0.05)
        loop.remove_reader(other.fileno())
        loop.remove_eager_reader(ours.fileno())
        loop.remove_eager_reader(ours.fileno())
        theirs.send(b"two")
        await asyncio.sleep(0.02)
        other.close()
        peer.close()
        return order

    order = run(job())
    assert seen == [b"one"]
    assert order[0] == "other after 1"
    assert order[-1] == "timer"


def test_an_error_goes_to_the_exception_handler(
    pair: tuple[socket.socket, socket.socket],
) -> None:
    ours, theirs = pair

    def broken() -> None:
        ours.recv(9)
        raise ArithmeticError("broken")

    async def job() -> BaseException:
        loop = asyncio.get_running_loop()
        assert isinstance(loop, EagerLoop)
        told: asyncio.Future[BaseException] = loop.create_future()
        loop.set_exception_handler(lambda _, context: told.set_result(context["exception"]))
        loop.add_eager_reader(ours.fileno(), broken)
        theirs.send(b"x")
        return await asyncio.wait_for(told, 5.0)

    assert isinstance(run(job()), ArithmeticError)
