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

_DEFAULT_CYCLE_MS = 10


@dataclass(frozen=True, slots=True)
class Cyclic:
    """One message: sent in milliseconds whose number leaves ``phase_ms`` over ``cycle_ms``."""

    name: str
    encoder: FrameEncoder
    cycle_ms: int
    phase_ms: int
    signals: tuple[tuple[str, str, float, float], ...]  # canonical, DBC name, scale, offset

    def due(self, millisecond: int) -> bool:
        """Whether the message is sent in this millisecond."""
        return millisecond % self.cycle_ms == self.phase_ms


def schedule(database: Any, mapping: SignalMapping, *, dbc_file: object = "DBC") -> list[Cyclic]:
    """The messages that carry the rig's signals, and the ECU's override status if there is one.

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
    messages, slow = [], 0
    for name, signals in wanted.items():
        rules = mapping.messages.get(name)
        encoder = FrameEncoder(database, name, rules=rules, dbc_file=dbc_file)
        cycle_ms = int(find_message(database, name).cycle_time or _DEFAULT_CYCLE_MS)  # type: ignore[union-attr]
        phase_ms = 0
        if cycle_ms > 1:
            slow += 1
            phase_ms = (2 * slow) % cycle_ms
        messages.append(Cyclic(name, encoder, cycle_ms, phase_ms, tuple(signals)))
    # Lowest id first, as arbitration on a bus would have it.
    return sorted(messages, key=lambda message: message.encoder.can_id)


def frames_of(
    messages: Sequence[Cyclic],
    millisecond: int,
    values: Mapping[str, float],
    status: Mapping[str, float],
) -> list[Frame]:
    """Frames of one millisecond: ``values`` by canonical name, ``status`` in DBC units."""
    frames = []
    for message in messages:
        if not message.due(millisecond):
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
