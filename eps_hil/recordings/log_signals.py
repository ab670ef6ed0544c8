"""CAN log + DBC + mapping -> signals, through the same decoder that the live service uses."""

from array import array
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from eps_hil.bus.codec import FrameDecoder
from eps_hil.bus.database import load_database
from eps_hil.bus.frame import Frame
from eps_hil.bus.mapping import SignalSource, load_mapping
from eps_hil.errors import InputError
from eps_hil.recordings.can_log import read_frames
from eps_hil.recordings.files import check_readable
from eps_hil.recordings.log_columns import SUFFIXES, pieces_of
from eps_hil.series import Arrivals, Pace, Series
from eps_hil.signals import PUBLISHED

if TYPE_CHECKING:
    from eps_hil.bus.column_decoder import DecodedColumns

_MAX_SHOWN = 8
_FAULTS = {
    "crc": "frames with a wrong CRC: marked bad",
    "length": "frames shorter than the DBC says: marked bad",
    "not_decodable": "frames that the DBC cannot decode: marked bad",
    "not_available": "values sent as 'not available': marked bad",
    "out_of_range": "values outside the range of the DBC: marked bad",
    "counter": "frames repeat their counter: left out",
    "lost_frames": "frames are missing, by their counter",
    "clock_restarts": "times the sender's clock was found anew",
}

Samples = tuple[npt.NDArray[np.int64], npt.NDArray[np.float64]]


def read_log(
    path: Path,
    *,
    dbc: Sequence[Path],
    signals: Path | None,
    channel: str | None = None,
    on_progress: Callable[[float], None] | None = None,
    arrivals: list[Arrivals] | None = None,
    pace: list[Pace] | None = None,
) -> tuple[dict[str, Series], tuple[str, ...]]:
    """Series of every mapped signal that occurs, and notes on what was lost or left out.

    A frame with a wrong CRC or length gives samples with the value NaN, here as live.
    ``arrivals`` is appended to, where the mapping has a sync message, and ``pace``.
    Raises :class:`InputError` for a broken log, mapping or DBC, and if no mapped frame occurs.
    """
    check_readable(path)
    if not dbc or signals is None:
        options = {"--dbc": bool(dbc), "--signals": signals is not None}
        missing = " and ".join(option for option, given in options.items() if not given)
        problem = f"is a CAN log, which needs {missing}"
        raise InputError(path, "", problem, "give the database and the mapping of its signals")
    mapping = load_mapping(signals)
    if pace is not None:
        pace.append(mapping.pace)

    def decoder() -> FrameDecoder:
        return FrameDecoder(
            database, mapping, mapping_file=signals, dbc_file=", ".join(map(str, dbc))
        )

    database = load_database(dbc, strict=mapping.strict)
    ids = decoder().receive_ids
    notes: list[str] = []
    found = _columns(path, decoder(), channel, notes, on_progress)
    if found is None:
        notes.clear()
        log = read_frames(path, ids=ids, channel=channel, notes=notes, on_progress=on_progress)
        found = _one_by_one(decoder(), log)
    found_samples, faults = found.samples, found.faults
    if arrivals is not None and found.arrivals is not None:
        kept = _advances(found.arrivals.sample_ns)
        arrivals.append(
            found.arrivals if kept.all() else Arrivals(*(each[kept] for each in found.arrivals))
        )
    if not found_samples:
        shown = ", ".join(f"0x{i:X}" for i in ids[:_MAX_SHOWN])
        more = ", ..." if len(ids) > _MAX_SHOWN else ""
        problem = f"no mapped frame occurs (ids {shown}{more})"
        raise InputError(path, "", problem, "check the mapping, the DBC and the bus")
    notes += _told(faults, _published_in(mapping.signals))
    notes += _absent(mapping.signals, found_samples)
    series = {name: _series(name, *found_samples.pop(name), notes) for name in [*found_samples]}
    return series, tuple(notes)


def _columns(
    path: Path,
    decoder: FrameDecoder,
    channel: str | None,
    notes: list[str],
    on_progress: Callable[[float], None] | None,
) -> "DecodedColumns | None":
    """The log many frames at once, and notes; None where they are to be read one by one."""
    columns = decoder.columns() if path.suffix.lower() in SUFFIXES else None
    if columns is None:
        return None
    ids = decoder.receive_ids
    for piece in pieces_of(path, ids=ids, notes=notes, channel=channel, on_progress=on_progress):
        if piece is None or not columns.add(piece):
            return None
    return columns.result()


def _one_by_one(decoder: FrameDecoder, frames: Iterable[Frame]) -> "DecodedColumns":
    """Samples by signal, faults by kind and message, and arrivals."""
    from eps_hil.bus.column_decoder import DecodedColumns

    arrived: tuple[array[int], array[int], array[int]] = (array("q"), array("q"), array("q"))
    kept: dict[str, tuple[array[int], array[float]]] = {}
    faults = _Faults(decoder)
    for frame in frames:
        decoded = decoder.decode(frame)
        if decoded and decoder.sync(frame):
            for each, number in zip(
                arrived, (frame.t_ns, decoded[0].t_ns, decoder.moved_ns), strict=True
            ):
                each.append(number)
        for name, t_ns, value in decoded:
            times, values = kept.setdefault(name, (array("q"), array("d")))
            times.append(t_ns)
            values.append(value)
        faults.after(frame)
    samples = {
        name: (np.frombuffer(times, np.int64), np.frombuffer(values, np.float64))
        for name, (times, values) in kept.items()
    }
    arrivals = Arrivals(*(np.frombuffer(each, np.int64) for each in arrived))
    return DecodedColumns(samples, faults.counts, arrivals)


def _published_in(mapped: Mapping[str, SignalSource]) -> set[str]:
    """Messages that carry nothing but what a service published."""
    carried = {source.carrier for name, source in mapped.items() if name not in PUBLISHED}
    own = {source.carrier for name, source in mapped.items() if name in PUBLISHED}
    return {name for name in own - carried if name is not None}


def _told(faults: Mapping[str, Mapping[str, int]], published: set[str]) -> list[str]:
    """One line for each kind that occurred, with its messages; one for each ``published`` one.

    A service's own frames are no input of anything: whether it said "not available" is all in one.
    """
    notes, own = [], dict.fromkeys(sorted(published), "")
    for fault, text in _FAULTS.items():
        counts = dict(faults.get(fault) or {})
        for name in own:
            if count := counts.pop(name, 0):
                own[name] += f"{', ' if own[name] else ''}{count} {text.split(':')[0]}"
        if counts:
            each = ", ".join(f"{name} {count}" for name, count in counts.items())
            notes.append(f"{sum(counts.values())} {text} ({each})")
    return notes + [f"{name}, published by a service: {said}" for name, said in own.items() if said]


class _Faults:
    """What the decoder found wrong, counted by message: a loss matters where it is read."""

    def __init__(self, decoder: FrameDecoder) -> None:
        self._decoder = decoder
        self._told = dict(decoder.faults)
        self._sum = 0
        self.counts: dict[str, dict[str, int]] = {fault: {} for fault in _FAULTS}

    def after(self, frame: Frame) -> None:
        """Put what decoding this frame added down to its message."""
        now = self._decoder.faults
        total = sum(now.values())
        if total == self._sum:
            return
        self._sum = total
        message = self._decoder.message_of(frame)
        for fault, counts in self.counts.items():
            if now[fault] != self._told[fault]:
                more = now[fault] - self._told[fault]
                counts[message] = counts.get(message, 0) + more
                self._told[fault] = now[fault]


def _absent(mapped: Mapping[str, object], samples: Mapping[str, Samples]) -> list[str]:
    absent = [
        name for name in mapped if name not in samples and not getattr(mapped[name], "derived", 0)
    ]
    return [f"signals that never occur: {', '.join(absent)}"] if absent else []


def _advances(t_ns: npt.NDArray[np.int64]) -> npt.NDArray[np.bool_]:
    """Where instants are later than all before: a clock that restarted may step back."""
    kept = np.ones(len(t_ns), bool)
    if (t_ns[1:] <= t_ns[:-1]).any():
        kept[1:] = t_ns[1:] > np.maximum.accumulate(t_ns)[:-1]
    return kept


def _series(
    name: str, t_ns: npt.NDArray[np.int64], value: npt.NDArray[np.float64], notes: list[str]
) -> Series:
    kept = _advances(t_ns)
    if not kept.all():
        count = int(np.count_nonzero(~kept))
        notes.append(f"{name}: {count} samples do not advance in time: left out")
    bad = int(np.count_nonzero(np.isnan(value) & kept))
    if bad > 0 and name not in PUBLISHED:  # of those the message's own note tells
        notes.append(f"{name}: {bad} of {len(t_ns)} samples are marked bad")
    if kept.all():
        return Series(t_ns, value)
    return Series(t_ns[kept], value[kept])
