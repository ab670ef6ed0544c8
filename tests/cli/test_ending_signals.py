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
    assert signal.getsignal(number) is signal.SIG_DFL
    stop_on_signals()
    end_on_signals()
    assert {signal.getsignal(one) for one in ALL} == {signal.SIG_DFL}


def test_what_was_started_to_outlive_its_terminal_does() -> None:
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    assert ending_signals() == (signal.SIGINT, signal.SIGTERM)
    stop = stop_on_signals()
    end_on_signals()
    os.kill(os.getpid(), signal.SIGHUP)
    assert not stop()
