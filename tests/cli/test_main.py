"""The command itself: statuses, one line for every error, a traceback only on request."""

import errno
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import typer

from eps_hil.cli import main as command
from eps_hil.errors import EpsHilError, InputError, SafetyStop


def test_version_and_help(capsys: pytest.CaptureFixture[str]) -> None:
    assert command.main(["--version"]) == 0
    assert "eps-hil" in capsys.readouterr().out
    assert command.main(["--help"]) == 0
    said = capsys.readouterr().out
    assert "estimate" in said
    assert "eps-hil example demo_udp" in said, "a newcomer's first step"


@pytest.mark.parametrize(
    ("error", "status"),
    [
        (InputError("f.csv", "line 3", "is wrong", "mend it"), 2),
        (EpsHilError("disk full"), 1),
        (SafetyStop("speed"), 3),
        (KeyboardInterrupt(), 130),
        (ZeroDivisionError("oh"), 1),
        (OSError(errno.ENOSPC, "No space left on device", "out.json"), 1),
        (BrokenPipeError(), 1),
    ],
)
def test_every_error_has_its_status(
    error: BaseException,
    status: int,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def fail(**_words: object) -> None:
        raise error

    monkeypatch.setattr(command, "app", fail)
    assert command.main([]) == status
    shown = capsys.readouterr().err
    assert "Traceback" not in shown
    assert shown.count("\n") == (0 if isinstance(error, BrokenPipeError) else 1)
    if status != 130 and not isinstance(error, BrokenPipeError):
        command.main(["--debug"])
        assert "Traceback" in capsys.readouterr().err


def test_what_the_system_refuses_is_no_internal_error(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(**_words: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device", "out.json")

    monkeypatch.setattr(command, "app", fail)
    command.main([])
    assert capsys.readouterr().err == "eps-hil: out.json: no space left on device\n"


@pytest.mark.parametrize("group", [[], ["prove"], ["calibrate"]])
def test_a_group_without_a_verb_shows_its_help(
    capsys: pytest.CaptureFixture[str], group: list[str]
) -> None:
    assert command.main(group) == 2
    shown = capsys.readouterr().err
    assert shown.startswith("Usage: eps-hil")
    assert "\nCommands:\n" in shown


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (
            ["batch", "--dask", "tcp://a:1"],
            "--dask; it goes after eps-hil batch estimate|identify|diagnose|changes",
        ),
        (["--dry-run"], "--dry-run; see eps-hil --help"),
        (["batch", "--desk"], "--desk; see eps-hil batch --help"),
    ],
)
def test_an_option_that_stands_too_early_says_where_it_goes(
    words: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command.main(words) == 2
    assert capsys.readouterr().err == f"eps-hil: No such option: {said}\n"


def test_ctrl_c_inside_a_verb_is_one_line(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Through typer, which would swallow it."""
    from eps_hil.physics import model

    def interrupted(_path: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(model, "load_model", interrupted)
    words = ["simulate", "--model", "m.yaml", "--inputs", "a.csv", "--out", "b.csv"]
    assert command.main(words) == 130
    assert capsys.readouterr().err == "eps-hil: interrupted\n"


def test_an_interrupt_that_a_callback_swallowed_is_no_internal_error(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ctrl-C while code is compiled: the compiler's callback loses it, and fails later."""
    from eps_hil.physics import model

    class Loses:
        def __del__(self) -> None:
            raise KeyboardInterrupt

    def compile_it(_path: object) -> None:
        Loses()
        raise RuntimeError("no compiled object yet")

    monkeypatch.setattr(model, "load_model", compile_it)
    words = ["simulate", "--model", "m.yaml", "--inputs", "a.csv", "--out", "b.csv"]
    assert command.main(words) == 130
    assert capsys.readouterr().err == "eps-hil: interrupted\n"


def test_debug_may_stand_after_the_verb(capsys: pytest.CaptureFixture[str]) -> None:
    assert command.main(["estimate", "none.csv", "--model", "none.yaml", "--debug"]) == 2
    assert "Traceback" in capsys.readouterr().err


def test_help_imports_nothing_heavy() -> None:
    """Import time is a feature: the face of the command needs no numba, scipy or pandas."""
    code = (
        "import sys; from eps_hil.cli.main import main; main(['--help']); "
        "heavy = {'numba', 'scipy', 'pandas', 'matplotlib', 'pyarrow', 'asammdf', 'can', "
        "'cantools', 'numpy'} & set(sys.modules); sys.exit(f'heavy: {heavy}' if heavy else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_all_verbs_have_a_sentence() -> None:
    group = typer.main.get_command(command.app)
    for name, verb in group.commands.items():  # type: ignore[attr-defined]
        assert verb.help, name


def test_several_files_may_follow_one_option() -> None:
    words = ["diagnose", "--recording", "a", "b", "--holdout", "c", "d", "--json", "x"]
    assert command.spread(words) == [
        "diagnose", "--recording", "a", "--recording", "b", "--holdout", "c", "--holdout", "d",
        "--json", "x",
    ]  # fmt: skip
    assert command.spread(["estimate", "a", "b", "--model", "m"])[1:3] == ["a", "b"]
    with_equals = ["changes", "--before=a", "b", "--after", "c"]
    assert command.spread(with_equals)[1:4] == ["--before=a", "--before", "b"]
    # a verb that takes one file there has its recordings behind it
    fitted = ["identify", "--simulation", "s.fmu", "a.csv", "--free", "k", "m"]
    assert command.spread(fitted) == [*fitted[:6], "--free", "m"]
    assert command.spread(["tune", "--recording", "a", "b"]) == ["tune", "--recording", "a", "b"]


def test_a_librarys_warnings_are_for_those_who_ask() -> None:
    """Torques of 1e300 Nm: an overflow in NumPy, beside the line that says so."""
    words = [
        "import sys, warnings",
        "from eps_hil.cli import main",
        "def app(**_): warnings.warn('overflow encountered in square', RuntimeWarning)",
        "main.app = app",
        "main.run()",
    ]
    for more, told in ((["estimate"], False), (["estimate", "--debug"], True)):
        done = subprocess.run(
            [sys.executable, "-c", "\n".join(words), *more],
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.returncode == 0
        assert ("overflow" in done.stderr) == told


@pytest.mark.parametrize(
    ("error", "status"), [("SafetyStop('the torque guard')", 3), ("EpsHilError('refused')", 1)]
)
def test_a_reader_that_went_away_changes_no_status(error: str, status: int) -> None:
    """Standard output and standard error are pipes that nobody reads; lines are left over."""
    words = [
        "from eps_hil.cli import main",
        "from eps_hil.cli._lines import Lines",
        "from eps_hil.errors import *",
        "def app(**_):",
        "    Lines().say('listening -> fault')",
        f"    raise {error}",
        "main.app = app",
        "main.run()",
    ]
    reading, writing = os.pipe()
    os.close(reading)
    told = subprocess.run(
        [sys.executable, "-c", "\n".join(words)], stdout=writing, stderr=writing, check=False
    )
    os.close(writing)
    assert told.returncode == status


@pytest.mark.parametrize("module", ["eps_hil", "eps_hil.cli"])
def test_ctrl_c_while_modules_are_imported_is_one_line(tmp_path: Path, module: str) -> None:
    """``typer`` here stands for whatever is being imported when the key is pressed."""
    (tmp_path / "typer.py").write_text("raise KeyboardInterrupt\n")
    before = os.environ.get("PYTHONPATH", "")
    ended = subprocess.run(
        [sys.executable, "-m", module, "--version"], check=False, capture_output=True, text=True,
        env={**os.environ, "PYTHONPATH": f"{tmp_path}{os.pathsep}{before}"},
    )  # fmt: skip
    assert (ended.returncode, ended.stdout, ended.stderr) == (130, "", "eps-hil: interrupted\n")


def test_the_script_begins_where_a_key_does_no_harm() -> None:
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())
    assert project["project"]["scripts"] == {"eps-hil": "eps_hil.__main__:run"}
