"""Frames that two channels both have, by their payloads, however far apart the clocks are.

First the coarse difference of the clocks, in windows along the log: each payload votes for the
differences to all frames of the other channel that have it too. Then each frame is matched around
that, where its payload is alone.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from eps_hil.clocks.stamps import Channel, Message

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

FEWEST = 50
_MOST = 200_000
"""Frames of a message that are looked for on the reference, evenly over the log."""
_WINDOWS = 40
_WINDOW_NS = 4_000_000_000
_MOST_VOTERS = 256
_FEWEST_VOTERS = 4
_MOST_VOTES = 30_000
_WITHIN_NS = (600_000_000_000, 60_000_000_000, 5_000_000_000, 500_000_000)
"""Where payloads repeat too often to compare all of them: clocks are this near, at most."""
_WIDE_NS = 2_000_000
_OF_REPEAT = 0.25
_THERE = 0.3
"""Share of a window's frames that must have a partner."""
_FITS = 0.75
"""Of the best share: another difference from here on fits as well."""
_NEAR_NS = 50_000_000
"""A frame is matched this near to the coarse difference, and no other like it within twice."""
_ECHO_NS = 500_000
"""The same payload again within this is the logger's own frame, sent and received."""
_FAST = 500e-6
"""Drift that two quartzes have at most."""
_AROUND_NS = 100_000_000_000
"""How far from a window the coarse difference is taken to hold."""


@dataclass(frozen=True, slots=True)
class Same:
    """Stamps (n,) of both channels for the frames they share, in the order of the second.

    ``within_s``: what was taken for granted of the clocks, None where nothing was.
    """

    t_ns: Integers
    reference_ns: Integers
    within_s: float | None


@dataclass(frozen=True, slots=True)
class Ambiguous:
    """Several differences fit alike: ``nearest_ns`` and others, ``apart_ns`` from it."""

    nearest_ns: int
    apart_ns: int


@dataclass(frozen=True, slots=True)
class _Shared:
    """One message on both channels; the reference's frames sorted by payload, then by stamp.

    ``key``: payload and stamp of each of those in one number that rises.
    """

    t: Integers
    code: Integers
    theirs: Integers
    their_code: Integers
    wide_ns: int
    first_ns: int
    unit_ns: int
    span: int
    key: Integers

    def place(self, code: Integers, t: Integers) -> Integers:
        """Where stamps (n,) would stand among the reference's frames of equal payload."""
        clipped = np.clip((t - self.first_ns) // self.unit_ns + 1, 0, self.span - 1)
        return np.searchsorted(self.key, code * self.span + clipped, "left")

    def votes(self, at: Integers, centre_ns: int, within_ns: int | None) -> Integers | None:
        """Differences of some frames to all of equal payload, sorted; None where too many."""
        code, t = self.code[at], self.t[at]
        if within_ns is None:
            low = np.searchsorted(self.their_code, code, "left")
            high = np.searchsorted(self.their_code, code, "right")
        else:
            low = self.place(code, t - centre_ns - within_ns)
            high = self.place(code, t - centre_ns + within_ns)
        count = high - low
        if int(np.sum(count)) > _MOST_VOTES:
            return None
        each = np.repeat(np.arange(len(at)), count)
        place = np.arange(len(each)) - np.repeat(np.cumsum(count) - count, count) + low[each]
        return np.sort(t[each] - self.theirs[place])


@dataclass(frozen=True, slots=True)
class _Vote:
    differences: Integers
    voters: int
    wide_ns: int
    within_ns: int | None


def same_frames(channel: Channel, reference: Channel) -> Same | Ambiguous | None:
    """The frames of ``channel`` that ``reference`` has too; None where there are none.

    A message's stamps are taken to rise but for single frames: jumps have been taken out.
    """
    theirs = {(one.can_id, one.extended): one for one in reference.messages}
    shared = [
        _shared(one, other)
        for one in channel.messages
        if (other := theirs.get((one.can_id, one.extended))) is not None
    ]
    if sum(min(len(one.t), len(one.theirs)) for one in shared) < FEWEST:
        return None
    centre_ns = _centre(channel, reference)
    edges = np.linspace(int(channel.t_ns.min()), int(channel.t_ns.max()), _WINDOWS + 1)
    windows = []
    within: int | None = None
    for start in edges[:-1].astype(np.int64).tolist():
        fits, restricted = _differences(shared, start, centre_ns)
        windows.append((start, fits))
        if len(fits) == 1 and restricted is not None:
            within = restricted
    kept = _agreeing([(start, fits[0]) for start, fits in windows if len(fits) == 1])
    others = _others(windows, kept, reference)
    if others or not kept:
        several = [fits for _, fits in windows if len(fits) > 1]
        if not several:
            return None
        fewest = min(several, key=len)
        nearest = min(fewest, key=lambda one: abs(one - centre_ns))
        return Ambiguous(nearest, min(others, default=int(np.min(np.diff(sorted(fewest))))))
    parts = [_matched(one, kept, float(edges[1] - edges[0])) for one in shared]
    t = np.concatenate([a for a, _ in parts])
    their_t = np.concatenate([b for _, b in parts])
    if len(t) < FEWEST:
        return None
    order = np.argsort(their_t, kind="stable")
    return Same(t[order], their_t[order], None if within is None else within * 1e-9)


def _centre(channel: Channel, reference: Channel) -> int:
    """A first guess: none where the stamps overlap, else that both began together."""
    a, b = channel.t_ns, reference.t_ns
    overlap = min(int(a.max()), int(b.max())) > max(int(a.min()), int(b.min()))
    return 0 if overlap else int(a.min()) - int(b.min())


def _shared(one: Message, other: Message) -> _Shared:
    # the hash is of 64 bits: two payloads that share it do not occur
    by_time = np.argsort(one.t_ns, kind="stable")
    by_time = by_time[:: len(by_time) // _MOST + 1]
    mine = one.data.hashes()[by_time]
    payload = other.data.hashes()
    order = np.lexsort((other.t_ns, payload))
    theirs, payload = other.t_ns[order], payload[order]
    begins = np.flatnonzero(np.diff(payload, prepend=payload[0] - 1))
    their_code = np.zeros(len(payload), np.int64)
    their_code[begins[1:]] = 1
    their_code = np.cumsum(their_code)
    kinds = payload[begins]
    code = np.minimum(np.searchsorted(kinds, mine), len(kinds) - 1)
    code[kinds[code] != mine] = len(kinds)  # not among the reference's
    apart = np.diff(theirs)[np.diff(their_code) == 0]
    apart = apart[apart > _ECHO_NS]
    wide = _WIDE_NS if not len(apart) else min(_WIDE_NS, int(_OF_REPEAT * float(np.median(apart))))
    first = int(theirs.min())
    unit = int(theirs.max() - first + 4) * (len(kinds) + 1) // 2**62 + 1
    span = int(theirs.max() - first) // unit + 3
    key = their_code * span + (theirs - first) // unit + 1
    t = one.t_ns[by_time]
    return _Shared(t, code, theirs, their_code, max(wide, 1), first, unit, span, key)


def _differences(
    shared: Sequence[_Shared], start_ns: int, centre_ns: int
) -> tuple[list[int], int | None]:
    """Differences that fit all messages in one window, and how near they were looked for."""
    votes = []
    for one in shared:
        low, high = np.searchsorted(one.t, [start_ns, start_ns + _WINDOW_NS])
        if high - low >= _FEWEST_VOTERS:
            step = -(-int(high - low) // _MOST_VOTERS)
            votes.append(_vote(one, np.arange(low, high, step), centre_ns))
    # the message that is looked at the widest, of those the one that says the most
    votes.sort(key=lambda one: (-(one.within_ns or 2**62), len(one.differences) / one.voters))
    for k, first in enumerate(votes):
        peaks, share = _peaks(first)
        if len(peaks):
            others = [*votes[:k], *votes[k + 1 :]]
            return peaks[_fit(peaks, share, others, centre_ns) >= _FITS].tolist(), first.within_ns
    return [], None


def _fit(
    peaks: Integers, share: Floats, others: Sequence[_Vote], centre_ns: int
) -> npt.NDArray[np.float64]:
    """How well each difference fits the message that fits it the worst, against its best one."""
    fit = share / np.max(share)
    for one in others:
        wide = one.wide_ns + _WIDE_NS
        high = np.searchsorted(one.differences, peaks + wide, "right")
        count = high - np.searchsorted(one.differences, peaks - wide, "left")
        seen = np.ones(len(peaks), bool)
        if one.within_ns is not None:
            seen = np.abs(peaks - centre_ns) < one.within_ns
        most = float(np.max(count[seen], initial=0.0))
        if most >= _THERE * one.voters:
            fit = np.where(seen, np.minimum(fit, count / most), fit)
    return fit


def _vote(one: _Shared, at: Integers, centre_ns: int) -> _Vote:
    for within in (None, *_WITHIN_NS):
        found = one.votes(at, centre_ns, within)
        if found is not None:
            return _Vote(found, len(at), one.wide_ns, within)
    if len(at) > _FEWEST_VOTERS:
        return _vote(one, at[::2], centre_ns)
    return _Vote(np.zeros(0, np.int64), len(at), one.wide_ns, _WITHIN_NS[-1])


def _peaks(vote: _Vote) -> tuple[Integers, Floats]:
    """Differences that many frames of a window vote for, and the share of the frames."""
    found = vote.differences
    if not len(found):
        return found, np.zeros(0)
    count = np.searchsorted(found, found + vote.wide_ns, "right") - np.searchsorted(
        found, found - vote.wide_ns, "left"
    )
    most = int(np.max(count))
    if most < max(_THERE * vote.voters, _FEWEST_VOTERS):
        return np.zeros(0, np.int64), np.zeros(0)
    high = np.flatnonzero(count >= 0.5 * most)
    groups = np.split(high, np.flatnonzero(np.diff(found[high]) > vote.wide_ns) + 1)
    best = np.array([int(g[np.argmax(count[g])]) for g in groups])
    middle = [int(np.median(found[g][count[g] >= 0.9 * np.max(count[g])])) for g in groups]
    return np.array(middle, np.int64), count[best] / vote.voters


def _agreeing(nodes: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
    """Windows whose difference a neighbour confirms; none where chance made most of them."""
    if len(nodes) < 3:
        return list(nodes)

    def alike(one: tuple[int, int], other: tuple[int, int]) -> bool:
        return abs(one[1] - other[1]) <= _NEAR_NS + _FAST * abs(one[0] - other[0])

    kept = [
        node
        for k, node in enumerate(nodes)
        if any(alike(node, nodes[j]) for j in (k - 1, k + 1) if 0 <= j < len(nodes))
    ]
    return kept if len(kept) > 0.5 * len(nodes) else []


def _others(
    windows: Sequence[tuple[int, Sequence[int]]],
    kept: Sequence[tuple[int, int]],
    reference: Channel,
) -> list[int]:
    """How far from the difference others lie that fit windows and that no window speaks against.

    A window speaks against one that it does not fit though the reference has frames there.
    """
    if not kept:
        return []
    at = np.array([start for start, _ in kept])
    first, last = int(reference.t_ns.min()), int(reference.t_ns.max()) - _WINDOW_NS
    open_: list[int] = []
    for start, fits in windows:
        if len(fits) > 1:
            expected = kept[int(np.argmin(np.abs(at - start)))][1]
            nearest = min(fits, key=lambda one: abs(one - expected))
            open_ += [one - nearest for one in fits if one != nearest]
    found = []
    for apart in {round(one / _NEAR_NS) * _NEAR_NS: one for one in open_}.values():
        against = [t for t, one in kept if first <= t - one - apart <= last]
        if not against:
            found.append(abs(apart))
    return found


def _matched(
    one: _Shared, nodes: Sequence[tuple[int, int]], window_ns: float
) -> tuple[Integers, Integers]:
    """Stamps of both for the frames that have one partner near the coarse difference."""
    at = np.array([t for t, _ in nodes], np.int64)
    difference = np.array([d for _, d in nodes], np.int64)
    after = np.searchsorted(at, one.t)
    partner = np.full((2, len(one.t)), -1, np.int64)
    for row, node in enumerate((after - 1, after)):
        k = np.clip(node, 0, len(at) - 1)
        near = np.abs(one.t - at[k]) < max(_AROUND_NS, 2.0 * window_ns)
        partner[row] = np.where(near, _partners(one, one.t - difference[k]), -1)
    left, right = partner
    told = (left < 0) | (right < 0) | (left == right)  # two partners: one is chance
    chosen = np.where(told, np.maximum(left, right), -1)
    mine = np.flatnonzero(chosen >= 0)
    mine = mine[np.unique(chosen[mine], return_index=True)[1]]
    return one.t[mine], one.theirs[chosen[mine]]


def _partners(one: _Shared, expected: Integers) -> Integers:
    """The reference's frame next to the expected stamp, -1 where none or a second is near."""
    low = one.place(one.code, expected - 2 * _NEAR_NS)
    high = one.place(one.code, expected + 2 * _NEAR_NS)
    place = np.clip(low, 0, len(one.theirs) - 1)
    near = np.abs(one.theirs[place] - expected) <= _NEAR_NS
    last = np.clip(high - 1, 0, len(one.theirs) - 1)
    alone = (high > low) & (one.theirs[last] - one.theirs[place] <= _ECHO_NS)
    return np.where(alone & near, place, -1)
