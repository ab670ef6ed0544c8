"""The first estimate after installation waits for no compiler; what waits for it says so."""

import os
import pickle
import subprocess
import sys
import threading
from collections import defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NoReturn
from unittest.mock import Mock

import numpy as np
import pytest
from numba.core import event

from eps_hil import compiled
from eps_hil.cli import _first_answer
from eps_hil.cli.main import main
from eps_hil.compiled import COMPILING
from eps_hil.diagnosis.balance.problem import _since_reversal
from eps_hil.fleet import workers
from eps_hil.recordings.write import write_table

CONFIGS = Path(__file__).parents[2] / "configs"
LIVE = str(CONFIGS / "calibrate_udp.yaml")
GOLDEN, RECORDING = "eps_hil.oracle.golden", "eps_hil.dashboard.recording"
WARM_UP = "eps_hil.dashboard.listener.Listener.warm_up"
MODEL = str(CONFIGS / "reference_rig.yaml")
PROGRAM = """
import subprocess, sys
started = []
subprocess.Popen = lambda words, **_: started.append(words)  # what would compile meanwhile
from eps_hil.cli.main import main
status = main(sys.argv[1:])
from eps_hil.compiled import interpreted
print(status, interpreted(), [words[-1] for words in started])
"""


def test_it_is_interpreted_and_the_same(tmp_path: Path) -> None:
    n = 1_500
    t = np.arange(n) * 1e-3
    speed = 12.0 * np.sin(2 * np.pi * t)
    noise = np.random.default_rng(7).normal(0, 1e-2, (3, n))
    columns = {
        "motor_torque_nm": 0.2 * np.sin(2 * np.pi * t) + noise[0],
        "motor_speed_rad_s": speed + 10 * noise[1],
        "motor_angle_rad": np.cumsum(speed) * 1e-3 + 0.1 * noise[2],
    }
    drive = tmp_path / "drive.csv"
    write_table(drive, columns, t_ns=np.arange(n, dtype=np.int64) * 1_000_000)
    words = ["estimate", str(drive), "--model", MODEL, "--out"]
    cold = os.environ | {"XDG_CACHE_HOME": str(tmp_path / "cold"), "NUMBA_CACHE_DIR": ""}
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, *words, str(tmp_path / "first.csv")],
        env=cold, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert done.stdout.splitlines()[-1] == "0 True ['eps_hil.estimation.ahead']"
    assert main([*words, str(tmp_path / "later.csv")]) == 0
    assert (tmp_path / "first.csv").read_bytes() == (tmp_path / "later.csv").read_bytes()


@pytest.mark.parametrize(
    "folder",
    ["functions/estimation/lanes", "estimation_0f3a"],
    ids=["by our locator", "by numba's own, before 0.62"],
)
def test_what_is_compiled_already_is_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, folder: str
) -> None:
    monkeypatch.setattr(compiled, "FOLDER", tmp_path)
    place = tmp_path / folder
    place.mkdir(parents=True)
    (place / "lanes.merge-395.py311.nbi").write_bytes(b"Nothing")
    assert not _first_answer._is_compiled(effects=False)
    (place / "lanes.run-369.py311.nbi").write_bytes(b"a record, Nothing, an array")
    assert _first_answer._is_compiled(effects=False)
    assert not _first_answer._is_compiled(effects=True)


class Clock:
    """Time in which nothing happens but what the test does; timers go off as it passes."""

    def __init__(self) -> None:
        self.now = 0.0
        self.timers: list[tuple[float, Timer]] = []

    def sleep(self, seconds: float) -> None:
        self.now += seconds
        due = [timer for when, timer in self.timers if when <= self.now]
        self.timers = [(when, timer) for when, timer in self.timers if when > self.now]
        for timer in due:
            if not timer.finished.is_set():  # nobody cancelled it
                timer.function()


class Timer(threading.Timer):
    clock: Clock

    def start(self) -> None:
        self.clock.timers.append((self.clock.now + self.interval, self))


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Iterator[Clock]:
    """The clock of what listens, which is gone afterwards."""
    clock = Clock()
    monkeypatch.setattr(Timer, "clock", clock, raising=False)
    monkeypatch.setattr(threading, "Timer", Timer)
    monkeypatch.setattr(_first_answer, "time", SimpleNamespace(monotonic=lambda: clock.now))
    monkeypatch.setattr(event, "_registered", defaultdict(list))
    monkeypatch.setattr(_first_answer, "LATE_S", LATE_S)
    _first_answer.say_if_it_compiles.cache_clear()
    yield clock
    _first_answer.say_if_it_compiles.cache_clear()


LATE_S = 0.25
"""Seconds of compiling after which a process says so."""


def _compile(clock: Clock, seconds: float, within: float = 0.0) -> None:
    """As numba tells of a kernel, and of one that it calls."""
    with event.trigger_event("numba:compile", data={}):
        if within:
            _compile(clock, within)
        clock.sleep(seconds)


@pytest.mark.parametrize(
    ("kernels", "lines"),
    [
        ([(0.5, 0.0)], 1),
        ([(0.0625, 0.0)] * 3, 0),
        ([(0.0625, 0.0)] * 6, 1),  # none of them takes long
        ([(0.0, 0.5), (0.5, 0.0)], 1),
    ],
)
def test_a_process_that_compiles_for_long_says_so_once(
    clock: Clock,
    capsys: pytest.CaptureFixture[str],
    kernels: list[tuple[float, float]],
    lines: int,
) -> None:
    _first_answer.say_if_it_compiles()
    for seconds, within in kernels:
        _compile(clock, seconds, within)
        clock.sleep(LATE_S)  # in which nothing is compiled
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err == f"{COMPILING}\n" * lines


def test_it_is_said_while_it_compiles(clock: Clock, capsys: pytest.CaptureFixture[str]) -> None:
    _first_answer.say_if_it_compiles()
    with event.trigger_event("numba:compile", data={}):
        clock.sleep(0.2)
        assert capsys.readouterr().err == ""
        clock.sleep(0.2)
        assert capsys.readouterr().err == f"{COMPILING}\n"


def test_a_compilation_that_ends_as_the_time_is_up_is_said(
    clock: Clock, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The timer was cancelled a moment before, and no later one was set: nobody was told."""
    monkeypatch.setattr(Timer, "start", lambda self: None)  # as if each were late
    _first_answer.say_if_it_compiles()
    for _ in range(2):
        _compile(clock, LATE_S)
    assert capsys.readouterr().err == f"{COMPILING}\n"


@pytest.mark.parametrize(
    ("words", "works"),
    [
        (("rig", "--config", str(CONFIGS / "demo_udp.yaml")), "eps_hil.rig.process.Rig"),
        (("run", "--config", str(CONFIGS / "demo_udp.yaml")), "eps_hil.service.setup.prepare"),
        (("diagnose", "--model", MODEL, "--recording"), "eps_hil.diagnose"),
        (("estimate", "--model", MODEL), "eps_hil.estimate"),
        (("identify", "--model", MODEL), "eps_hil.identify"),
        (("calibrate", "reversals", "--model", MODEL), "eps_hil.adaptation.offline.adapt"),
        (
            ("calibrate", "error-injection", "--config", LIVE),
            "eps_hil.service.online_methods.warm_up_error_injection",
        ),
        (
            ("calibrate", "torque-injection", "--dry-run", "--config", LIVE),
            "eps_hil.service.override_setup.prepare_override",
        ),
        (
            ("investigate", "--config", LIVE, "--budget", "1min", "--out", "found"),
            "eps_hil.investigate.run.prepared_menu",
        ),
        (("dashboard", "DRIVE", "--port", "0", "--config", LIVE), f"{RECORDING}.store_of"),
        (("golden", "make", "DRIVE", "--out", "g.csv", "--config", LIVE), f"{GOLDEN}.run_core"),
        (
            ("prove", "loop", "DRIVE", "--with", MODEL, "--config", LIVE),
            "eps_hil.oracle.lock_step.compare",
        ),
    ],
)
def test_verbs_that_compile_say_so(
    clock: Clock,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    words: tuple[str, ...],
    works: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    drive = tmp_path / "drive.csv"
    write_table(drive, {"motor_torque_nm": np.zeros(9)}, t_ns=np.arange(9) * 1_000_000)

    def compiles(*_: object, **__: object) -> NoReturn:
        _compile(clock, 0.5)
        raise OSError(5, "enough")

    monkeypatch.setattr(works, compiles)
    words = tuple(str(drive) if word == "DRIVE" else word for word in words)
    assert main([*words, *([] if "--config" in words else [str(drive)])]) == 1
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.splitlines()[0] == COMPILING
    assert said.err.count("\n") == 2


def test_golden_check_and_a_proof_say_that_they_compile(
    clock: Clock,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def compiles(*_: object) -> NoReturn:
        _compile(clock, 0.5)
        raise OSError(5, "enough")

    kept = SimpleNamespace(log=tmp_path, config=tmp_path, files={"log": "a"})
    golden = SimpleNamespace(provenance=kept, tolerances={})
    monkeypatch.setattr("eps_hil.oracle.golden_file.read_golden", lambda _: golden)
    for name, found in (("load_pair", None), ("hashes", {"log": "a"}), ("parse_tolerances", {})):
        monkeypatch.setattr(f"{GOLDEN}.{name}", lambda *_, found=found: found)
    monkeypatch.setattr(f"{GOLDEN}.run_core", compiles)
    assert main(["golden", "check", "g.csv"]) == 1
    assert capsys.readouterr().err.splitlines()[0] == COMPILING

    _first_answer.say_if_it_compiles.cache_clear()
    event._registered.clear()
    monkeypatch.setattr("eps_hil.axis.emps.read", lambda _: (None, None))
    monkeypatch.setattr("eps_hil.axis.proof.prove", compiles)
    assert main(["prove", "emps", str(tmp_path)]) == 1
    assert capsys.readouterr().err.splitlines()[0] == COMPILING


def test_monitor_says_that_it_compiles(
    clock: Clock, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def compiles(_: object) -> NoReturn:
        _compile(clock, 0.5)
        raise OSError(5, "enough")

    monkeypatch.setattr("eps_hil.monitor.view_model.warm_up", compiles)
    assert main(["monitor", "--config", LIVE, "--json"]) == 1
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.splitlines()[:2] == ["monitor: loading", COMPILING]


def test_each_worker_of_a_batch_listens(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drive = tmp_path / "drive.csv"
    write_table(drive, {"motor_torque_nm": np.zeros(9)}, t_ns=np.arange(9) * 1_000_000)
    begun: list[Callable[[], None]] = []

    def here(_job: object, _todo: object, _processes: object, begin: Callable[[], None]) -> None:
        begun.append(pickle.loads(pickle.dumps(begin)))  # on its way to a worker
        raise OSError(5, "enough")

    monkeypatch.setattr(workers, "here", here)
    words = ["batch", "estimate", str(tmp_path), "--model", MODEL, "--out", str(tmp_path / "out")]
    assert main(words) == 1
    assert begun == [_first_answer.say_if_it_compiles]
    called: list[str] = []
    workers._end_with_parent(lambda: called.append("begun"))
    assert called == ["begun"]


@pytest.mark.parametrize(
    ("words", "kernel", "works"),
    [
        (("stream", "--config", LIVE), _since_reversal, WARM_UP),
        (("dashboard", "--config", LIVE, "--port", "0"), _since_reversal, WARM_UP),
        (("prove", "concealed", "--out", "out"), _since_reversal, "eps_hil.proof.run.run"),
        (
            ("prove", "changes", "--out", "out"),
            _since_reversal,
            "eps_hil.proof.changed.prove_changes",
        ),
    ],
)
def test_verbs_say_that_other_processes_compile(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    words: tuple[str, ...],
    kernel: Any,
    works: str,
) -> None:
    def ends(*_: object, **__: object) -> NoReturn:
        raise OSError(5, "enough")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(works, ends)
    monkeypatch.setattr("eps_hil.monitor.process.open_watched", lambda *_: None)
    monkeypatch.setattr("eps_hil.dashboard.listener.stand_back", lambda: None)
    monkeypatch.setattr("eps_hil.cli._bus_options.stop_on_signals", lambda: bool)
    monkeypatch.setattr("multiprocessing.get_context", lambda _: Mock())
    monkeypatch.setattr(compiled, "FOLDER", tmp_path)
    assert main(list(words)) == 1
    assert capsys.readouterr().err.count(COMPILING) == 1
    place = Path(kernel.py_func.__code__.co_filename).stem
    (tmp_path / f"{place}.{kernel.py_func.__name__}-1.py311.nbi").touch()
    assert main(list(words)) == 1
    assert COMPILING not in capsys.readouterr().err
