"""``eps-hil init``: a first configuration guessed from a CAN database, a mapping from a table."""

from pathlib import Path
from typing import Annotated

import typer


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command("init")(init)


def init(
    source: Annotated[Path, typer.Argument(help="CAN database, or table (.csv, .parquet).")],
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder to write to.")] = Path(),
    interface: Annotated[str, typer.Option("--interface", help="Of the CAN bus.")] = "socketcan",
    channel: Annotated[str, typer.Option("--channel", help="Of the CAN bus.")] = "can0",
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace files.")] = False,
) -> None:
    """Guess mapping, units, clock and, from a table, signs; say what was guessed and how sure.

    From a database: signals.yaml, model.yaml (the reference rig's numbers) and rig.yaml, which
    sends nothing. From a table: columns.yaml. Then `eps-hil check rig.yaml`.
    """
    from eps_hil.check import begin
    from eps_hil.check.check import DATABASES
    from eps_hil.errors import InputError
    from eps_hil.recordings.files import make_folder, replacing

    if not source.is_file():
        raise InputError(source, "", "no such file", "check the path")
    if source.suffix.lower() in {".csv", ".txt", ".tsv", ".parquet"}:
        begun = begin.from_table(source)
    elif source.suffix.lower() in DATABASES:
        begun = begin.from_database(source, interface, channel)
    else:
        raise InputError(source, "", "is neither a CAN database nor a table", "give a DBC or CSV")
    for name in begun.files:
        if (folder / name).exists() and not overwrite:
            raise InputError(folder / name, "", "is there already", "move it, or --overwrite")
    make_folder(folder, "DIR")
    for name, text in begun.files.items():
        with replacing(folder / name) as temporary:
            temporary.write_text(text, encoding="utf-8")
        typer.echo(f"wrote: {folder / name}")
    width = max(len(one.canonical) for one in begun.guesses)
    for one in begun.guesses:
        place = f"{one.of.message}.{one.of.name}" if one.of.message else one.of.name
        typer.echo(f"  {one.canonical:{width}}  {one.sure:4.0%}  {place}, by {one.why}")
    for line in begun.open:
        typer.echo(f"  not known: {line}")
