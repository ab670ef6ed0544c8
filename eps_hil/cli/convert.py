"""``eps-hil convert IN OUT``: between recording formats (CONTRACT 3 and 6)."""

from pathlib import Path
from typing import Annotated

import typer

from eps_hil.cli._inputs import Reading, progress, reads_recordings, say_notes


def register(app: typer.Typer) -> None:
    """Add the verb."""
    app.command("convert")(reads_recordings(convert))


def convert(
    source: Annotated[Path, typer.Argument(metavar="IN", help="Recording to read.")],
    target: Annotated[Path, typer.Argument(metavar="OUT", help="File to write; suffix = format.")],
    rate: Annotated[
        float | None,
        typer.Option(
            min=0.001, max=1e6, help="Rows a second, of a table without holes (default: all)."
        ),
    ] = None,
    *,
    reading: Reading,
) -> None:
    """Convert a recording: CSV, Parquet, MF4, MCAP, or a CAN log; the suffixes name the formats.

    A CAN log becomes a table with --dbc and --signals, or another CAN log (.log, .blf, .asc; .mf4
    holds the raw frames where no --signals are given).
    """
    from eps_hil.recordings.conversion import convert as convert_file

    written: list[str] = []
    with progress(f"converting {source.name}") as on_progress:
        notes = convert_file(
            source,
            target,
            **reading.arguments(),
            rate_hz=rate,
            on_progress=on_progress,
            say_written=written.append,
        )
    say_notes(source, notes)
    for what in written:
        typer.echo(f"{source.name}: {what} written to {target} ({target.stat().st_size} bytes)")
