"""A plugin for runs without the compiler: a test that computes too long is stopped, and skipped.

The alarm is raised in code of this project only, never inside the tool that measures coverage,
which an exception there would leave locked.
"""

import os
import signal
from collections.abc import Iterator
from types import FrameType
from typing import Any

import pytest

CALL_S = float(os.environ.get("EPS_HIL_STOP_S", "0.5"))
SETUP_S = 4 * CALL_S
_AGAIN_S = 0.01
_OURS = f"{os.sep}eps_hil{os.sep}"


class StoppedError(BaseException):
    """No Exception, which a test may expect."""


def _on_alarm(_signal: int, frame: FrameType | None) -> None:
    if frame is not None and _OURS in frame.f_code.co_filename:
        raise StoppedError
    signal.setitimer(signal.ITIMER_PROF, _AGAIN_S)


def _stopped(seconds: float) -> Iterator[Any]:
    signal.signal(signal.SIGPROF, _on_alarm)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        return (yield)
    except StoppedError:
        pytest.skip("stopped: what it ran until then counts")
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call() -> Iterator[Any]:
    """The test itself."""
    return (yield from _stopped(CALL_S))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_setup() -> Iterator[Any]:
    """Its fixtures."""
    return (yield from _stopped(SETUP_S))
