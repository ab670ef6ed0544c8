"""What a channel of a measurement MF4 holds: numbers over time, or a refusal."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from eps_hil.errors import InputError
from eps_hil.recordings.table import shown

_TO_TEXT, _RANGE_TO_TEXT = 7, 8  # ASAM MDF 4.1, kinds of conversion
_TIME_ELSEWHERE = 1 << 3  # ASAM MDF 4.2, flags of a channel group: its time is another's
_AXES = {2: "an angle", 3: "a distance", 4: "a count"}  # ASAM MDF 4.1, kinds of synchronisation


def check_time_axis(path: Path, mdf: Any, group: int, name: str) -> None:
    """:class:`InputError` where a channel's samples are not over time."""
    about = mdf.groups[group].channel_group
    if getattr(about, "flags", 0) & _TIME_ELSEWHERE:
        group = about.cg_master_index
    master = mdf.masters_db.get(group)
    if master is None:
        problem, remedy = "has no time beside it", "export it with its time"
        raise InputError(path, f"channel {shown(name)}", problem, remedy)
    axis = _AXES.get(getattr(mdf.groups[group].channels[master], "sync_type", 0))
    if axis is not None:
        problem = f"is recorded over {axis}, not over time"
        raise InputError(path, f"channel {shown(name)}", problem, "export it over time")


def signal_of(mdf: Any, group: int, index: int) -> Any:
    """The channel as asammdf has it; of numbers of which some have labels, the numbers.

    Samples with a label (SNA, error) are NaN. Text stays text.
    """
    signal = mdf.get(group=group, index=index, ignore_invalidation_bits=True)
    if signal.samples.dtype.kind in "iufb" or str(mdf.version) < "4":
        return signal
    raw = mdf.get(group=group, index=index, ignore_invalidation_bits=True, raw=True)
    said = raw.conversion
    kind = getattr(said, "conversion_type", None)
    if kind not in (_TO_TEXT, _RANGE_TO_TEXT) or raw.samples.dtype.kind not in "iufb":
        return signal
    labels: Mapping[str, Any] = said.referenced_blocks
    other = labels.get("default_addr")
    numbers = raw.samples.astype(np.float64)
    values = _converted(numbers, other)
    for k in range(said.val_param_nr // (kind - 6)):
        if kind == _TO_TEXT:
            here = numbers == said[f"val_{k}"]
        else:
            here = (numbers >= said[f"lower_{k}"]) & (numbers <= said[f"upper_{k}"])
        label = labels.get(f"text_{k}")
        values[here] = _converted(numbers[here], label) if hasattr(label, "convert") else np.nan
    raw.samples, raw.conversion = values, None
    return raw


def _converted(numbers: Any, by: Any) -> Any:
    """By a conversion, or as they are where there is none; NaN where they are text."""
    if hasattr(by, "convert"):
        found = np.asarray(by.convert(numbers))
        return found.astype(np.float64) if found.dtype.kind in "iufb" else numbers * np.nan
    return numbers * np.nan if by else numbers.copy()
