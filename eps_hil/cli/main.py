"""The ``eps-hil`` command: gathers the verbs, and turns every error into one line and a status."""

import importlib
import pkgutil
import sys
import traceback

import click
import typer

from eps_hil import __version__, cli
from eps_hil.errors import EpsHilError

app = typer.Typer(
    name="eps-hil",
    help="Hardware-in-the-loop service for electric power steering over CAN.",
    no_args_is_help=True,
    add_completion=False,
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


def main(arguments: list[str] | None = None) -> int:
    """Run one command; return its exit status (0 done, 2 wrong input, 3 safety, 1 else)."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    debug = "--debug" in words
    words = [word for word in words if word != "--debug"]
    try:
        status = app(args=words, prog_name="eps-hil", standalone_mode=False)
        return status if isinstance(status, int) else 0
    except click.exceptions.Exit as stop:
        return stop.exit_code
    except click.ClickException as error:
        return _say(f"{error.format_message()}; see eps-hil --help", 2, debug)
    except (click.Abort, KeyboardInterrupt):
        return _say("interrupted", 130, debug)
    except EpsHilError as error:
        return _say(str(error), error.exit_status, debug)
    except BrokenPipeError:
        return 0
    except Exception as error:  # the last line of defence: a person sees one line, not a stack
        what = f"{type(error).__name__}: {error}"
        return _say(f"internal error, please report it with --debug: {what}", 1, debug)


def _say(message: str, status: int, debug: bool) -> int:
    if debug:
        traceback.print_exc()
    typer.echo(f"eps-hil: {' '.join(message.split())}", err=True)
    return status


def run() -> None:
    """Entry point of the installed script."""
    sys.exit(main())
