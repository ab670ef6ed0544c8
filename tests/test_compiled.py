"""Where compiled functions are kept: the user's cache, else a private folder, else nowhere."""

import contextlib
import fcntl
import importlib
import json
import os
import pkgutil
import py_compile
import shutil
import signal
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any, get_args, get_origin

import numba
import numpy as np
import numpy.typing as npt
import pytest
from numba.core.caching import FunctionCache

from eps_hil import compiled, estimation
from eps_hil.compiled import kernel
from eps_hil.physics import effects

SOURCES = Path(__file__).parents[1] / "eps_hil"
NOWHERE = "/proc/eps_hil"  # not even root makes a folder there
PROGRAM = """
import json, numba
import eps_hil.compiled as c
from eps_hil.kernel import bare, dressed
print(json.dumps({"folder": str(c.FOLDER), "sums": [bare(2.0), dressed(2.0)],
                  "numba": numba.config.CACHE_DIR}))
"""
KERNEL = """
from eps_hil.compiled import njit

@njit
def bare(x):
    return x + 1.0

@njit(error_model="numpy")
def dressed(x):
    return x + 2.0
"""


@pytest.fixture
def read_only_install(tmp_path: Path) -> Path:
    """The module as it is, in a package that nothing can be compiled beside, not even by root."""
    package = tmp_path / "site" / "eps_hil"
    package.mkdir(parents=True)
    for name in ("__init__.py", "compiled.py", "within.py"):
        shutil.copy(SOURCES / name, package / name)
    (package / "kernel.py").write_text(KERNEL)
    (package / "__pycache__").write_text("a file where numba wants a folder")
    (tmp_path / f"eps_hil-{os.getuid()}").write_text("a file where the private folder would be")
    return package.parent


@pytest.mark.parametrize(
    "first", ["eps_hil.compiled", pytest.param("eps_hil.kernel", marks=pytest.mark.slow)]
)
def test_two_changes_within_a_second_leave_no_stale_machine_code(
    read_only_install: Path, tmp_path: Path, first: str
) -> None:
    """Python takes the first one's bytecode for the second's: as long, and of the same second."""
    package, moment_ns = read_only_install / "eps_hil", 1_700_000_000_100_000_000
    (package / "__pycache__").unlink()
    source = package / "kernel.py"
    source.write_text(KERNEL.replace("x + 1.0", "x + 9.0"))
    os.utime(source, ns=(moment_ns, moment_ns))
    kept = package / "__pycache__" / f"kernel.{sys.implementation.cache_tag}.pyc"
    py_compile.compile(str(source), cfile=str(kept), doraise=True)
    os.utime(kept, ns=(moment_ns + 200_000_000,) * 2)
    source.write_text(KERNEL)
    os.utime(source, ns=(moment_ns + 600_000_000,) * 2)
    if first == "eps_hil.kernel":  # Python runs its stale bytecode once, as of any module
        asked = f"import {first}; print({first}.bare(2.0))"
        place = {"HOME": str(tmp_path), "PYTHONPATH": str(read_only_install)}
        words = [sys.executable, "-c", asked]
        run = subprocess.run(
            words, env=place, cwd=tmp_path, capture_output=True, text=True, check=False
        )
        assert run.returncode == 0, run.stderr
        assert float(run.stdout) == 11.0, "the bytecode was not stale: nothing is tested"
    said_by(read_only_install, HOME=str(tmp_path))  # asserts the sums of the text as it is


def said_by(site: Path, **environment: str) -> dict[str, object]:
    kept = {name: os.environ[name] for name in ("PATH", "LANG") if name in os.environ}
    nowhere = {"HOME": NOWHERE, "TMPDIR": str(site.parent), "PYTHONPATH": str(site)}
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], env=kept | nowhere | environment, cwd=site.parent,
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    answer: dict[str, object] = json.loads(done.stdout)
    assert answer["sums"] == [3.0, 4.0]
    return answer


def test_where_the_users_cache_can_be_written(read_only_install: Path, tmp_path: Path) -> None:
    said = said_by(read_only_install, HOME=str(tmp_path))
    folder = Path(str(said["folder"]))
    assert folder.is_relative_to(tmp_path / ".cache" / "eps_hil" / "compiled")
    assert len(list(folder.rglob("*.nbi"))) == 2
    assert said["numba"] == ""  # other users of numba in the process keep their folder


@pytest.mark.parametrize("kept", [True, False])
@pytest.mark.slow
def test_at_a_terminal_it_says_once_why_it_takes_so_long(
    read_only_install: Path, tmp_path: Path, kept: bool
) -> None:
    environment = os.environ | {"HOME": str(tmp_path), "PYTHONPATH": str(read_only_install)}
    environment.pop("NUMBA_CACHE_DIR", None)
    environment.pop("XDG_CACHE_HOME", None)
    if not kept:
        environment |= {"HOME": NOWHERE, "TMPDIR": str(read_only_install.parent)}

    def told() -> bytes:
        ours, theirs = os.openpty()
        subprocess.run(
            [sys.executable, "-c", PROGRAM], env=environment, cwd=read_only_install, check=True,
            stdout=subprocess.DEVNULL, stderr=theirs,
        )  # fmt: skip
        os.close(theirs)
        with contextlib.suppress(OSError):  # Linux: nobody writes there any more
            return os.read(ours, 4096)
        return b""

    when = b"once: some seconds, or minutes" if kept else b"each time"
    for again in (False, True):
        said = told()
        assert said.count(b"compiling") == said.count(when) == (0 if again and kept else 1)


@pytest.mark.slow
def test_another_install_of_the_same_source_compiles_nothing(
    read_only_install: Path, tmp_path: Path
) -> None:
    said = said_by(read_only_install, HOME=str(tmp_path))
    kept = Path(str(said["folder"]))
    before = {path: path.stat().st_mtime_ns for path in kept.rglob("*.nb?")}
    assert len(before) == 4  # an index and its code, of each function
    other = tmp_path / "other" / "site"
    shutil.copytree(read_only_install, other)
    (other / "eps_hil" / "kernel.py").touch()  # as a checkout does
    assert said_by(other, HOME=str(tmp_path))["folder"] == said["folder"]
    assert {path: path.stat().st_mtime_ns for path in kept.rglob("*.nb?")} == before
    (other / "eps_hil" / "kernel.py").write_text(KERNEL.replace("2.0", "1.0 + 1.0"))
    changed = said_by(other, HOME=str(tmp_path))
    assert changed["folder"] != said["folder"]


CLOSURES = """
from eps_hil.compiled import njit

@njit
def first(x):
    return x + 1.0

def through(before, k):
    def one(x):
        return 2.0 * before(x) + k
    return njit(one)

a, b = (through(through(first, 1), k) for k in (10.0, 100.0))
"""


@pytest.mark.slow
def test_what_a_closure_holds_names_its_code_for_the_next_process(
    read_only_install: Path, tmp_path: Path
) -> None:
    """Two of one name and signature, each its own, whoever compiled it; nobody does it again."""
    (read_only_install / "eps_hil" / "closures.py").write_text(CLOSURES)
    kept = []
    for names in ("a", "b", "ab", "ba"):
        calls = ", ".join(f"{name}(0.5)" for name in names)
        call = f"from eps_hil.closures import a, b; print({calls})"
        done = subprocess.run(
            [sys.executable, "-B", "-c", call],
            cwd=tmp_path, capture_output=True, text=True, check=True,
            env={**os.environ, "PYTHONPATH": str(read_only_install),
                 "NUMBA_CACHE_DIR": str(tmp_path / "kept")},
        )  # fmt: skip
        right = {"a": 18.0, "b": 108.0}
        assert [float(one) for one in done.stdout.split()] == [right[name] for name in names]
        kept.append(len(list((tmp_path / "kept").rglob("*.nbc"))))
    assert kept == [3, 4, 4, 4]


@pytest.mark.slow
def test_numbas_own_folder_comes_first(read_only_install: Path, tmp_path: Path) -> None:
    said = said_by(read_only_install, NUMBA_CACHE_DIR=str(tmp_path / "n"), HOME=str(tmp_path))
    assert Path(str(said["folder"])).is_relative_to(tmp_path / "n")


def test_a_private_folder_where_the_home_is_read_only(
    read_only_install: Path, tmp_path: Path
) -> None:
    temporary = tmp_path / "tmp"
    temporary.mkdir()
    said = said_by(read_only_install, TMPDIR=str(temporary))
    private = temporary / f"eps_hil-{os.getuid()}"
    assert Path(str(said["folder"])).is_relative_to(private)
    assert private.stat().st_mode & 0o777 == 0o700


def test_no_folder_that_others_could_have_written_to(
    read_only_install: Path, tmp_path: Path
) -> None:
    private = tmp_path / f"eps_hil-{os.getuid()}"
    private.unlink()
    private.mkdir()
    private.chmod(0o777)
    assert said_by(read_only_install, TMPDIR=str(tmp_path))["folder"] == "None"
    assert not list(private.iterdir())


@pytest.mark.slow
def test_it_compiles_where_nothing_can_be_written(read_only_install: Path) -> None:
    assert said_by(read_only_install)["folder"] == "None"


@pytest.mark.slow
def test_numba_that_finds_no_folder_compiles_anew(read_only_install: Path, tmp_path: Path) -> None:
    """As where sources and cache are read-only and numba does not ask for our locator."""
    package = read_only_install / "eps_hil"
    text = (package / "compiled.py").read_text()
    refuses = 'raise RuntimeError("cannot cache function: no locator available")'
    (package / "compiled.py").write_text(
        text.replace(
            "        if FOLDER is None:\n", f"        {refuses}\n        if FOLDER is None:\n"
        )
    )
    said = said_by(read_only_install, HOME=str(tmp_path))
    assert not list(Path(str(said["folder"])).rglob("*.nbi"))


COUNTED = """
import os, sys, time
import eps_hil.compiled
from numba.core import event
from eps_hil.kernel import dressed

class Slow(event.Listener):  # as long as a kernel takes
    def on_start(self, started):
        print("compiles", flush=True)
        time.sleep(2.0)
    def on_end(self, ended):
        if "fails" in sys.argv: raise ValueError

if "behind" in sys.argv: os.nice(5)
event.register("numba:compile", Slow())
try:
    assert dressed(2.0) == 4.0
except ValueError:
    time.sleep(60.0)
print("done")
"""


def started(site: Path, home: Path, *words: str) -> "subprocess.Popen[str]":
    return subprocess.Popen(
        [sys.executable, "-c", COUNTED, *words], stdout=subprocess.PIPE, text=True, cwd=home,
        env={"PATH": os.environ["PATH"], "HOME": str(home), "PYTHONPATH": str(site)},
    )  # fmt: skip


@pytest.mark.slow
def test_of_processes_that_start_together_one_compiles(
    read_only_install: Path, tmp_path: Path
) -> None:
    together = [started(read_only_install, tmp_path) for _ in range(3)]
    said = [one.communicate(timeout=120)[0] for one in together]
    assert sorted(said) == ["compiles\ndone\n", "done\n", "done\n"]


@pytest.mark.slow
def test_who_is_killed_or_fails_while_it_compiles_keeps_nobody_waiting(
    read_only_install: Path, tmp_path: Path
) -> None:
    killed = started(read_only_install, tmp_path)
    failed = started(read_only_install, tmp_path, "fails")
    with killed, failed:
        assert killed.stdout is not None
        assert killed.stdout.readline() == "compiles\n"
        killed.kill()
        assert failed.stdout is not None
        assert failed.stdout.readline() == "compiles\n"
        with started(read_only_install, tmp_path) as last:
            assert last.communicate(timeout=60)[0] == "compiles\ndone\n"
        failed.kill()


@pytest.mark.slow
def test_nobody_waits_for_a_process_in_the_background(
    read_only_install: Path, tmp_path: Path
) -> None:
    with started(read_only_install, tmp_path, "behind") as behind:
        assert behind.stdout is not None
        assert behind.stdout.readline() == "compiles\n"
        behind.send_signal(signal.SIGSTOP)
        with started(read_only_install, tmp_path) as other:
            try:
                assert other.communicate(timeout=60)[0] == "compiles\ndone\n"
            finally:
                other.kill()
                behind.kill()


@pytest.mark.slow
def test_processes_that_are_as_nice_wait_for_each_other(
    read_only_install: Path, tmp_path: Path
) -> None:
    together = [started(read_only_install, tmp_path, "behind") for _ in range(2)]
    said = [one.communicate(timeout=120)[0] for one in together]
    assert sorted(said) == ["compiles\ndone\n", "done\n"]


def test_code_goes_to_disk_one_process_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """numba numbers its files by what it read before: two at once would name different code."""
    saved: list[object] = []
    monkeypatch.setattr(FunctionCache, "load_overload", lambda *_: None)
    monkeypatch.setattr(FunctionCache, "save_overload", lambda *given: saved.append(given))

    @kernel
    def eighth(value: float) -> float:
        return 0.125 * value

    place: Path = vars(eighth)["_cache"]._place
    place.parent.mkdir(parents=True, exist_ok=True)
    saves = threading.Thread(target=eighth, args=(16.0,))
    with place.with_name(f"{place.name}.save").open("wb") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        saves.start()
        saves.join(3.0)
        assert saves.is_alive()
        assert not saved
    saves.join(60.0)
    assert not saves.is_alive()
    assert len(saved) == 1


def test_only_who_wants_it_for_the_same_types_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(FunctionCache, "load_overload", lambda *_: None)
    monkeypatch.setattr(FunctionCache, "save_overload", lambda *_: None)

    @kernel
    def fourth(value: float) -> float:
        return 0.25 * value

    place: Path = vars(fourth)["_cache"]._place
    place.parent.mkdir(parents=True, exist_ok=True)
    waits = threading.Thread(target=fourth, args=(16.0,))
    name = f"{place.name}.{compiled._types((numba.float64,))}"
    with place.with_name(name).open("wb") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        other = threading.Thread(target=fourth, args=(16,))
        other.start()
        other.join(60.0)
        assert not other.is_alive()
        waits.start()
        waits.join(0.5)
        assert waits.is_alive()
    waits.join(60.0)
    assert not waits.is_alive()


@pytest.mark.parametrize("logs_too", [False, True])
def test_who_waits_for_another_process_says_so_once(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    logs_too: bool,
) -> None:
    monkeypatch.setattr(compiled, "_LATE_S", 0.05)
    monkeypatch.setattr(compiled, "_logs_too", [True] if logs_too else [])
    monkeypatch.setattr(compiled, "_waited_s", [0.0])
    compiled._tell.cache_clear()
    with (tmp_path / "lock").open("wb") as held:
        fcntl.flock(held, fcntl.LOCK_EX)  # as of another process: an open file of its own
        letting_go = threading.Timer(0.4, fcntl.flock, (held, fcntl.LOCK_UN))
        letting_go.start()
        compiled._locked(tmp_path / "lock").close()
        letting_go.join()
    compiled._tell.cache_clear()
    said = "waiting for code that another process compiles\n" if logs_too else ""
    assert capsys.readouterr().err == said


def owns(kind: Any) -> bool:
    """Whether a value of this type holds an array."""
    inside = (*get_args(kind), *getattr(kind, "__annotations__", {}).values())
    return get_origin(kind) is np.ndarray or any(owns(each) for each in inside)


def test_a_kernel_returns_no_array() -> None:
    """Nobody counts references there, so nobody would own what it returns."""
    assert owns(tuple[int, npt.NDArray[np.float64]])
    seen = 0
    for package in (estimation, effects):
        for found in pkgutil.iter_modules(package.__path__, f"{package.__name__}."):
            module = importlib.import_module(found.name)
            for name, function in vars(module).items():
                if getattr(function, "targetoptions", {}).get("_nrt") is False:
                    returned = function.py_func.__annotations__["return"]
                    assert not owns(returned), f"{found.name}.{name}"
                    seen += 1
    assert seen > 60


def test_a_kernel_makes_no_array() -> None:
    @kernel
    def made(n: int) -> float:
        return float(np.zeros(n)[0])

    with pytest.raises(numba.core.errors.TypingError, match="zeros"):
        made(3)
