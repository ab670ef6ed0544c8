"""The listener's samples as JSON datagrams, as PlotJuggler's "UDP Server" takes them.

One object an instant, a datagram each: ``{"timestamp": 1790000000.001, "eps_hil": {...}}``, with
every trace at that instant, and four times a second one with the monitor's figures under
``state``. Every datagram has its ``timestamp`` (PlotJuggler gives the field up for good after one
without), and no NaN, which its parser takes for the end of the stream.
"""

import json
import math
import socket
from collections.abc import Mapping
from typing import Any

import numpy as np

from eps_hil.dashboard.decimate import Int64, at_instants
from eps_hil.dashboard.store import Block
from eps_hil.errors import InputError
from eps_hil.recordings.json_rows import TOPIC, row

PORT = 9870
"""Where PlotJuggler listens unless it is told otherwise."""
_NS = 1_000_000_000
_SILENT_NS = 200_000_000
"""A trace without a sample for so long is not waited for."""
_BEFORE_NS = 500_000_000
"""What is kept of a trace, to be linear between its samples."""
_STATE = ("bus", "estimate", "residual")


def address_of(text: str) -> tuple[str, int]:
    """``host:port``, or ``host`` alone; :class:`InputError` where it is neither or unknown."""
    host, colon, port = text.rpartition(":")
    if not colon or text.endswith("]"):
        host, port = text, str(PORT)
    remedy = f"say HOST:PORT, for instance 127.0.0.1:{PORT}"
    if not host or not port.isdigit() or not 0 < int(port) < 65536:
        raise InputError(text, "", "is no address", remedy)
    name = host.strip("[]")
    try:
        socket.getaddrinfo(name, int(port), type=socket.SOCK_DGRAM)
    except OSError:
        raise InputError(text, "", f"'{name}' is not known as a host", remedy) from None
    return name, int(port)


class JsonStream:
    """An outlet of the listener: traces at ``rate_hz`` to a UDP address. Waits for nobody."""

    def __init__(self, address: tuple[str, int], rate_hz: float = 1000.0) -> None:
        family, _, _, _, where = socket.getaddrinfo(*address, type=socket.SOCK_DGRAM)[0]
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._where = where
        self._period_ns = round(_NS / rate_hz)
        self._kept: dict[str, Block] = {}
        self._sent_ns: int | None = None
        self.sent = self.dropped = 0

    def samples(self, blocks: dict[str, Block]) -> None:
        """Take new samples, and send the instants that every trace has reached."""
        for name, (t_ns, value) in blocks.items():
            self._take(name, t_ns, value)
        at_ns = self._due()
        if not len(at_ns):
            return
        columns = {n: at_instants(*one, at_ns).tolist() for n, one in self._kept.items()}
        for k, stamp in enumerate(at_ns.tolist()):
            self._send(stamp, row({name: column[k] for name, column in columns.items()}))
        self._sent_ns = int(at_ns[-1])
        for name, (t_ns, value) in self._kept.items():
            since = int(np.searchsorted(t_ns, self._sent_ns - _BEFORE_NS))
            self._kept[name] = t_ns[since:], value[since:]

    def state(self, content: Mapping[str, Any]) -> None:
        """The monitor's figures, those that are numbers."""
        told = {name: _numbers(content.get(name, {})) for name in _STATE}
        told["listener"] = {"dropped": self.dropped}
        self._send(int(content["t_ns"]), {"state": told})

    def flush(self) -> bool:
        """Nothing waits here; True, for a receiver may come and go."""
        return True

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()

    def _take(self, name: str, t_ns: Int64, value: Any) -> None:
        before = self._kept.get(name)
        if before is not None and len(before[0]) and len(t_ns):
            if t_ns[0] < before[0][-1] - _NS:  # the clock was set back: begin anew
                self._kept, self._sent_ns, before = {}, None, None
            else:
                t_ns, value = np.append(before[0], t_ns), np.append(before[1], value)
        newest = np.maximum.accumulate(t_ns)
        rising = np.append(True, t_ns[1:] > newest[:-1])[: len(t_ns)]
        self._kept[name] = t_ns[rising], value[rising]

    def _due(self) -> Int64:
        """Whole multiples of the period that are not sent yet and that no trace still lacks.

        None within a silence: it may be a night, or a clock that was set forward by years.
        """
        ends = [int(t_ns[-1]) for t_ns, _ in self._kept.values() if len(t_ns)]
        if not ends:
            return np.empty(0, np.int64)
        end_ns = min(end for end in ends if end > max(ends) - _SILENT_NS)
        first_ns = min(int(t_ns[0]) for t_ns, _ in self._kept.values() if len(t_ns))
        begin_ns = first_ns if self._sent_ns is None else max(self._sent_ns + 1, first_ns)
        heard = np.sort(np.concatenate([t_ns for t_ns, _ in self._kept.values()]))
        heard = heard[(heard > begin_ns) & (heard <= end_ns)]
        silent = np.flatnonzero(np.diff(heard, prepend=begin_ns) > _SILENT_NS)
        begins = [begin_ns, *heard[silent].tolist()]
        ends = [*np.append(begin_ns, heard)[silent].tolist(), end_ns]
        period = self._period_ns
        runs = [
            np.arange(-(-begin // period) * period, end + 1, period, dtype=np.int64)
            for begin, end in zip(begins, ends, strict=True)
        ]
        return np.concatenate(runs)

    def _send(self, t_ns: int, content: dict[str, Any]) -> None:
        if not content:
            return
        text = json.dumps({"timestamp": t_ns / _NS, TOPIC: content}, allow_nan=False)
        try:
            self._socket.sendto(text.encode(), self._where)
            self.sent += 1
        except OSError:  # no room, or nobody there: the next one may get through
            self.dropped += 1


def _numbers(figures: Mapping[str, Any]) -> dict[str, float]:
    return {
        name: value
        for name, value in figures.items()
        if isinstance(value, int | float) and math.isfinite(value)
    }
