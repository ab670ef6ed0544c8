"""CAN log + DBC + mapping -> signals, through the same decoder that the live service uses."""

from array import array
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from eps_hil.bus.codec import FrameDecoder
from eps_hil.bus.database import load_database
from eps_hil.bus.frame import Frame
from eps_hil.bus.mapping import load_mapping
from eps_hil.errors import InputError
from eps_hil.recordings.can_log import read_frames
from eps_hil.recordings.files import check_readable
from eps_hil.series import Series

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

Samples = tuple["array[int]", "array[float]"]


def read_log(
    path: Path,
    *,
    dbc: Sequence[Path],
    signals: Path | None,
    channel: str | None = None,
    on_progress: Callable[[float], None] | None = None,
) -> tuple[dict[str, Series], tuple[str, ...]]:
    """Series of every mapped signal that occurs, and notes on what was lost or left out.

    A frame with a wrong CRC or length gives samples with the value NaN, here as live.
    Raises :class:`InputError` for a broken log, mapping or DBC, and if no mapped frame occurs.
    """
    check_readable(path)
    if not dbc or signals is None:
        options = {"--dbc": bool(dbc), "--signals": signals is not None}
        missing = " and ".join(option for option, given in options.items() if not given)
        problem = f"is a CAN log, which needs {missing}"
        raise InputError(path, "", problem, "give the database and the mapping of its signals")
    mapping = load_mapping(signals)
    decoder = FrameDecoder(
        load_database(dbc, strict=mapping.strict),
        mapping,
        mapping_file=signals,
        dbc_file=", ".join(map(str, dbc)),
    )
    notes: list[str] = []
    samples: dict[str, Samples] = {}
    faults = _Faults(decoder)
    for frame in read_frames(
        path, ids=decoder.receive_ids, channel=channel, notes=notes, on_progress=on_progress
    ):
        for name, t_ns, value in decoder.decode(frame):
            times, values = samples.setdefault(name, (array("q"), array("d")))
            times.append(t_ns)
            values.append(value)
        faults.after(frame)
    if not samples:
        ids = ", ".join(f"0x{i:X}" for i in decoder.receive_ids[:_MAX_SHOWN])
        more = ", ..." if len(decoder.receive_ids) > _MAX_SHOWN else ""
        problem = f"no mapped frame occurs (ids {ids}{more})"
        raise InputError(path, "", problem, "check the mapping, the DBC and the bus")
    notes += faults.notes()
    notes += _absent(mapping.signals, samples)
    series = {name: _series(name, *samples[name], notes) for name in samples}
    return series, tuple(notes)


class _Faults:
    """What the decoder found wrong, counted by message: a loss matters where it is read."""

    def __init__(self, decoder: FrameDecoder) -> None:
        self._decoder = decoder
        self._told = dict(decoder.faults)
        self._sum = 0
        self._counts: dict[str, dict[str, int]] = {fault: {} for fault in _FAULTS}

    def after(self, frame: Frame) -> None:
        """Put what decoding this frame added down to its message."""
        now = self._decoder.faults
        total = sum(now.values())
        if total == self._sum:
            return
        self._sum = total
        message = self._decoder.message_of(frame)
        for fault, counts in self._counts.items():
            if now[fault] != self._told[fault]:
                more = now[fault] - self._told[fault]
                counts[message] = counts.get(message, 0) + more
                self._told[fault] = now[fault]

    def notes(self) -> list[str]:
        """One line for each kind that occurred, with its messages."""
        return [
            f"{sum(counts.values())} {_FAULTS[fault]} "
            f"({', '.join(f'{name} {count}' for name, count in counts.items())})"
            for fault, counts in self._counts.items()
            if counts
        ]


def _absent(mapped: Mapping[str, object], samples: Mapping[str, Samples]) -> list[str]:
    absent = [
        name for name in mapped if name not in samples and not getattr(mapped[name], "derived", 0)
    ]
    return [f"signals that never occur: {', '.join(absent)}"] if absent else []


def _series(name: str, times: "array[int]", values: "array[float]", notes: list[str]) -> Series:
    t_ns = np.frombuffer(times, dtype=np.int64)
    value = np.frombuffer(values, dtype=np.float64)
    newest = np.maximum.accumulate(t_ns)
    kept = np.concatenate(([True], t_ns[1:] > newest[:-1]))  # a clock that restarted may step back
    if not kept.all():
        count = int(np.count_nonzero(~kept))
        notes.append(f"{name}: {count} samples do not advance in time: left out")
    if (bad := int(np.count_nonzero(np.isnan(value[kept])))) > 0:
        notes.append(f"{name}: {bad} of {len(t_ns)} samples are marked bad")
    return Series(t_ns[kept].copy(), value[kept].copy())
