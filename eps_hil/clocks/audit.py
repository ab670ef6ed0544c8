"""The clocks of a CAN log judged: each message, each channel, each pair of channels."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from eps_hil.clocks.between import Between, between
from eps_hil.clocks.cadence import Cadence, Step, cadence, resolution_ns
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
_MOST_OF = 0.5
"""Of a channel's cyclic messages that were there: from here on a step is the channel's clock's."""


@dataclass(frozen=True, slots=True)
class ChannelAudit:
    """One channel. ``steps``: of its clock, seen in most messages; ``source``: words."""

    channel: Channel
    messages: tuple[tuple[Message, Cadence | None], ...]
    resolution_ns: int
    same_stamp_share: float
    steps: tuple[Step, ...]
    slipped: tuple[tuple[str, Step], ...]
    """Steps of single messages: their place in the sender's schedule moved."""
    source: str

    @property
    def noise_s(self) -> float:
        """Least lateness at the 99th percentile of its messages; infinite where none is cyclic."""
        late = [one.late_p99_s for _, one in self.messages if one is not None]
        return max(min(late, default=np.inf), self.resolution_ns * 1e-9)


@dataclass(frozen=True, slots=True)
class Audit:
    """A whole log. ``reference``: the channel with the best stamps."""

    path: Path
    start_ns: int
    channels: tuple[ChannelAudit, ...]
    reference: str
    pairs: tuple[Between, ...]

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
                }
                for one in self.pairs
            ],
        }


def audit(path: str | Path, on_progress: Callable[[float], None] | None = None) -> Audit:
    """Judge the stamps of a CAN log; :class:`InputError` where it is none."""
    channels = read_channels(path, on_progress)
    start_ns = min(int(one.t_ns.min()) for one in channels)
    judged = tuple(_judged(one, start_ns) for one in channels)
    best = min(judged, key=lambda one: one.noise_s)
    pairs = (between(one, best.channel, start_ns) for one in channels if one is not best.channel)
    return Audit(
        Path(path), start_ns, judged, best.channel.name, tuple(p for p in pairs if p is not None)
    )


def _judged(channel: Channel, start_ns: int) -> ChannelAudit:
    resolution = resolution_ns(channel.t_ns)
    found = tuple((one, cadence(one.t_ns, start_ns, resolution)) for one in channel.messages)
    same = float(np.mean(np.diff(np.sort(channel.t_ns)) == 0)) if len(channel.t_ns) > 1 else 0.0
    common, alone = _common([(one.name, told) for one, told in found if told is not None])
    late = min((told.late_p99_s for _, told in found if told is not None), default=None)
    return ChannelAudit(
        channel, found, resolution, same, common, alone, _source(resolution, same, late)
    )


def _common(
    found: Sequence[tuple[str, Cadence]],
) -> tuple[tuple[Step, ...], tuple[tuple[str, Step], ...]]:
    """Steps that most messages show at one time are the clock's; the others a sender's."""
    left = [(name, step) for name, told in found for step in told.steps]
    common = []
    while left:
        _, first = left[0]
        alike = [
            (name, step)
            for name, step in left
            if abs(step.at_s - first.at_s) < _SAME_TIME_S
            and abs(step.by_s - first.by_s) < max(_SAME_SIZE * abs(first.by_s), 6 * step.sigma_s)
        ]
        if len({name for name, _ in alike}) <= max(_MOST_OF * len(found), 1):
            break
        weight = np.array([1.0 / max(step.sigma_s, 1e-9) ** 2 for _, step in alike])
        size = float(np.sum(weight * [step.by_s for _, step in alike]) / np.sum(weight))
        at = float(np.median([step.at_s for _, step in alike]))
        common.append(Step(at, size, float(np.sum(weight) ** -0.5)))
        left = [one for one in left if one not in alike]
    return tuple(common), tuple(left)


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
    count, most_ns = one.channel.went_back
    return {
        "channel": one.channel.name,
        "frames": len(one.channel.t_ns),
        "stamp_source": one.source,
        "resolution_s": one.resolution_ns * 1e-9,
        "same_stamp_share": one.same_stamp_share,
        "went_back": {"frames": count, "most_s": most_ns * 1e-9},
        "steps": [_step(step) for step in one.steps],
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
