"""A process that is ready to diagnose, and makes a new one of itself for every case.

    python -m eps_hil.cli._warm

reads one JSON list a line: the folder to work in, the seconds of processor time that it may take
(and at most :data:`_WALL` times as many by the clock), and the arguments of ``eps-hil``. Each is
run in a fork of this process, which has loaded the code and never sees a recording, so no case
knows of another; stdout and stderr go to files of that folder. It answers with one line: the exit
status, or null where the time was up. Loading once saves about two seconds a case. When whoever
started it is gone, it ends at once, and the case in work with it.
"""

import json
import math
import os
import resource
import signal
import sys
import time

SAID, COMPLAINED = "stdout.txt", "stderr.txt"
_LOADED = (
    "scipy.interpolate",
    "scipy.ndimage",
    "scipy.optimize",
    "jinja2",
    "eps_hil.diagnosis.diagnose",
    "eps_hil.recordings.read",
    "eps_hil.recordings.csv_file",
    "eps_hil.report.diagnosis_page",
)
_TICK_S = 0.02
_WALL = 8.0
"""Times the processor time: a machine that others use too is no reason to give up."""


def serve() -> None:
    """Work until stdin ends."""
    from importlib import import_module

    from eps_hil.cli.main import main

    parent = os.getppid()
    for name in _LOADED:
        import_module(name)
    for line in sys.stdin:
        folder, limit_s, arguments = json.loads(line)
        child = os.fork()
        if child == 0:
            _, most = resource.getrlimit(resource.RLIMIT_CPU)
            resource.setrlimit(resource.RLIMIT_CPU, (max(1, math.ceil(limit_s)), most))
            os._exit(_work(main, folder, arguments))
        answer = _ended(child, limit_s, parent)
        if os.getppid() != parent:
            return
        sys.stdout.write(json.dumps(answer) + "\n")
        sys.stdout.flush()


def _work(main: object, folder: str, arguments: list[str]) -> int:
    os.chdir(folder)
    for number, name, flags in (
        (0, os.devnull, os.O_RDONLY),
        (1, SAID, os.O_WRONLY | os.O_CREAT),
        (2, COMPLAINED, os.O_WRONLY | os.O_CREAT),
    ):
        os.dup2(os.open(name, flags, 0o644), number)
    assert callable(main)
    try:
        status = int(main(arguments))
    except BaseException as error:  # a fork must never go back into the loop above
        sys.stderr.write(f"{type(error).__name__}: {error}\n")
        status = 1
    sys.stdout.flush()
    sys.stderr.flush()
    return status


def _ended(child: int, limit_s: float, parent: int) -> int | None:
    until = time.monotonic() + _WALL * limit_s
    while time.monotonic() < until and os.getppid() == parent:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            code = os.waitstatus_to_exitcode(status)
            return None if code == -signal.SIGXCPU else code
        time.sleep(_TICK_S)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return None


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # of a Ctrl-C, whoever started it tells
    serve()
