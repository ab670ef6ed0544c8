"""The logs of a programme as recordings again: cells that follow each other without a gap are one.

A cell's log begins where the one before ended, and an identification learns more from a long
recording (the way to the next cell, reversals, rests) than from many short ones.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from eps_hil.bus.config import BusSetup
from eps_hil.recordings.read import read_recording
from eps_hil.series import Series

_GAP_NS = 20_000_000

Signals = dict[str, Series]


def joined(logs: Sequence[Path], setup: BusSetup) -> dict[str, Signals]:
    """Signals of the logs, in their order, by the name of the first log of each stretch.

    A signal that does not occur in all logs of a stretch is left out there. A cell that was run
    again later, after an interruption, stands between older ones: each side is its own stretch.
    """
    stretches: list[tuple[str, list[Signals]]] = []
    end_ns = 0
    for log in logs:
        signals = dict(read_recording(log, dbc=setup.dbc, signals=setup.signals).series)
        if not signals:
            continue
        first = min(int(one.t_ns[0]) for one in signals.values())
        if not stretches or abs(first - end_ns) > _GAP_NS:
            stretches.append((log.stem, []))
        stretches[-1][1].append(signals)
        end_ns = max(int(one.t_ns[-1]) for one in signals.values())
    return {name: _one(parts) for name, parts in stretches}


def _one(parts: Sequence[Signals]) -> Signals:
    names = set.intersection(*(set(part) for part in parts))
    found = {}
    for name in sorted(names):
        t_ns = np.concatenate([part[name].t_ns for part in parts])
        value = np.concatenate([part[name].value for part in parts])
        # A sample clock starts anew in every log: where two overlap by some µs, the older stays.
        rising = np.concatenate([[True], t_ns[1:] > np.maximum.accumulate(t_ns)[:-1]])
        found[name] = Series(t_ns[rising], value[rising])
    return found
