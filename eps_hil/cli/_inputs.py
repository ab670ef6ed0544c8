"""How every verb takes recordings: the same options, the same errors, the same progress.

A verb is registered through :func:`reads_recordings`, which gives it the reading options, and
hears what they said as :class:`Reading`:

    app.command("estimate")(reads_recordings(estimate))

    def estimate(recordings: RecordingPaths, *, reading: Reading) -> None: ...
"""

import contextlib
import enum
import functools
import inspect
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from eps_hil.errors import InputError

if TYPE_CHECKING:
    from rich.progress import Progress

    from eps_hil.recordings.recording import Recording
    from eps_hil.series import Series


class Gaps(enum.StrEnum):
    """What to do with NaN, infinity and holes in a filled column."""

    REFUSE = "refuse"
    MARK = "mark"


@dataclass(frozen=True, slots=True)
class Reading:
    """What the reading options said; what they mean is with the options below."""

    dbc: tuple[Path, ...] = ()
    signals: Path | None = None
    gaps: Gaps = Gaps.REFUSE
    ignore_unknown: bool = False
    channel: str | None = None

    def files(self) -> tuple[Path | None, ...]:
        """What is read beside the recordings."""
        return *self.dbc, self.signals

    def arguments(self) -> dict[str, Any]:
        """As :mod:`eps_hil.recordings` takes them."""
        return {
            "dbc": self.dbc,
            "signals": self.signals,
            "gaps": self.gaps.value,
            "ignore_unknown": self.ignore_unknown,
            "channel": self.channel,
        }


RecordingPaths = Annotated[
    list[Path],
    typer.Argument(metavar="REC...", help="CSV, Parquet, MF4, or a CAN log (LOG, BLF, ASC, TRC)."),
]
ModelPath = Annotated[Path, typer.Option("--model", help="Model file of the rig (YAML).")]
Dbc = Annotated[
    list[Path] | None,
    typer.Option("--dbc", help="CAN database of a CAN log; may be given more than once."),
]
Signals = Annotated[
    Path | None,
    typer.Option(
        "--signals",
        help="Mapping (YAML) of a CAN log's signals, or a table's columns, to our names.",
    ),
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


def reads_recordings(verb: Callable[..., None], gaps: Gaps = Gaps.REFUSE) -> Callable[..., None]:
    """The verb with the reading options behind its own; it hears them as ``reading``.

    ``gaps``: what the verb does with gaps where the user does not say.
    """
    options = {
        "dbc": (Dbc, None),
        "signals": (Signals, None),
        "gaps": (GapsOption, gaps),
        "ignore_unknown": (IgnoreUnknown, False),
        "channel": (Channel, None),
    }

    @functools.wraps(verb)
    def command(**values: Any) -> None:
        check_extras(values.values())
        said = {name: values.pop(name) for name in options}
        verb(**values, reading=Reading(**{**said, "dbc": tuple(said["dbc"] or ())}))

    own = inspect.signature(verb)
    kept = [one for one in own.parameters.values() if one.name != "reading"]
    added = [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=kind)
        for name, (kind, default) in options.items()
    ]
    command.__signature__ = own.replace(parameters=[*kept, *added])  # type: ignore[attr-defined]
    command.__annotations__ = {one.name: one.annotation for one in (*kept, *added)}
    return command


def check_extras(values: Iterable[Any]) -> None:
    """Refuse any file among a verb's arguments whose format needs what is not installed."""
    from eps_hil.recordings.files import check_extra

    for value in values:
        for path in value if isinstance(value, list | tuple) else (value,):
            if isinstance(path, Path):
                check_extra(path)


def read_recording(path: Path, reading: Reading) -> "Recording":
    """Read one recording; notes go to stderr, progress to a terminal."""
    from eps_hil.recordings.read import read_recording as read

    with progress(f"reading {path.name}") as on_progress:
        recording = read(path, **reading.arguments(), on_progress=on_progress)
    say_notes(path, recording.notes)
    return recording


def read_each(paths: Sequence[Path], reading: Reading) -> "Iterator[tuple[Path, Recording]]":
    """Path and recording, read one after the other as they are asked for."""
    for path in paths:
        yield path, read_recording(path, reading)


def same_file(path: Path, others: Sequence[Path]) -> bool:
    """Whether one of the others is this file, however it is spelt or linked."""
    return path.resolve() in {other.resolve() for other in others}


def check_once(paths: Sequence[Path]) -> None:
    """Refuse the same file twice: what it holds would count as seen twice."""
    for k, path in enumerate(paths):
        if same_file(path, paths[:k]):
            raise InputError(path, "", "is given twice", "name each recording once")


def read_all(paths: Sequence[Path], reading: Reading) -> "dict[str, Mapping[str, Series]]":
    """All recordings' signals by path, as the user wrote it; the same file twice is refused."""
    check_once(paths)
    if len(paths) < 2:
        return {str(path): one.series for path, one in read_each(paths, reading)}
    return _read_side_by_side(paths, reading)


def _read_side_by_side(
    paths: Sequence[Path], reading: Reading
) -> "dict[str, Mapping[str, Series]]":
    """On all cores; notes, and the error of the first bad one, in the order they were named."""
    from concurrent.futures import ThreadPoolExecutor

    from eps_hil.recordings.read import read_recording as read

    found: dict[str, Mapping[str, Series]] = {}
    with (
        progress(f"reading {len(paths)} recordings") as on_progress,
        ThreadPoolExecutor(os.cpu_count()) as pool,
    ):
        recordings = pool.map(lambda path: read(path, **reading.arguments()), paths)
        for path, recording in zip(paths, recordings, strict=True):
            say_notes(path, recording.notes)
            found[str(path)] = recording.series
            if on_progress:
                on_progress(len(found) / len(paths))
    return found


@contextlib.contextmanager
def told_what_it_holds(
    path: Path, recording: "Recording", refusal: type[Exception] = ValueError
) -> Iterator[None]:
    """A ``refusal`` of a recording becomes an error that names the file and what it holds."""
    try:
        yield
    except refusal as error:
        there = ", ".join(sorted(recording.series))
        raise InputError(path, "", str(error), f"it holds {there}") from None


def say_notes(path: Path, notes: Sequence[str]) -> None:
    """One line on stderr for each thing that the reader left out or mended."""
    for note in notes:
        typer.echo(f"{path}: {note}", err=True)


@contextlib.contextmanager
def progress(what: str) -> Iterator[Callable[[float], None] | None]:
    """A bar on stderr while the block runs; None, and nothing shown, where that is no terminal."""
    with stages(what) as stage:
        yield None if stage is None else lambda fraction: stage(what, fraction)


@contextlib.contextmanager
def stages(what: str) -> Iterator[Callable[[str, float], None] | None]:
    """As :func:`progress` for work in stages: the bar is told which, and how much of it is done."""
    if not sys.stderr.isatty():
        yield None
        return
    with _bar() as bar:
        task = bar.add_task(what, total=1.0)
        yield lambda stage, part: bar.update(task, description=stage, completed=part)


@contextlib.contextmanager
def waiting(what: str) -> Iterator[None]:
    """As :func:`progress`, for work that cannot say how much of it is done: how long it takes."""
    if not sys.stderr.isatty():
        yield
        return
    with _bar() as bar:
        bar.add_task(what, total=None)
        yield


def _bar() -> "Progress":
    from rich.console import Console
    from rich.progress import Progress, TimeElapsedColumn

    columns = (*Progress.get_default_columns(), TimeElapsedColumn())
    return Progress(*columns, console=Console(stderr=True), transient=True)
