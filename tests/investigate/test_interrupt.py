"""A signal ends ``eps-hil investigate`` at once, but lets go of a rig that it leads."""

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from eps_hil.cli.investigate import _Stop
from eps_hil.investigate.run import InterruptedInvestigationError, Investigation

from .bench import written

ENDING = signal.SIGINT, signal.SIGTERM, signal.SIGHUP
PROGRAM = """
import sys, time
from eps_hil.cli.main import main
from eps_hil.investigate import run
def compiles(*_):
    print("compiles", flush=True)
    end = time.monotonic() + 60
    while time.monotonic() < end: time.sleep(1)
run.prepared_menu = compiles
main(sys.argv[1:])
"""


@pytest.fixture(autouse=True)
def usual_handlers() -> Iterator[None]:
    before = {number: signal.getsignal(number) for number in ENDING}
    signal.signal(signal.SIGHUP, signal.SIG_DFL)  # ignored where the tests run under nohup
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.parametrize(
    "number", [ENDING[0], *(pytest.param(one, marks=pytest.mark.slow) for one in ENDING[1:])]
)
def test_one_signal_ends_it_while_it_compiles(tmp_path: Path, number: signal.Signals) -> None:
    """The compiler goes on after a handler: only the signal's own effect ends it."""
    words = ["investigate", "--config", str(written(tmp_path)), "--budget", "1min", "--out", "out"]
    program = [sys.executable, "-c", PROGRAM, *words]
    with subprocess.Popen(program, stdout=subprocess.PIPE, text=True, cwd=tmp_path) as process:
        try:
            assert process.stdout is not None
            assert "compiles\n" in iter(process.stdout.readline, "")
            process.send_signal(number)
            assert process.wait(timeout=10) == -number
        finally:
            process.kill()


@pytest.mark.parametrize("number", ENDING)
def test_a_rig_that_is_led_is_let_go_of_first(number: signal.Signals) -> None:
    let_go: list[object] = []

    rig: Any = "rig"

    @contextlib.contextmanager
    def opened(_: Callable[[], bool]) -> Iterator[Any]:
        yield rig
        let_go.append(signal.getsignal(number))

    stop = _Stop()
    assert signal.getsignal(number) is signal.SIG_DFL
    with stop.while_led(opened)(stop) as led:
        assert led is rig
        assert not stop()
        os.kill(os.getpid(), number)
        assert stop()
    assert len(let_go) == 1
    assert all(signal.getsignal(one) is signal.SIG_DFL for one in ENDING)
    assert stop(), "what is still asked for after the experiment"


def test_asked_to_stop_at_an_experiments_end_it_diagnoses_nothing() -> None:
    class Journal:
        folder = "out"

        def steps(self) -> list[object]:
            return []

        def rounds(self) -> list[object]:
            return []

    nothing: Any = None
    journal: Any = Journal()
    run = Investigation(nothing, nothing, journal, nothing)
    with pytest.raises(InterruptedInvestigationError, match="kept in out, call again to go on"):
        run.run(60.0, lambda: True)
