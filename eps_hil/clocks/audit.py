"""The clocks of a CAN log judged: each message, each channel, each pair of channels."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from eps_hil.clocks.between import Between, Untied, between
from eps_hil.clocks.cadence import Cadence, Step, cadence, located, resolution_ns
from eps_hil.clocks.jumps import Jump, Silence, find_jumps, without_jumps
from eps_hil.clocks.stamps import Channel, Message, read_channels

SCHEMA = "eps-hil/clocks/1"

_COARSE_NS = 50_000
"""A resolution from here on is worse than what a kernel's own stamp has."""
_BATCHED = 0.02
"""Share of frames with the very stamp of the one before: one bus cannot do that."""
_HARDWARE_S = 20e-6
"""Lateness at the 99th percentile that no scheduler reaches on a busy machine."""
_SAME_TIME_S = 1.5
_SAME_SIZE = 0.3
_OF_CYCLE = 0.1
_CLEAR = 6.0
_LEAST_S = 30e-6
_MOST_OF = 0.5
"""Of a channel's cyclic messages that would show it: beyond, a step is the channel's clock's."""
_TURNS = 3
_SAME_STEP_S = 1e-3
"""Step between channels and silence on one of them: the same up to the stamps' lateness."""


@dataclass(frozen=True, slots=True)
class ChannelAudit:
    """One channel. ``steps``: of its clock, seen in most messages; ``source``: words.

    ``straight``: its frames with stamps without those steps.
    """

    channel: Channel
    messages: tuple[tuple[Message, Cadence | None], ...]
    resolution_ns: int
    same_stamp_share: float
    steps: tuple[Step, ...]
    slipped: tuple[tuple[str, Step], ...]
    """Steps of single messages: their place in the sender's schedule moved."""
    source: str
    silences: tuple[Silence, ...]
    """Lost cycles of all messages, or a jump of the clock: nothing tells which."""
    jumps: tuple[Jump, ...]
    """Those of ``steps`` that the order of the file shows."""
    straight: Channel

    @property
    def noise_s(self) -> float:
        """Least lateness at the 99th percentile of its messages; infinite where none is cyclic."""
        late = [one.late_p99_s for _, one in self.messages if one is not None]
        return max(min(late, default=np.inf), self.resolution_ns * 1e-9)

    @property
    def went_back(self) -> tuple[int, int]:
        """Frames before an earlier one of the file, but for steps of the clock; the most, ns."""
        back = -np.diff(self.channel.t_ns)
        back[[one.frame - 1 for one in self.jumps]] = 0
        return int(np.sum(back > 0)), int(np.max(back, initial=0))


@dataclass(frozen=True, slots=True)
class Audit:
    """A whole log. ``reference``: the channel with the best stamps."""

    path: Path
    channels: tuple[ChannelAudit, ...]
    reference: str
    pairs: tuple[Between, ...]
    untied: tuple[Untied, ...]

    def content(self) -> dict[str, Any]:
        """For the JSON; times in seconds."""
        return {
            "schema": SCHEMA,
            "recording": str(self.path),
            "reference": self.reference,
            "channels": [_channel(one) for one in self.channels],
            "between": [
                {
                    "channel": one.channel,
                    "reference": one.reference,
                    "pairs": one.pairs,
                    "offset_s": one.offset_s,
                    "offset_ci95": _around(one.offset_s, one.offset_half_width_s),
                    "drift_ppm": one.drift_ppm,
                    "drift_ci95": _around(one.drift_ppm, one.drift_half_width_ppm),
                    "steps": [_step(step) for step in one.line.steps],
                    "jitter_s": one.jitter_s,
                    "taken_to_be_within_s": one.within_s,
                }
                for one in self.pairs
            ],
            "not_comparable": [
                {"channel": one.channel, "reference": one.reference, "why": one.why}
                for one in self.untied
            ],
        }


def audit(path: str | Path, on_progress: Callable[[float], None] | None = None) -> Audit:
    """Judge the stamps of a CAN log; :class:`InputError` where it is none."""
    channels = read_channels(path, on_progress)
    told = [judged(one, *find_jumps(one, resolution_ns(one.t_ns))) for one in channels]
    best = min(told, key=lambda one: one.noise_s).channel.name
    for turn in range(_TURNS):  # again where the channels told whose a step is
        reference = next(one for one in told if one.channel.name == best)
        found = [between(one.straight, reference.straight) for one in told if one is not reference]
        pairs = tuple(one for one in found if isinstance(one, Between))
        more = _told_by_others(told, best, pairs) if turn < _TURNS - 1 else told
        if all(one is other for one, other in zip(more, told, strict=True)):
            break
        told = more
    untied = tuple(one for one in found if isinstance(one, Untied))
    return Audit(Path(path), tuple(told), best, pairs, untied)


def judged(channel: Channel, jumps: Sequence[Jump], silences: Sequence[Silence]) -> ChannelAudit:
    """One channel without regard to the others, its jumps roughly known."""
    resolution = resolution_ns(channel.t_ns)
    start_ns = int(channel.t_ns[0])
    least_s = max(_LEAST_S, 1e-9 * resolution)
    while True:
        rough = without_jumps(channel, jumps)
        at = [float(rough.t_ns[one.frame] - start_ns) * 1e-9 for one in jumps]
        found = tuple((one, cadence(one.t_ns, start_ns, resolution, at)) for one in rough.messages)
        finer = [_finer(one, at_s, found) for one, at_s in zip(jumps, at, strict=True)]
        real = [abs(one.by_s) > max(_CLEAR * one.sigma_s, least_s) for one in finer]
        if all(real):
            break
        # the frames around it were late, those beyond them are where they were
        jumps = [one for one, is_real in zip(jumps, real, strict=True) if is_real]
    straight = without_jumps(channel, finer)
    common, alone = _common([(one, told) for one, told in found if told is not None], start_ns)
    same = float(np.mean(np.diff(np.sort(channel.t_ns)) == 0)) if len(channel.t_ns) > 1 else 0.0
    late = min((told.late_p99_s for _, told in found if told is not None), default=None)
    steps = [Step(one.at_s, one.by_s, one.sigma_s) for one in finer]
    steps += [_as_stamped(one, finer, at) for one in common]
    return ChannelAudit(
        channel=channel,
        messages=found,
        resolution_ns=resolution,
        same_stamp_share=same,
        steps=tuple(sorted(steps, key=lambda one: one.at_s)),
        slipped=tuple((name, _as_stamped(one, finer, at)) for name, one in alone),
        source=_source(resolution, same, late),
        silences=tuple(silences),
        jumps=tuple(finer),
        straight=_without_steps(straight, common),
    )


def _finer(jump: Jump, at_s: float, found: Sequence[tuple[Message, Cadence | None]]) -> Jump:
    """A jump measured by all blocks of its messages, not by the frames around it."""
    rest = [
        (step, told.period_s)
        for _, told in found
        if told is not None
        for step in told.at_jumps
        if abs(step.at_s - at_s) <= told.block_s
    ]
    if not rest:
        return jump
    more, sigma_s = _size(rest)
    return replace(jump, by_s=jump.by_s + more, sigma_s=sigma_s)


def _size(seen: Sequence[tuple[Step, float]]) -> tuple[float, float]:
    """One step by several messages of some periods, each but for whole cycles; its deviation."""
    slow, _ = max(seen, key=lambda one: one[1])
    weight = np.array([1.0 / max(step.sigma_s, 1e-9) ** 2 for step, _ in seen])
    sizes = [step.by_s + round((slow.by_s - step.by_s) / cycle) * cycle for step, cycle in seen]
    return float(np.sum(weight * sizes) / np.sum(weight)), float(np.sum(weight) ** -0.5)


def _as_stamped(step: Step, jumps: Sequence[Jump], at_s: Sequence[float]) -> Step:
    """Its time by the stamps of the log, with the jumps that come before."""
    before = [one.by_s for one, at in zip(jumps, at_s, strict=True) if at <= step.at_s]
    return replace(step, at_s=step.at_s + sum(before))


def _without_steps(channel: Channel, steps: Sequence[Step]) -> Channel:
    at_s = (channel.t_ns - channel.t_ns[0]) * 1e-9
    late_s = np.zeros(len(at_s))
    for step in steps:
        late_s += step.by_s * (at_s >= step.at_s)
    return channel.with_stamps(channel.t_ns - np.round(late_s * 1e9).astype(np.int64))


_Seen = tuple[Message, Cadence, Step]


def _common(
    found: Sequence[tuple[Message, Cadence]], start_ns: int
) -> tuple[tuple[Step, ...], tuple[tuple[str, Step], ...]]:
    """Steps that most messages show at one time are the clock's; the others a sender's.

    A message shows a step but for whole cycles of its own: the slowest tells the most.
    """
    slow_first = sorted(found, key=lambda one: -one[1].period_s)
    left = [(message, told, step) for message, told in slow_first for step in told.steps]
    common, alone = [], []
    while left:
        first = left[0]
        alike = [one for one in left if _alike(first, one)]
        names = {message.name for message, _, _ in alike}
        if len(names) <= max(_MOST_OF * sum(_would_show(first, told) for _, told in found), 1):
            alone.append((first[0].name, first[2]))
            left = left[1:]
            continue
        size, sigma_s = _size([(step, told.period_s) for _, told, step in alike])
        message, told, step = min(alike, key=lambda one: one[1].period_s)
        at = located(step, message.t_ns, start_ns, told).at_s
        common.append(Step(at, size, sigma_s))
        left = [one for one in left if not any(one is other for other in alike)]
    return tuple(common), tuple(alone)


def _alike(one: _Seen, other: _Seen) -> bool:
    """The same step, up to whole cycles of the other's message."""
    return _alike_in(one[2], other[2], other[1], one[1].block_s)


def _alike_in(first: Step, step: Step, told: Cadence, block_s: float = 0.0) -> bool:
    period = told.period_s
    rest = (step.by_s - first.by_s + 0.5 * period) % period - 0.5 * period
    sure = _CLEAR * float(np.hypot(first.sigma_s, step.sigma_s))
    wide = max(min(_SAME_SIZE * abs(first.by_s), _OF_CYCLE * period), sure)
    apart_s = max(_SAME_TIME_S, block_s, told.block_s)
    return abs(step.at_s - first.at_s) < apart_s and abs(rest) < wide


def _would_show(one: _Seen, told: Cadence) -> bool:
    """A step of so much is not whole cycles of this message."""
    period = told.period_s
    rest = (one[2].by_s + 0.5 * period) % period - 0.5 * period
    return abs(rest) > max(_SAME_SIZE * min(abs(one[2].by_s), _OF_CYCLE * period), _LEAST_S)


def _told_by_others(
    told: Sequence[ChannelAudit], best: str, pairs: Sequence[Between]
) -> list[ChannelAudit]:
    """The channels with the steps that only the comparison shows to be their clock's."""
    by_name = {one.channel.name: one for one in told}
    start_ns = int(by_name[best].straight.t_ns[0])
    for pair in pairs:
        for step in pair.line.steps:
            at_ns = start_ns + round(step.at_s * 1e9)
            sides = ((pair.channel, step.by_s, at_ns + pair.base_ns), (best, -step.by_s, at_ns))
            for name, by_s, when_ns in sides:
                mended = _with_step(by_name[name], when_ns, by_s, step.sigma_s)
                if mended is not None:
                    by_name[name] = mended
                    break
    for pair in pairs:
        one, other = by_name[pair.channel], by_name[best]
        steps_ns = [start_ns + round(step.at_s * 1e9) for step in pair.line.steps]
        by_name[pair.channel] = _told_silences(one, other, -pair.base_ns, steps_ns)
        steps_ns = [at + pair.base_ns for at in steps_ns]
        by_name[best] = _told_silences(other, one, pair.base_ns, steps_ns)
    return [by_name[one.channel.name] for one in told]


def _with_step(one: ChannelAudit, when_ns: int, by_s: float, sigma_s: float) -> ChannelAudit | None:
    """The channel with a step of its clock, where it has a silence or a slip of that size."""
    start_ns = int(one.channel.t_ns[0])
    when_s = (when_ns - start_ns) * 1e-9
    for silence in one.silences:
        at_s = (int(one.straight.t_ns[silence.frame - 1]) - start_ns) * 1e-9
        if abs(at_s - when_s) < _SAME_TIME_S and abs(silence.for_s - by_s) < _SAME_STEP_S:
            jump = Jump(silence.frame, silence.at_s, by_s, sigma_s)
            rest = [other for other in one.silences if other is not silence]
            return judged(one.channel, _in_order([*one.jumps, jump]), rest)
    as_told = Step(when_s + sum(j.by_s for j in one.jumps if j.at_s <= when_s), by_s, sigma_s)
    for name, slip in one.slipped:
        message, told = next(both for both in one.messages if both[0].name == name)
        if told is not None and _alike_in(as_told, slip, told):
            at_s = located(Step(when_s, slip.by_s, sigma_s), message.t_ns, start_ns, told).at_s
            risen = np.maximum.accumulate(one.straight.t_ns)
            frame = int(np.searchsorted(risen, start_ns + round(1e9 * (at_s - 0.5e-6))))
            last_s = (int(one.channel.t_ns[max(frame - 1, 0)]) - start_ns) * 1e-9
            jump = Jump(max(frame, 1), last_s, by_s, sigma_s)
            return judged(one.channel, _in_order([*one.jumps, jump]), one.silences)
    return None


def _in_order(jumps: Sequence[Jump]) -> list[Jump]:
    return sorted(jumps, key=lambda one: one.frame)


def _told_silences(
    one: ChannelAudit, other: ChannelAudit, shift_ns: int, steps_ns: Sequence[int]
) -> ChannelAudit:
    """The channel without those silences that were lost cycles, as the other lacks none then."""
    theirs = [int(other.straight.t_ns[silence.frame - 1]) for silence in other.silences]
    near_ns = _SAME_TIME_S * 1e9
    open_ = []
    for silence in one.silences:
        at_ns = int(one.straight.t_ns[silence.frame - 1]) + shift_ns
        if any(abs(at_ns - when) < near_ns for when in [*theirs, *steps_ns]):
            open_.append(silence)
    return one if len(open_) == len(one.silences) else replace(one, silences=tuple(open_))


def _source(resolution: int, same: float, late_p99_s: float | None) -> str:
    if resolution >= _COARSE_NS:
        return f"coarse: whole multiples of {_time(resolution * 1e-9)}"
    if same > _BATCHED:
        return f"batches: {100 * same:.0f} % of the frames share the stamp of the one before"
    if late_p99_s is None:
        return "unknown: no message is cyclic"
    if late_p99_s < _HARDWARE_S:
        return f"hardware or an idle kernel: {_time(late_p99_s)} late at the 99th percentile"
    return f"software: {_time(late_p99_s)} late at the 99th percentile"


def _time(seconds: float) -> str:
    for unit, size in (("s", 1.0), ("ms", 1e-3), ("us", 1e-6)):
        if abs(seconds) >= size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds * 1e9:.3g} ns"


def _around(value: float, half: float) -> list[float]:
    return [value - half, value + half]


def _step(step: Step) -> dict[str, float]:
    return {"at_s": step.at_s, "by_s": step.by_s, "sigma_s": step.sigma_s}


def _channel(one: ChannelAudit) -> dict[str, Any]:
    count, most_ns = one.went_back
    return {
        "channel": one.channel.name,
        "frames": len(one.channel.t_ns),
        "stamp_source": one.source,
        "resolution_s": one.resolution_ns * 1e-9,
        "same_stamp_share": one.same_stamp_share,
        "went_back": {"frames": count, "most_s": most_ns * 1e-9},
        "steps": [_step(step) for step in one.steps],
        "steps_if_no_frame_was_lost": [
            {"at_s": jump.at_s, "by_s": jump.by_s, "or_less_by_multiples_of_s": jump.or_less_s}
            for jump in one.jumps
            if jump.or_less_s is not None
        ],
        "losses_or_steps": [
            {"at_s": silence.at_s, "for_s": silence.for_s} for silence in one.silences
        ],
        "messages": [_message(message, told, one.slipped) for message, told in one.messages],
    }


def _message(
    message: Message, told: Cadence | None, slipped: Sequence[tuple[str, Step]]
) -> dict[str, Any]:
    base: dict[str, Any] = {"id": message.name, "frames": len(message.t_ns)}
    if told is None:
        return {**base, "cyclic": False}
    return {
        **base,
        "cyclic": True,
        "period_s": told.period_s,
        "nominal_s": told.nominal_s,
        "drift_ppm": told.drift_ppm,
        "drift_ci95": None if told.drift_ci95 is None else list(told.drift_ci95),
        "late_p50_s": told.late_p50_s,
        "late_p99_s": told.late_p99_s,
        "late_max_s": told.late_max_s,
        "lost_cycles": told.lost,
        "slips": [_step(step) for name, step in slipped if name == message.name],
    }
