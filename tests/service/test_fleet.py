"""A fleet: each rig's process is heard, watched, and started anew when it dies; none disturbs."""

import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from eps_hil.service.fleet import Fleet, Rig

SPEAKS = """
import os, socket, sys, time
def tell(text):
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as line:
        line.sendto(text, os.environ["NOTIFY_SOCKET"])
print("begins", os.getpid())
tell(b"READY=1")
"""
STEADY = SPEAKS + "while True: tell(b'WATCHDOG=1'); time.sleep(0.05)"
HANGS = SPEAKS + "time.sleep(60)"
DIES = SPEAKS + "sys.exit(1)"
WRONG = "import sys; print('c.yaml: wrong', file=sys.stderr); sys.exit(2)"
DONE = "print('done')"


def rig(name: str, script: str) -> Rig:
    return Rig(name, (sys.executable, "-c", script))


class Bench:
    def __init__(self, *rigs: Rig, watchdog_s: float = 5.0) -> None:
        self.said: list[str] = []
        self.fleet = Fleet(rigs, self.said.append, watchdog_s=watchdog_s)
        self.ready = 0
        self.status = -1

    def count(self, line: str) -> int:
        return sum(line in said for said in self.said)

    def until(self, line: str, times: int) -> None:
        """Run until a line was said so often, 30 s at most."""
        until_s = time.monotonic() + 30.0
        self.status = self.fleet.run(
            lambda: self.count(line) >= times or time.monotonic() > until_s, self.on_ready
        )

    def on_ready(self) -> None:
        self.ready += 1


def test_one_that_dies_is_started_anew_and_the_other_goes_on() -> None:
    bench = Bench(rig("good", STEADY), rig("bad", DIES))
    bench.until("[bad] begins", 2)
    assert bench.fleet.starts == {"good": 1, "bad": 2}
    assert bench.count("[bad] ended with status 1; started anew in 1 s") >= 1
    assert bench.ready == 1
    assert bench.count("[good] begins") == 1


@pytest.mark.slow
def test_one_that_gives_no_sign_of_life_is_killed_and_started_anew() -> None:
    bench = Bench(rig("good", STEADY), rig("stuck", HANGS), watchdog_s=1.0)
    bench.until("[stuck] begins", 2)
    assert bench.count("[stuck] no sign of life for 1 s; killed") == 1
    assert bench.count("[stuck] ended with status -9") == 1
    assert bench.fleet.starts["good"] == 1


@pytest.mark.slow
def test_what_was_logged_before_it_died_is_not_written_over(tmp_path: Path) -> None:
    log = tmp_path / "e-bad.csv"
    script = SPEAKS + "open(sys.argv[1], 'w').write(str(os.getpid())); sys.exit(1)"
    bench = Bench(Rig("bad", (sys.executable, "-c", script, str(log)), log))
    bench.until("[bad] begins", 3)
    numbers = [said.split()[-1] for said in bench.said if "begins" in said]
    assert log.read_text() == numbers[0]
    assert (tmp_path / "e-bad_0002.csv").read_text() == numbers[1]


def test_wrong_input_is_not_tried_again_and_gives_the_status() -> None:
    bench = Bench(rig("a", DONE), rig("b", WRONG))
    bench.until("never", 1)
    assert bench.status == 2
    assert bench.fleet.starts == {"a": 1, "b": 1}
    assert "[a] done" in bench.said
    assert "[b] c.yaml: wrong" in bench.said
    assert "[b] ended with status 2" in bench.said


def test_a_fleet_that_is_killed_leaves_no_process_behind(tmp_path: Path) -> None:
    script = tmp_path / "fleet.py"
    script.write_text(
        "import sys\nfrom eps_hil.service.fleet import Fleet, Rig\n"
        f"Fleet([Rig('x', (sys.executable, '-c', {STEADY!r}))],"
        " lambda line: print(line, flush=True)).run(lambda: False)\n"
    )
    with subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, text=True) as run:
        assert run.stdout is not None
        number = int(run.stdout.readline().split()[-1])
        run.send_signal(signal.SIGKILL)
    until_s = time.monotonic() + 10.0
    while _lives(number) and time.monotonic() < until_s:
        time.sleep(0.05)
    assert not _lives(number)


def test_stopping_ends_all_in_order() -> None:
    bench = Bench(rig("a", STEADY), rig("b", STEADY))
    stop = threading.Event()
    threading.Timer(1.0, stop.set).start()
    start_s = time.monotonic()
    status = bench.fleet.run(stop.is_set)
    assert time.monotonic() - start_s < 8.0  # both heed SIGTERM; nobody has to be killed
    assert status == 0  # SIGTERM was asked for, also of who does not heed it yet


def _lives(number: int) -> bool:
    try:
        state = Path(f"/proc/{number}/stat").read_text().rpartition(")")[2].split()[0]
    except FileNotFoundError:
        return False
    return state != "Z"
