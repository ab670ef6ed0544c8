"""Any file of CONTRACT 3 -> :class:`Recording`, chosen by its suffix."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from eps_hil.errors import InputError
from eps_hil.recordings.recording import Recording
from eps_hil.recordings.table import VALID, Table, check_increasing, to_series
from eps_hil.series import Arrivals, Pace, Series

TABLES = (".csv", ".parquet")
CAN_LOGS = (".log", ".blf", ".asc", ".trc")
SUFFIXES = (*TABLES, ".mf4", *CAN_LOGS)
GAPS = ("refuse", "mark")

Progress = Callable[[float], None]


def read_recording(
    path: str | Path,
    *,
    dbc: Sequence[Path] = (),
    signals: Path | None = None,
    gaps: str = "refuse",
    ignore_unknown: bool = False,
    channel: str | None = None,
    on_progress: Progress | None = None,
) -> Recording:
    """Read one recording into canonical signals.

    ``dbc``, ``signals``: databases and mapping (CONTRACT 5) that CAN logs need; a mapping of
    columns is for tables, whose columns have other names or units. ``channel``: the one bus of a
    log to read. ``gaps``: what to do with NaN, infinity and holes in a filled column: "refuse"
    them, or "mark" them as bad samples (value NaN). ``ignore_unknown``: leave out columns without
    a canonical name, with a note. ``on_progress`` hears the fraction read of a long log.
    Raises :class:`InputError` for everything that is wrong with the file.
    """
    arrivals: list[Arrivals] = []
    pace: list[Pace] = []
    series, notes = read_columns(
        path,
        dbc=dbc,
        signals=signals,
        gaps=gaps,
        ignore_unknown=ignore_unknown,
        channel=channel,
        on_progress=on_progress,
        arrivals=arrivals,
        pace=pace,
    )
    only_signals = {name: one for name, one in series.items() if name != VALID}
    if not only_signals:
        raise InputError(path, "", "no signal has a value", "record at least one")
    return Recording(
        Path(path).name,
        only_signals,
        notes,
        arrivals[0] if arrivals else None,
        pace[0] if pace else None,
    )


def read_columns(
    path: str | Path,
    *,
    dbc: Sequence[Path] = (),
    signals: Path | None = None,
    gaps: str = "refuse",
    ignore_unknown: bool = False,
    channel: str | None = None,
    on_progress: Progress | None = None,
    arrivals: list[Arrivals] | None = None,
    pace: list[Pace] | None = None,
) -> tuple[Mapping[str, Series], tuple[str, ...]]:
    """As :func:`read_recording`, with the column ``valid`` kept, for conversion.

    ``arrivals`` and ``pace`` are appended to where the file holds frames.
    """
    path = Path(path)
    if gaps not in GAPS:
        raise ValueError(f"gaps is one of {GAPS}, not {gaps!r}")
    suffix = path.suffix.lower()
    if signals is not None and not is_can_log(path) and suffix in (*TABLES, ".mf4"):
        from eps_hil.recordings.foreign import maps_columns, read_mapped

        if maps_columns(signals):
            return read_mapped(path, signals, gaps=gaps)
    if suffix in TABLES:
        table = _read_table(path, ignore_unknown=ignore_unknown)
        check_increasing(path, table.t_ns, table.place)
        return to_series(path, table, gaps=gaps)
    if suffix in CAN_LOGS or (suffix == ".mf4" and _has_bus_frames(path)):
        from eps_hil.recordings.log_signals import read_log

        return read_log(
            path,
            dbc=dbc,
            signals=signals,
            channel=channel,
            on_progress=on_progress,
            arrivals=arrivals,
            pace=pace,
        )
    if suffix == ".mf4":
        from eps_hil.recordings.mf4_file import read_mf4

        return read_mf4(path, gaps=gaps, ignore_unknown=ignore_unknown)
    known = ", ".join(SUFFIXES)
    raise InputError(path, "", f"suffix '{path.suffix}' is no recording", f"known: {known}")


def is_can_log(path: str | Path) -> bool:
    """Whether the file holds raw CAN frames (needs a DBC) rather than columns."""
    path = Path(path)
    suffix = path.suffix.lower()
    return suffix in CAN_LOGS or (suffix == ".mf4" and _has_bus_frames(path))


def _read_table(path: Path, *, ignore_unknown: bool) -> Table:
    if path.suffix.lower() == ".csv":
        from eps_hil.recordings.csv_file import read_csv

        return read_csv(path, ignore_unknown=ignore_unknown)
    from eps_hil.recordings.parquet_file import read_parquet

    return read_parquet(path, ignore_unknown=ignore_unknown)


def _has_bus_frames(path: Path) -> bool:
    from eps_hil.recordings.mf4_file import has_bus_frames

    return has_bus_frames(path)
