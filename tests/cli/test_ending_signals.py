"""Which signals end a verb, in good order or at once."""

import os
import signal
from collections.abc import Iterator

import pytest

from eps_hil.cli._bus_options import end_on_signals, ending_signals, stop_on_signals

ALL = signal.SIGINT, signal.SIGTERM, signal.SIGHUP


@pytest.fixture(autouse=True)
def usual_handlers() -> Iterator[None]:
    before = {number: signal.getsignal(number) for number in ALL}
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.parametrize("number", ALL)
def test_each_asks_to_stop_and_a_second_one_ends(number: signal.Signals) -> None:
    stop = stop_on_signals()
    assert not stop()
    os.kill(os.getpid(), number)
    assert stop()
    if number != signal.SIGHUP:
        assert signal.getsignal(number) is signal.SIG_DFL
    stop_on_signals()
    end_on_signals()
    assert {signal.getsignal(one) for one in ALL} == {signal.SIG_DFL}


def test_a_lost_terminal_sends_two_and_the_second_ends_nothing() -> None:
    """The shell sends its jobs one and the kernel another: a rig was left at speed, unreleased."""
    stop = stop_on_signals()
    for _ in range(2):
        assert signal.getsignal(signal.SIGHUP) not in (signal.SIG_DFL, signal.SIG_IGN)
        os.kill(os.getpid(), signal.SIGHUP)
        assert stop()


def test_what_was_started_to_outlive_its_terminal_does() -> None:
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    assert ending_signals() == (signal.SIGINT, signal.SIGTERM)
    stop = stop_on_signals()
    end_on_signals()
    os.kill(os.getpid(), signal.SIGHUP)
    assert not stop()
