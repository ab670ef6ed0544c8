"""How every verb takes recordings: the same options, the same errors, the same progress.

A verb declares its parameters with these annotated types and hands them to
:func:`read_recordings`:

    def estimate(recordings: RecordingPaths, dbc: Dbc = None, signals: Signals = None,
                 gaps: GapsOption = Gaps.REFUSE, ignore_unknown: IgnoreUnknown = False,
                 channel: Channel = None) -> None: ...
"""

import contextlib
import enum
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from eps_hil.recordings.recording import Recording


class Gaps(enum.StrEnum):
    """What to do with NaN, infinity and holes in a filled column."""

    REFUSE = "refuse"
    MARK = "mark"


RecordingPaths = Annotated[
    list[Path],
    typer.Argument(metavar="REC...", help="CSV, Parquet, MF4, or a CAN log (LOG, BLF, ASC, TRC)."),
]
Dbc = Annotated[
    list[Path] | None,
    typer.Option("--dbc", help="CAN database of a CAN log; may be given more than once."),
]
Signals = Annotated[
    Path | None,
    typer.Option("--signals", help="Mapping (YAML) of the CAN log's signals to canonical names."),
]
GapsOption = Annotated[
    Gaps,
    typer.Option("--gaps", help="NaN and holes in a column: refuse them, or mark them as bad."),
]
IgnoreUnknown = Annotated[
    bool,
    typer.Option("--ignore-unknown", help="Leave out columns without a canonical name."),
]
Channel = Annotated[
    str | None,
    typer.Option("--channel", help="The one bus to read, of a CAN log that holds several."),
]


def read_recordings(
    paths: Sequence[Path],
    *,
    dbc: Sequence[Path] | None = None,
    signals: Path | None = None,
    gaps: Gaps = Gaps.REFUSE,
    ignore_unknown: bool = False,
    channel: str | None = None,
) -> "Iterator[Recording]":
    """Read one recording after the other; notes go to stderr, progress to a terminal."""
    from eps_hil.recordings.read import read_recording

    for path in paths:
        with progress(f"reading {path.name}") as on_progress:
            recording = read_recording(
                path,
                dbc=dbc or (),
                signals=signals,
                gaps=gaps.value,
                ignore_unknown=ignore_unknown,
                channel=channel,
                on_progress=on_progress,
            )
        say_notes(path, recording.notes)
        yield recording


def say_notes(path: Path, notes: Sequence[str]) -> None:
    """One line on stderr for each thing that the reader left out or mended."""
    for note in notes:
        typer.echo(f"{path}: {note}", err=True)


@contextlib.contextmanager
def progress(what: str) -> Iterator[Callable[[float], None] | None]:
    """A bar on stderr while the block runs; None, and nothing shown, where that is no terminal."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=1.0)
        yield lambda fraction: bar.update(task, completed=fraction)
