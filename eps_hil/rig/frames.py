"""Which frames the simulated rig sends, and when: by the database and the signal mapping."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from eps_hil.bus.codec import FrameEncoder
from eps_hil.bus.database import find_message
from eps_hil.bus.frame import Frame
from eps_hil.bus.mapping import SignalMapping
from eps_hil.errors import InputError
from eps_hil.rig.ecu import STATUS
from eps_hil.rig.sensors import REPORTED

SENT = (*REPORTED, "motor_temperature_degc")
"""Canonical signals that a simulated rig puts on the bus, where the mapping has them."""

_DEFAULT_CYCLE_S = 0.01
TICKS_PER_MS = (1, 2, 4, 5, 10, 20)
"""What divides the plant's twenty steps a millisecond."""


@dataclass(frozen=True, slots=True)
class Cyclic:
    """One message: sent in ticks whose number leaves ``phase`` over ``every``."""

    name: str
    encoder: FrameEncoder
    every: int
    phase: int
    cycle_s: float
    signals: tuple[tuple[str, str, float, float], ...]  # canonical, DBC name, scale, offset

    def due(self, tick: int) -> bool:
        """Whether the message is sent in this tick."""
        return tick % self.every == self.phase


@dataclass(frozen=True, slots=True)
class Schedule:
    """All messages, lowest id first, and how many ticks a millisecond has: 1 to 20."""

    messages: tuple[Cyclic, ...]
    per_ms: int

    @property
    def tick_ns(self) -> int:
        """From one tick to the next."""
        return 1_000_000 // self.per_ms


def schedule(database: Any, mapping: SignalMapping, *, dbc_file: object = "DBC") -> Schedule:
    """The messages that carry the rig's signals, and the ECU's override status if there is one.

    A tick is a millisecond, or the cycle of the fastest message (``cycle_time_s`` of the mapping).
    Slow messages are spread over their cycle, so that no millisecond has to carry all.
    """
    wanted: dict[str, list[tuple[str, str, float, float]]] = {}
    for canonical in SENT:
        source = mapping.signals.get(canonical)
        if source is None or source.message is None or source.signal is None:
            continue
        factor = source.torque_constant_nm_per_a or 1.0
        entry = (canonical, source.signal, source.scale * factor, source.offset * factor)
        wanted.setdefault(source.message, []).append(entry)
    if not wanted:
        raise InputError(dbc_file, "", "the signal mapping names none of the rig's signals")
    if find_message(database, STATUS) is not None:
        wanted.setdefault(STATUS, [])
    cycles_s = {name: _cycle_s(database, mapping, name) for name in wanted}
    per_ms = _ticks_per_ms(cycles_s)
    messages, slow = [], 0
    for name, signals in wanted.items():
        rules = mapping.messages.get(name)
        encoder = FrameEncoder(database, name, rules=rules, dbc_file=dbc_file)
        every, phase = round(cycles_s[name] * 1e3 * per_ms), 0
        if every > per_ms:
            slow += 1
            phase = (2 * slow * per_ms) % every
        messages.append(Cyclic(name, encoder, every, phase, cycles_s[name], tuple(signals)))
    # Lowest id first, as arbitration on a bus would have it.
    return Schedule(tuple(sorted(messages, key=lambda m: m.encoder.can_id)), per_ms)


def _cycle_s(database: Any, mapping: SignalMapping, name: str) -> float:
    message = find_message(database, name)
    return mapping.rules(name).cycle_s(message) or _DEFAULT_CYCLE_S


def _ticks_per_ms(cycles_s: Mapping[str, float]) -> int:
    """So many that every message's cycle is a whole number of ticks."""
    for per_ms in TICKS_PER_MS:
        ticks = [cycle_s * 1e3 * per_ms for cycle_s in cycles_s.values()]
        if all(each > 0.5 and abs(each - round(each)) < 1e-6 for each in ticks):
            return per_ms
    name = min(cycles_s, key=lambda each: cycles_s[each])
    raise InputError(
        "signal mapping", f"messages.{name}.cycle_time_s",
        "the simulated rig cannot keep these cycle times together",
        f"use whole milliseconds, or a millisecond over one of {TICKS_PER_MS}",
    )  # fmt: skip


def frames_of(
    messages: Sequence[Cyclic],
    tick: int,
    values: Mapping[str, float],
    status: Mapping[str, float],
) -> list[Frame]:
    """Frames of one tick: ``values`` by canonical name, ``status`` in DBC units."""
    frames = []
    for message in messages:
        if not message.due(tick):
            continue
        if message.name == STATUS:
            content: dict[str, float] = dict(status)
        else:
            content = {
                signal: (values[canonical] - offset) / scale
                for canonical, signal, scale, offset in message.signals
            }
        frames.append(message.encoder.frame(content))
    return frames


def resolutions(database: Any, mapping: SignalMapping) -> dict[str, tuple[float, float]]:
    """Step and offset of each signal on the bus, in canonical units."""
    found = {}
    for canonical in REPORTED:
        source = mapping.signals.get(canonical)
        if source is None or source.message is None:
            continue
        message = find_message(database, source.message)
        signal = next((s for s in message.signals if s.name == source.signal), None)  # type: ignore[union-attr]
        if signal is not None:
            factor = source.torque_constant_nm_per_a or 1.0
            scale, offset = source.scale * factor, source.offset * factor
            step = abs(float(signal.scale) * scale)
            found[canonical] = (step, float(signal.offset) * scale + offset)
    return found
