"""Two channels' clocks against each other, by frames that both have (a gateway, two interfaces)."""

from collections import defaultdict, deque
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from eps_hil.clocks.cadence import Line, line_with_steps
from eps_hil.clocks.stamps import Channel, Message

Floats = npt.NDArray[np.float64]

FEWEST = 50
_APART_NS = 500_000_000
"""Frames of equal content further apart than this are not the same frame."""
_MOST = 40_000
_BLOCKS = 60


@dataclass(frozen=True, slots=True)
class Between:
    """Stamps of ``channel`` less those of ``reference``: at the log's start, and how they drift.

    Half widths at 95 %. ``pairs``: frames that both channels have.
    """

    channel: str
    reference: str
    pairs: int
    line: Line
    """The difference over time since the log's start, s, with its steps."""
    offset_s: float
    offset_half_width_s: float
    drift_ppm: float
    drift_half_width_ppm: float
    jitter_s: float


def between(
    channel: Channel, reference: Channel, start_ns: int, least_s: float = 30e-6
) -> Between | None:
    """How ``channel``'s clock lies to the ``reference``'s; None where no frame is on both.

    ``least_s``: smallest step that is looked for.
    """
    theirs = {(one.can_id, one.extended): one for one in reference.messages}
    at, apart = [], []
    for one in channel.messages:
        other = theirs.get((one.can_id, one.extended))
        if other is not None:
            a, b = _same_frames(one, other)
            at.append(b)
            apart.append(a - b)
    t_ns = np.concatenate(at) if at else np.zeros(0, np.int64)
    if len(t_ns) < FEWEST:
        return None
    order = np.argsort(t_ns, kind="stable")
    t: Floats = np.asarray((t_ns - start_ns)[order] * 1e-9, np.float64)
    difference: Floats = np.asarray(np.concatenate(apart)[order] * 1e-9, np.float64)
    groups = np.array_split(np.arange(len(t)), min(_BLOCKS, max(len(t) // 8, 2)))
    middle = np.array([float(np.mean(t[g])) for g in groups], np.float64)
    usual = np.array([float(np.median(difference[g])) for g in groups], np.float64)
    line = line_with_steps(middle, usual, least_s)
    before = float(line.at(np.zeros(1))[0])
    wide = float(np.hypot(line.errors[0], line.middle_s * line.slope_sigma))
    jitter = np.subtract(difference, line.at(t))
    return Between(
        channel=channel.name,
        reference=reference.name,
        pairs=len(t),
        line=line,
        offset_s=before,
        offset_half_width_s=1.96 * wide,
        drift_ppm=1e6 * line.slope,
        drift_half_width_ppm=1.96e6 * line.slope_sigma,
        jitter_s=float(np.sqrt(np.mean(jitter**2))),
    )


def _same_frames(
    one: Message, other: Message
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Stamps of both for the frames of equal content that are next to each other in time."""
    waiting: dict[bytes, deque[int]] = defaultdict(deque)
    for t, data in zip(other.t_ns[:_MOST].tolist(), other.data, strict=False):
        waiting[data].append(t)
    mine, theirs = [], []
    for t, data in zip(one.t_ns[:_MOST].tolist(), one.data, strict=False):
        queue = waiting.get(data)
        while queue and queue[0] < t - _APART_NS:
            queue.popleft()
        # the next of the same content is nearer where this one was lost on one channel
        while queue and len(queue) > 1 and abs(queue[1] - t) < abs(queue[0] - t):
            queue.popleft()
        if queue and abs(queue[0] - t) <= _APART_NS:
            mine.append(t)
            theirs.append(queue.popleft())
    return np.array(mine, dtype=np.int64), np.array(theirs, dtype=np.int64)
