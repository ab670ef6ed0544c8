"""Where compiled functions are kept: the user's cache, else a private folder, else nowhere."""

import contextlib
import importlib
import json
import os
import pkgutil
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, get_args, get_origin

import numba
import numpy as np
import numpy.typing as npt
import pytest

from eps_hil import estimation
from eps_hil.compiled import kernel, njit
from eps_hil.physics import effects

SOURCES = Path(__file__).parents[1] / "eps_hil"
MECHANISM = ("__init__.py", "compiled.py", "machine_code.py", "sources.py")
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
    for name in MECHANISM:
        shutil.copy(SOURCES / name, package / name)
    (package / "kernel.py").write_text(KERNEL)
    (package / "__pycache__").write_text("a file where numba wants a folder")
    (tmp_path / f"eps_hil-{os.getuid()}").write_text("a file where the private folder would be")
    return package.parent


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

    when = b"once after installation" if kept else b"each time"
    for again in (False, True):
        said = told()
        assert said.count(b"compiling") == said.count(when) == (0 if again and kept else 1)


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
    said_by(other, HOME=str(tmp_path))
    assert len(list(kept.rglob("*.nb?"))) == 2 * len(before)


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


def test_it_compiles_where_nothing_can_be_written(read_only_install: Path) -> None:
    assert said_by(read_only_install)["folder"] == "None"


def test_what_has_no_source_is_compiled_and_not_kept() -> None:
    made: dict[str, Any] = {}
    exec(compile("def f(x):\n    return x + 1.0\n", "<nowhere>", "exec"), made)
    assert njit(made["f"])(2.0) == 3.0


EDITED = """
import importlib, json, os, sys, traceback
import numba
from numba.core import event

compiled = []
class Seen(event.Listener):
    def on_start(self, started):
        compiled.append(started.data["dispatcher"].py_func.__name__)
    def on_end(self, ended): pass
numba.njit(lambda x: x + 1.0)(1.0)  # what every process begins with, once for all
event.register("numba:compile", Seen())
for line in sys.stdin:  # a site: answer as a process of its own that begins here
    if not os.fork():
        site = line.strip()
        os.environ["HOME"] = os.path.dirname(site)
        sys.path.insert(0, site)
        try:
            from eps_hil.use import answers
            print(json.dumps([answers(), sorted(set(compiled))]), flush=True)
        except BaseException:
            print(json.dumps([traceback.format_exc(), []]), flush=True)
        os._exit(0)
    os.wait()
"""
PACKAGE = {
    "kernel.py": KERNEL,
    "numbers.py": "GAIN = 2.0\nUNUSED = 1.0\n",
    "deep.py": """
from eps_hil.compiled import kernel, njit
from eps_hil.numbers import GAIN

@kernel
def deep(x):
    return GAIN * x
""",
    "middle.py": """
from eps_hil import deep
from eps_hil.compiled import kernel, njit

@kernel
def middle(x):
    return deep.deep(x) + 1.0
""",
    "alone.py": """
from eps_hil.compiled import njit

@njit
def alone(x):
    return 10.0 * x
""",
    "made.py": """
from eps_hil.compiled import kernel, njit

def made(function, by):
    def calls(x):
        return function(x) + by
    calls.__qualname__ = calls.__name__ = f"calls_{by:.0f}"
    return kernel(calls)
""",
    "record.py": """
from typing import NamedTuple

class Pair(NamedTuple):
    one: float
    two: float
""",
    "use.py": """
from eps_hil.alone import alone
from eps_hil.compiled import kernel, njit
from eps_hil.deep import deep
from eps_hil.made import made
from eps_hil.middle import middle
from eps_hil.record import Pair

closed = made(deep, 5.0)

@kernel
def top(x):
    return middle(x)

@kernel
def first(pair):
    return pair.one

def answers():
    return {"top": top(3.0), "alone": alone(3.0), "closed": closed(3.0),
            "first": first(Pair(two=2.0, one=1.0))}
""",
}
ALL = ["alone", "calls_5", "deep", "first", "middle", "top"]
ANSWERS = {"top": 7.0, "alone": 30.0, "closed": 11.0, "first": 1.0}
USED = ["calls_5", "first", "top"]
Said = tuple[dict[str, float], list[str]]
"""What the kernels answer in a process of their own, and which of them it compiled."""


@pytest.fixture(scope="module")
def answers_of() -> Iterator[Callable[[Path], Said]]:
    environment = {"PATH": os.environ["PATH"]}
    with subprocess.Popen(
        [sys.executable, "-c", EDITED], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        env=environment,
    ) as process:  # fmt: skip

        def said(site: Path) -> Said:
            assert process.stdin is not None
            assert process.stdout is not None
            process.stdin.write(f"{site}\n")
            process.stdin.flush()
            answers, compiled = json.loads(process.stdout.readline())
            return answers, compiled

        yield said
        process.stdin and process.stdin.close()


@pytest.fixture(scope="module")
def compiled_once(
    tmp_path_factory: pytest.TempPathFactory, answers_of: Callable[[Path], Said]
) -> Path:
    """A package whose kernels call each other across modules, beside its machine code."""
    home = tmp_path_factory.mktemp("compiled")
    package = home / "site" / "eps_hil"
    package.mkdir(parents=True)
    for name in MECHANISM:
        shutil.copy(SOURCES / name, package / name)
    for name, text in PACKAGE.items():
        (package / name).write_text(text)
    assert answers_of(package.parent) == (ANSWERS, ALL)
    return home


@pytest.fixture
def install(compiled_once: Path, tmp_path: Path) -> Path:
    """The same, for one test, in another place."""
    shutil.copytree(compiled_once, tmp_path / "home")
    return tmp_path / "home" / "site"


def edit(site: Path, name: str, old: str, new: str) -> None:
    path = site / "eps_hil" / name
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))


@pytest.mark.parametrize(
    ("name", "old", "new", "answers", "compiled"),
    [
        ("alone.py", "10.0", "11.0", {"alone": 33.0}, ["alone"]),
        ("middle.py", "1.0", "2.0", {"top": 8.0}, ["middle", "top"]),
        ("deep.py", "GAIN * x", "GAIN + x", {"top": 6.0, "closed": 10.0},
         ["deep", "middle", *USED]),
        ("numbers.py", "2.0", "4.0", {"top": 13.0, "closed": 17.0}, ["deep", "middle", *USED]),
        ("made.py", ") + by", ") - by", {"closed": 1.0}, USED),
        ("use.py", "made(deep, 5.0)", "made(middle, 6.0)", {"closed": 13.0},
         ["calls_6", "first", "top"]),
        ("record.py", "one: float\n    two: float", "two: float\n    one: float", {}, ["first"]),
        ("record.py", "    two: float\n", "    two: float\n    three: float = 0.0\n", {},
         ["first"]),
        ("compiled.py", "``njit`` with", "njit with", {}, ALL),
    ],
)  # fmt: skip
def test_an_edit_compiles_what_depends_on_it(
    install: Path, answers_of: Callable[[Path], Said], name: str, old: str, new: str,
    answers: dict[str, float], compiled: list[str],
) -> None:  # fmt: skip
    assert answers_of(install) == (ANSWERS, [])
    before = (install / "eps_hil" / name).read_text()
    edit(install, name, old, new)
    said, made = answers_of(install)
    assert said == ANSWERS | answers
    assert made == sorted(compiled)
    assert answers_of(install) == (said, [])
    (install / "eps_hil" / name).write_text(before)
    assert answers_of(install) == (ANSWERS, [])  # as after a look at another branch


@pytest.mark.parametrize(
    ("name", "old", "new"),
    [
        ("numbers.py", "UNUSED", "NEVER_USED"),
        ("record.py", "class Pair", "class Other(NamedTuple): ...\n\nclass Pair"),
        ("kernel.py", "2.0", "3.0"),
    ],
)
def test_what_no_code_depends_on_compiles_as_little_as_can_be_known(
    install: Path, answers_of: Callable[[Path], Said], name: str, old: str, new: str
) -> None:
    """A module counts as a whole; one that no kernel asked for reaches does not count at all."""
    edit(install, name, old, new)
    said, compiled = answers_of(install)
    assert said == ANSWERS
    assert compiled == ([] if name != "numbers.py" else sorted(["deep", "middle", *USED]))


def test_a_record_that_is_gone_spoils_nothing_that_is_kept(
    install: Path, answers_of: Callable[[Path], Said]
) -> None:
    for name in ("record.py", "use.py"):
        edit(install, name, "Pair", "Both")
    said, compiled = answers_of(install)
    assert (said, "first" in compiled) == (ANSWERS, True)


def test_a_source_that_is_half_written_and_not_imported(
    install: Path, answers_of: Callable[[Path], Said]
) -> None:
    (install / "eps_hil" / "half.py").write_text("from eps_hil.compiled import\n")
    assert answers_of(install) == (ANSWERS, ALL)
    assert answers_of(install) == (ANSWERS, [])
    edit(install, "numbers.py", "2.0", "4.0")
    assert answers_of(install)[0]["top"] == 13.0


def test_old_machine_code_is_forgotten(install: Path, answers_of: Callable[[Path], Said]) -> None:
    (folder,) = (install.parent / ".cache" / "eps_hil" / "compiled").iterdir()

    def kept() -> list[str]:
        return sorted(path.name for path in (folder / "functions").rglob("alone*.nbc"))

    for k in range(6):
        edit(install, "alone.py", f"1{k}.0", f"1{k + 1}.0")
        last = answers_of(install)
        assert last == (ANSWERS | {"alone": 3.0 * (11 + k)}, ["alone"])
    assert len(kept()) == len(list((folder / "sources").glob("*.made"))) == 4
    assert len(list((folder / "locks").glob("eps_hil.alone.*"))) <= 4
    assert answers_of(install) == (last[0], [])


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
