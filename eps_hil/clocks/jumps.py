"""Jumps of a channel's clock, in the order of the file: before a message's cadence is looked at.

At a jump every message's next interval is longer or shorter by the same time. Where the bus was
silent each interval is longer by whole cycles of its own message. A jump by whole cycles of all
messages looks like silence: then only counters in the payloads tell, or nothing does.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from eps_hil.clocks.counters import Counter, find_counter
from eps_hil.clocks.stamps import Channel, Message

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

FEWEST = 64
CYCLIC = 0.3
"""Of the usual interval: a message whose middle half of intervals spreads more is not cyclic."""
_UNUSUAL = 8.0
"""Deviations of the intervals from which one is looked at, and at most so much of a cycle:"""
_UNUSUAL_SHARE = 0.5
_AROUND = 12
"""Frames of a message on either side of a jump by which it is measured."""
_FEWEST_AROUND = 3
_BURST = 0.7
"""Of the time that so many cycles take: frames in less were held up."""
_PERIOD_SPAN = 256
_PERIOD_ERROR = 2e-7
_SIGMA = 5.0
_LEAST_S = 30e-6
_VAGUE = 0.25
"""Of a cycle: a message that is less sure of its phase has no say in a jump's fraction."""
_MOST_OF = 0.5
_FIT = 0.8
"""Share of the messages whose intervals a jump must explain."""
_MOST_LOOKED_AT = 4_000
_MOST_LOST = 4_000
_NEXT = 1.5
_SILENT_CYCLES = 10
"""Cycles that one message alone must lack before it is called a silence."""


@dataclass(frozen=True, slots=True)
class Jump:
    """Stamps of the channel from ``frame`` (of the file) on are later by ``by_s``.

    ``at_s``: the last stamp before it, since the channel's first. ``or_less_s``: frames may have
    been lost meanwhile, then it is smaller by one of the multiples of this; None where it is not.
    """

    frame: int
    at_s: float
    by_s: float
    sigma_s: float
    or_less_s: float | None = None


@dataclass(frozen=True, slots=True)
class Silence:
    """No message for ``for_s`` longer than usual: lost cycles, or a jump; nothing tells."""

    frame: int
    at_s: float
    for_s: float
    messages: int


@dataclass(frozen=True, slots=True)
class _Track:
    """One cyclic message. ``excess`` (n - 1,): of its intervals beyond the usual one, s."""

    t: Floats
    frame: Integers
    period: float
    unusual: float
    excess: Floats
    counter: Counter | None


@dataclass(frozen=True, slots=True)
class _Interval:
    """One message's interval across a place: longer by ``excess`` than a cycle; frames lost."""

    excess: float
    sigma: float
    period: float
    lost: int | None
    modulus: int
    fell: bool
    """The very stamp after the place is before the one ahead of it."""


def find_jumps(
    channel: Channel, resolution_ns: int = 1
) -> tuple[tuple[Jump, ...], tuple[Silence, ...]]:
    """Jumps of a channel's clock, and silences that may be some."""
    first_ns = int(channel.t_ns[0])
    tracks = [
        track
        for one in channel.messages
        if (track := _track(one, first_ns, resolution_ns)) is not None
    ]
    jumps: list[Jump] = []
    silences: list[Silence] = []
    since = 0
    for frame in _suspects(tracks):
        if frame <= since:
            continue
        across = [one for track in tracks if (one := _across(track, frame, since, resolution_ns))]
        at_s = float(channel.t_ns[frame - 1] - first_ns) * 1e-9
        told = _told(across, frame, at_s, len(tracks))
        if told is None:
            continue
        since = frame
        if isinstance(told, Jump):
            jumps.append(told)
        else:
            silences.append(told)
    return tuple(jumps), tuple(silences)


def without_jumps(channel: Channel, jumps: Sequence[Jump]) -> Channel:
    """The channel with its jumps taken out of its stamps."""
    if not jumps:
        return channel
    t_ns = channel.t_ns.copy()
    for one in jumps:
        t_ns[one.frame :] -= round(one.by_s * 1e9)
    return channel.with_stamps(t_ns)


def _track(message: Message, first_ns: int, resolution_ns: int) -> _Track | None:
    if len(message.t_ns) < FEWEST:
        return None
    t = (message.t_ns - first_ns).astype(np.float64) * 1e-9
    apart = np.diff(t)
    low, period, high = np.percentile(apart, [25, 50, 75])
    if period <= 0.0 or high - low > 2.0 * CYCLIC * period:
        return None
    span = min(_PERIOD_SPAN, len(t) // 4)
    over = t[span:] - t[:-span]
    cycles = np.maximum(np.round(over / period), 1.0)
    period = float(np.median(over / cycles))  # many lost cycles are counted by it
    excess = apart - period
    scale = 1.4826 * float(np.median(np.abs(excess))) + 2e-9 * resolution_ns
    unusual = min(max(_UNUSUAL * scale, _LEAST_S), _UNUSUAL_SHARE * period)
    counter = find_counter(message.data)
    return _Track(t, message.frame, period, unusual, excess, counter)


def _suspects(tracks: Sequence[_Track]) -> list[int]:
    """Frames of the file from which on most messages' next interval is unusual, all alike."""
    if not tracks:
        return []
    found = []
    for sign in (-1.0, 1.0):
        places = [track.frame[1:][sign * track.excess > track.unusual] for track in tracks]
        frames = np.unique(np.concatenate(places))
        unusual = np.zeros(len(frames))
        known = np.zeros(len(frames))
        for track in tracks:
            k = np.searchsorted(track.frame, frames)
            there = (k > 0) & (k < len(track.frame))
            beyond = sign * track.excess[np.clip(k - 1, 0, len(track.excess) - 1)]
            unusual += there & (beyond > track.unusual)
            known += there
        frames = frames[unusual > _MOST_OF * known]
        if len(tracks) == 1:  # only what one message alone can tell, see _of_one
            only = tracks[0]
            beyond = sign * only.excess[np.searchsorted(only.frame, frames) - 1]
            frames = frames[beyond > (1.0 if sign < 0.0 else _SILENT_CYCLES - 1) * only.period]
        if len(frames) > _MOST_LOOKED_AT:  # a log full of losses: the longest are looked at
            fast = min(tracks, key=lambda one: one.period)
            k = np.clip(np.searchsorted(fast.frame, frames) - 1, 0, len(fast.excess) - 1)
            longest = np.argsort(-np.abs(fast.excess[k]), kind="stable")
            frames = frames[longest[:_MOST_LOOKED_AT]]
        found += frames.tolist()
    return sorted(found)


def _across(track: _Track, frame: int, since: int, resolution_ns: int) -> _Interval | None:
    """A message's interval across the place before ``frame``, by the frames around it."""
    after = int(np.searchsorted(track.frame, frame))
    start = max(after - _AROUND, int(np.searchsorted(track.frame, since)))
    stop = min(after + _AROUND, len(track.t))
    if after - start < _FEWEST_AROUND or stop - after < _FEWEST_AROUND:
        return None
    before = _instant(track.t[start:after], -1, _numbers(track, start, after), track.period)
    behind = _instant(track.t[after:stop], 0, _numbers(track, after, stop), track.period)
    if before is None or behind is None:
        return None
    excess = (behind[0] - before[0]) - track.period
    sigma = float(np.hypot(before[1], behind[1])) + 0.3e-9 * resolution_ns
    sigma += _PERIOD_ERROR * abs(excess)
    counter = track.counter
    lost = None if counter is None else counter.lost_between(after - 1, after)
    modulus = 0 if counter is None else counter.modulus
    fell = bool(track.t[after] < track.t[after - 1])
    return _Interval(excess, sigma, track.period, lost, modulus, fell)


def _instant(t: Floats, which: int, cycle: Floats, period: float) -> tuple[float, float] | None:
    """When one frame of a few would have come without its own lateness, and the deviation.

    None for a burst of frames that were held up: they do not tell.
    """
    if t[-1] - t[0] < _BURST * (cycle[-1] - cycle[0]) * period:
        return None
    rest = t - t[which] - (cycle - cycle[which]) * period
    rest = rest - np.round((rest - np.median(rest)) / period) * period  # beyond a loss
    centre = float(np.median(rest))
    spread = 1.4826 * float(np.median(np.abs(rest - centre)))
    return float(t[which] + centre), 1.25 * spread / np.sqrt(len(t)) + 1e-7


def _numbers(track: _Track, start: int, stop: int) -> Floats:
    """Cycles of neighbouring frames: by their counter, else one after the other."""
    if track.counter is None:
        return np.arange(stop - start, dtype=np.float64)
    more = np.diff(track.counter.values[start:stop]) % track.counter.modulus
    more = np.where((more > 0) & (more <= _AROUND), more, 1)
    return np.concatenate([[0.0], np.cumsum(more)])


def _told(
    across: Sequence[_Interval], frame: int, at_s: float, tracks: int
) -> Jump | Silence | None:
    """What one place is: a jump, a silence that may be one, or (None) nothing of the clock's."""
    if len(across) <= _MOST_OF * tracks:
        return None
    fits = _sizes(across)
    if not fits:
        return None
    size, decided = fits[0], False
    for choices in ((fits[0], 0.0), fits):  # nothing was lost, or nothing jumped; else anything
        counted = [one for one in choices if one in fits and _counted(across, one)]
        if len(counted) == 1 and not decided:
            size, decided = counted[0], True
    sigma = float(sum(one.sigma**-2 for one in across) ** -0.5)
    if tracks == 1:  # its sender may have waited; but no frame of one message overtakes another
        return _of_one(across[0], Jump(frame, at_s, size, sigma))
    if abs(size) <= _LEAST_S:
        return None
    silent = any(abs(one) <= _LEAST_S for one in fits)
    if silent and not decided:
        slow = max(across, key=lambda one: one.period)
        # the quartzes of the senders differ: after a long silence only losses fit them all
        whole = slow.excess - size < _NEXT * slow.period
        return Silence(frame, at_s, size, len(across)) if whole else None
    others = [one for one in fits[1:] if abs(one) > _LEAST_S and one > 0.0]
    or_less = size - others[0] if others and not decided and size > 0.0 else None
    return Jump(frame, at_s, size, sigma, or_less)


def _of_one(across: _Interval, jump: Jump) -> Jump | Silence | None:
    if across.fell and across.excess < -across.period:
        return replace(jump, by_s=across.excess)
    lost = round(across.excess / across.period)
    counted = bool(across.lost) and (lost - (across.lost or 0)) % across.modulus == 0
    if lost < _SILENT_CYCLES or counted:
        return None
    return Silence(jump.frame, jump.at_s, across.excess, 1)


def _sizes(across: Sequence[_Interval]) -> list[float]:
    """Jumps that most intervals fit, each with some lost cycles; the fewest lost come first."""
    slow = max(across, key=lambda one: one.period)
    most_lost = min(max(round(slow.excess / slow.period), 0), _MOST_LOST)
    found: list[float] = []
    for lost in range(most_lost + 1):
        size = slow.excess - lost * slow.period
        cycles = [_cycles(one, size, slow) for one in across]
        fit = [(one, n) for one, n in zip(across, cycles, strict=True) if n is not None and n >= 0]
        if len(fit) < _FIT * len(across):
            continue
        sure = [(one, n) for one, n in fit if _sure(one, slow)]
        weight = np.array([one.sigma**-2 for one, _ in sure])
        sizes = np.array([one.excess - n * one.period for one, n in sure])
        size = float(np.sum(weight * sizes) / np.sum(weight))
        clear = max(_LEAST_S, _SIGMA * float(np.sum(weight)) ** -0.5)
        found.append(size if abs(size) > clear else 0.0)
    return found


def _tolerance(one: _Interval, slow: _Interval) -> float:
    return _SIGMA * float(np.hypot(one.sigma, slow.sigma)) + _LEAST_S


def _sure(one: _Interval, slow: _Interval) -> bool:
    return one is slow or _tolerance(one, slow) <= _VAGUE * one.period


def _cycles(one: _Interval, size: float, slow: _Interval) -> int | None:
    """Cycles that a message lost beside a jump; None where its interval does not fit."""
    x = (one.excess - size) / one.period
    n = round(x)
    return n if abs(x - n) * one.period <= _tolerance(one, slow) else None


def _counted(across: Sequence[_Interval], size: float) -> bool:
    """The counters counted the frames that are lost with a jump of this size."""
    right = [
        (round((one.excess - size) / one.period) - one.lost) % one.modulus == 0
        for one in across
        if one.lost is not None
    ]
    return sum(right) >= _FIT * len(right) if right else False
