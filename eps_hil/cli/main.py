"""The ``eps-hil`` command: gathers the verbs, and turns every error into one line and a status."""

import contextlib
import importlib
import os
import pkgutil
import sys
import traceback
import warnings
from collections.abc import Iterator
from typing import Any

import typer

from eps_hil import __version__, cli, provenance
from eps_hil.cli import _completion, _numbers, _outputs, _schema, _verbs
from eps_hil.errors import EpsHilError

app = typer.Typer(
    name="eps-hil",
    help="Hardware-in-the-loop service for electric power steering over CAN.",
    epilog="To begin, in an empty folder: `eps-hil example demo_udp` writes what a simulated rig "
    "needs, and says what to run.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"eps-hil {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: bool = typer.Option(
        False, "--version", callback=_show_version, is_eager=True, help="Show the version."
    ),
    debug: bool = typer.Option(False, "--debug", help="Show a traceback with an error."),
) -> None:
    """Options before the verb; ``--debug`` is also found after it (see :func:`main`)."""


for _file in pkgutil.iter_modules(cli.__path__):
    if _file.name != "main" and not _file.name.startswith("_"):
        importlib.import_module(f"eps_hil.cli.{_file.name}").register(app)
for wrapper in (_outputs.keeps_inputs, _numbers.takes_numbers, _schema.prints_schemas):
    _verbs.wrap(app, wrapper)
_completion.keep_quiet_without_the_program()


INTERRUPTED = 130
"""Status after Ctrl-C, as a shell gives it."""
ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""Matrices here have a few dozen columns: beside others at work, threads of their own only wait for
one another, which costs as much processor time again. Recordings are worked on side by side."""
SEVERAL = {
    "diagnose": {"--recording", "--holdout", "--simulation"},
    "identify": {"--holdout", "--free"},
    "changes": {"--before", "--after"},
}
"""Options that several files may follow (CONTRACT 6), by their verbs."""


def spread(words: list[str]) -> list[str]:
    """``--recording a b`` (or ``--recording=a b``) as ``--recording a --recording b``, which the
    parser understands."""
    several = SEVERAL.get(next((word for word in words if not word.startswith("-")), ""), set())
    result: list[str] = []
    option, first = "", True
    for word in words:
        if word.startswith("-") and len(word) > 1:
            name, equals, _ = word.partition("=")
            option, first = (name if name in several else ""), not equals
        elif option:
            result += [] if first else [option]
            first = False
        result.append(word)
    return result


def main(arguments: list[str] | None = None) -> int:
    """Run one command; return its exit status (0 done, 2 wrong input, 3 safety, 1 else)."""
    for name in ONE_THREAD:  # before NumPy is there
        os.environ.setdefault(name, "1")
    words = list(sys.argv[1:] if arguments is None else arguments)
    debug = "--debug" in words
    words = spread(_schema.with_kind(app, [word for word in words if word != "--debug"]))
    provenance.begin(words)
    try:
        with _keeping_interrupts():
            status = app(args=words, prog_name="eps-hil", standalone_mode=False)
        if status == INTERRUPTED:  # typer keeps Ctrl-C to itself, and leaves its status
            return _say("interrupted", INTERRUPTED, debug=False)
        return status if isinstance(status, int) else 0
    except BaseException as error:  # the last line of defence: one line, never a stack
        return _explain(error, debug)


@contextlib.contextmanager
def _keeping_interrupts() -> Iterator[None]:
    """A Ctrl-C that a callback swallowed (the compiler's, say) is why an error came after it."""
    usual, swallowed = sys.unraisablehook, False

    def note(lost: Any) -> None:
        nonlocal swallowed
        swallowed |= lost.exc_type is KeyboardInterrupt
        if lost.exc_type is not KeyboardInterrupt:
            usual(lost)

    sys.unraisablehook = note
    try:
        yield
    except Exception as error:
        if swallowed:
            raise KeyboardInterrupt from error
        raise
    finally:
        sys.unraisablehook = usual


def _explain(error: BaseException, debug: bool) -> int:
    match error:
        case typer.Exit():
            return error.exit_code
        case BrokenPipeError():  # who read is gone; what would have come after is not done
            return 1
        case typer.Abort() | KeyboardInterrupt():
            message, status = "interrupted", INTERRUPTED
        case EpsHilError():
            message, status = str(error), error.exit_status
        case _ if type(error).__name__ == "NoArgsIsHelpError":  # a group without a verb: its help
            typer.echo(str(error), err=True)
            return 2
        case _ if hasattr(error, "format_message"):  # wrong words, in click's own exception
            verb = getattr(getattr(error, "ctx", None), "command_path", "eps-hil")
            remedy = _goes_after(error) or f"see {verb} --help"
            message, status = f"{error.format_message().rstrip('.')}; {remedy}", 2
        case SystemExit():
            raise error
        case OSError(strerror=str(said)):  # a full disk, a folder that is gone
            message, status = f"{error.filename or 'the system'}: {said[:1].lower()}{said[1:]}", 1
        case _:
            message = f"internal error, please report it with --debug: {type(error).__name__}: "
            message, status = message + str(error), 1
    return _say(message, status, debug)


def _goes_after(error: Any) -> str:
    """Of an option that stands before the verb it belongs to: after which; else nothing."""
    option, ctx = getattr(error, "option_name", None), getattr(error, "ctx", None)
    verbs = getattr(getattr(ctx, "command", None), "commands", {})
    takers = [
        name for name, verb in verbs.items() if any(option in one.opts for one in verb.params)
    ]
    return (
        f"it goes after {getattr(ctx, 'command_path', '')} {'|'.join(takers)}"
        if option and takers
        else ""
    )


def _say(message: str, status: int, debug: bool) -> int:
    if debug:
        traceback.print_exc()
    with contextlib.suppress(OSError):  # nobody reads it: the status says it all the same
        typer.echo(f"eps-hil: {' '.join(message.split())}", err=True)
    return status


def _let_go_of_pipes() -> None:
    """What a reader that is gone did not take: Python would end with status 120 over it."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError:
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, stream.fileno())
            os.close(nowhere)


def run() -> None:
    """Entry point of the installed script."""
    if not sys.warnoptions and "--debug" not in sys.argv:
        warnings.simplefilter("ignore")  # lines of code are for those who ask for them
    status = main()
    _let_go_of_pipes()
    sys.exit(status)
