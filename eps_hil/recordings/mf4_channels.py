"""Channels of a measurement MF4 by the names that its tool gave them, each on its own stamps."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from eps_hil.errors import InputError
from eps_hil.recordings.mf4_file import epoch_ns, opened_mf4, samples_of
from eps_hil.recordings.mf4_values import check_time_axis, signal_of
from eps_hil.recordings.table import check_once, shown
from eps_hil.series import Series

_SHOWN = 8


@dataclass(frozen=True, slots=True)
class Channels:
    """The channels asked for: NaN where a sample is bad (not finite, or marked invalid).

    ``group``: the channel group of each, whose samples share their stamps; ``names``: of all that
    the file has, but a group's time.
    """

    series: dict[str, Series]
    group: dict[str, int]
    names: tuple[str, ...]


def read_channels(
    path: Path, wanted: Sequence[str], *, clock: Sequence[str] = (), events: bool = False
) -> Channels:
    """Those of ``wanted`` that the file has; :class:`InputError` for one that is there twice.

    And for one that is not over time, unless a channel of ``clock`` in its group says the time.
    ``events``: of samples at the same instant the last one counts; else they are refused.
    """
    with opened_mf4(path) as mdf:
        masters = set(mdf.masters_db.items())
        places = [
            (group, index, channel.name)
            for group, content in enumerate(mdf.groups)
            for index, channel in enumerate(content.channels)
            if (group, index) not in masters
        ]
        names = [name for _, _, name in places]
        check_once(path, "", names, wanted, "channel")
        timed = {group for group, _, name in places if name in clock}
        start_ns = epoch_ns(mdf.header.start_time)
        series: dict[str, Series] = {}
        groups: dict[str, int] = {}
        for group, index, name in places:
            if name not in wanted:
                continue
            if group not in timed:
                check_time_axis(path, mdf, group, name)
            signal = signal_of(mdf, group, index)
            if not len(signal.samples):
                raise InputError(path, f"channel {shown(name)}", "has no sample", "record it again")
            if events:
                last = np.append(np.diff(signal.timestamps) > 0, True)
                signal = signal.__class__(
                    signal.samples[last],
                    signal.timestamps[last],
                    name=name,
                    invalidation_bits=None
                    if signal.invalidation_bits is None
                    else np.asarray(signal.invalidation_bits)[last],
                )
            series[name], _ = samples_of(path, name, signal, start_ns)
            groups[name] = group
    return Channels(series, groups, tuple(dict.fromkeys(names)))


def missing_channel(path: Path, name: str, channels: Channels) -> InputError:
    """The error for one that a mapping names and the file lacks."""
    known = ", ".join(channels.names[:_SHOWN])
    return InputError(path, f"channel {shown(name)}", "is missing", f"there are: {known}")
