"""``eps-hil example``: the files that come with the package, listed or copied out."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from eps_hil.examples.shelf import Example


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command("example")(example)


def _names(incomplete: str) -> list[str]:
    """For the shell: what may follow."""
    from eps_hil.examples import shelf

    names = [*(one.name for one in shelf.examples()), shelf.ALL]
    return [name for name in names if name.startswith(incomplete)]


def example(
    name: Annotated[
        str | None,
        typer.Argument(help="Which; none: list them. 'all': every one.", autocompletion=_names),
    ] = None,
    folder: Annotated[
        Path, typer.Argument(metavar="DIR", help="Folder to write below (made if absent).")
    ] = Path(),
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace files of other content.")
    ] = False,
) -> None:
    """List the example files, or write one with every file that it refers to.

    A configuration for `rig` and `run` brings its CAN database, mapping and model, so that it
    runs in an empty folder, and says what to run. Files go to DIR/configs and DIR/dbc.
    """
    from eps_hil.examples import shelf

    if name is None:
        _list(shelf.examples())
        return
    for copied in shelf.copy(name, folder, overwrite=overwrite):
        typer.echo(f"{'wrote' if copied.written else 'there already'}: {copied.path}")
    if name != shelf.ALL:
        for command in shelf.find(name).commands(folder):
            typer.echo(f"run: {command}")


def _list(examples: "tuple[Example, ...]") -> None:
    width = max(len(one.name) for one in examples)
    for one in examples:
        typer.echo(f"{one.name:{width}}  {one.about}")
