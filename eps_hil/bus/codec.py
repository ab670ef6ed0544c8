"""CAN frames to samples of canonical signals, and values to frames.

One decoder object serves the live loop and the log reader: what it yields depends on nothing but
the sequence of frames. Stamps are taken in whole microseconds, the resolution of the text log
formats, so that a log holds all that the decoder sees. A frame that cannot be trusted yields NaN
under every signal it carries: the estimate then goes invalid with a reason, where silence would
look like a slow sender.
"""

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from eps_hil.bus.bit_packing import Packing, packing_of
from eps_hil.bus.database import find_message, nearest
from eps_hil.bus.frame import Frame, frame_of
from eps_hil.bus.frame_columns import key_of
from eps_hil.bus.mapping import MessageRules, SignalMapping
from eps_hil.bus.message_decoder import STAMP_RESOLUTION_NS, MessageDecoder, Sample
from eps_hil.bus.protection import E2E_P01, CounterCheck, CrcRule, Seen, crc_byte
from eps_hil.bus.sample_clock import SampleClock
from eps_hil.bus.signal_codec import ReadSignal, WriteSignal
from eps_hil.bus.supply_power import SupplyPowerTorque
from eps_hil.errors import InputError

if TYPE_CHECKING:
    from eps_hil.bus.column_decoder import ColumnDecoder
    from eps_hil.bus.live_frames import CompiledPayload, LiveFrames
    from eps_hil.bus.live_kernels import Samples

__all__ = ["FAULTS", "STAMP_RESOLUTION_NS", "FrameDecoder", "FrameEncoder", "Sample"]

FAULTS = (
    "crc", "counter", "length", "lost_frames", "not_decodable",
    "not_available", "out_of_range", "clock_restarts", "second_sender", "not_trusted",
)  # fmt: skip
"""Keys of :attr:`FrameDecoder.faults`. ``counter``: repeated frames (they yield no sample);
``second_sender``: other data under a counter that was there already; ``not_trusted``: frames of
which nobody can say when they were sampled, or whose they are (both yield NaN)."""


class FrameDecoder:
    """Decodes the mapped messages; :class:`InputError` if the database does not hold them.

    ``mapping_file`` and ``dbc_file`` are only named in errors.
    """

    def __init__(
        self,
        database: Any,
        mapping: SignalMapping,
        *,
        mapping_file: object = "signal mapping",
        dbc_file: object = "DBC",
    ) -> None:
        self.faults: dict[str, int] = dict.fromkeys(FAULTS, 0)
        self.period_s: dict[str, float] = {}
        self._clocks: dict[tuple[str, int, int], SampleClock] = {}
        self._plans: dict[tuple[int, bool], MessageDecoder] = {}
        self._files = mapping_file, dbc_file
        wanted: dict[str, list[str]] = {}
        for name, source in mapping.signals.items():
            if source.carrier is not None:
                wanted.setdefault(source.carrier, []).append(name)
        laws = [source.supply_power for source in mapping.signals.values() if source.supply_power]
        self._power = SupplyPowerTorque(laws[0]) if laws else None
        for message_name, names in wanted.items():
            self._add(database, mapping, message_name, names)
        for message_name in mapping.messages:
            self._message(database, message_name, f"messages.{message_name}")
        self._sync = self._sync_key(database, mapping)
        self._sync_clock = None if self._sync is None else self._plans[self._sync].clock
        self._live: LiveFrames | None = None

    @property
    def receive_ids(self) -> tuple[int, ...]:
        """Ids of the mapped messages, ascending, without the flag of the extended format."""
        return tuple(sorted({can_id for can_id, _ in self._plans}))

    @property
    def sync_id(self) -> int | None:
        """Id of the sync message; None if the mapping has neither speed nor angle."""
        return None if self._sync is None else self._sync[0]

    def message_of(self, frame: Frame) -> str:
        """Name of the mapped message that the frame carries; "" if none."""
        plan = self._plans.get((frame.can_id, frame.extended))
        return "" if plan is None else plan.name

    @property
    def moved_ns(self) -> int:
        """By how much the sync message's instants moved against its counter, in all."""
        moved_ns = None if self._live is None else self._live.moved_ns
        if moved_ns is not None:
            return moved_ns
        return 0 if self._sync_clock is None else self._sync_clock.moved_ns

    def sync(self, frame: Frame) -> bool:
        """Whether the estimator steps on this frame."""
        return not frame.error and (frame.can_id, frame.extended) == self._sync

    def decode(self, frame: Frame) -> list[Sample]:
        """The samples of one frame, in the order of the mapping; [] if it is not mapped."""
        if frame.error or frame.remote:
            return []
        key = frame.can_id, frame.extended
        if self._live is not None:
            self._live.give_back(key)
        plan = self._plans.get(key)
        samples = [] if plan is None else plan.decode(frame)
        return samples if self._power is None else self._power.replace(samples)

    def columns(self) -> "ColumnDecoder | None":
        """What says the same as :meth:`decode` of many frames at once, for a fresh decoder.

        None where the mapping asks for what is found frame by frame.
        """
        if self._power is not None:
            return None
        from eps_hil.bus.column_decoder import ColumnDecoder  # compiles; nobody live needs it

        plans = {key_of(*key): plan for key, plan in self._plans.items()}
        return ColumnDecoder(plans, None if self._sync is None else key_of(*self._sync))

    def live(self, places: Mapping[str, int], samples: "Samples") -> "LiveFrames | None":
        """What takes usual frames by compiled calls, which are compiled (or loaded) now.

        ``places``: the number of each signal in ``samples``. Frames that it does not take are for
        :meth:`decode`. None where the mapping asks for more than one message tells, and where
        kernels are not compiled.
        """
        from eps_hil.compiled import interpreted  # imports numba, which no recorder needs

        if self._power is not None or interpreted():
            return None
        if self._live is not None:
            self._live.give_all_back()
        from eps_hil.bus.live_frames import LiveFrames

        self._live = LiveFrames(self._plans, places, samples, self._sync)
        return self._live

    def _add(
        self, database: Any, mapping: SignalMapping, message_name: str, names: Sequence[str]
    ) -> None:
        message = self._message(database, message_name, f"signals.{names[0]}")
        rules = mapping.rules(message_name)
        signals = []
        for name in names:
            for signal, reads_as, factor, offset in mapping.signals[name].reads(name):
                found = self._signal(message, signal, f"signals.{name}")
                signals.append(ReadSignal(found, reads_as, factor, offset))
        key = self._key(message, rules)
        if key in self._plans:
            raise InputError(
                self._files[1], message_name,
                f"shares its id 0x{key[0]:X} with {self._plans[key].name}, which is mapped too",
                "map messages of one id only",
            )  # fmt: skip
        self._plans[key] = MessageDecoder(message, signals, self.faults)
        self._protect(self._plans[key], message, rules)
        cycle_s = rules.cycle_s(message)
        if cycle_s is not None:
            self.period_s |= dict.fromkeys(names, cycle_s)

    def _protect(self, plan: "MessageDecoder", message: Any, rules: MessageRules) -> None:
        place = f"messages.{message.name}"
        if rules.crc is not None:
            signal = self._signal(message, rules.crc, f"{place}.crc")
            plan.crc = crc_rule(message, signal, rules, self._files[0], f"{place}.crc")
        if rules.counter is None:
            return
        counter = self._signal(message, rules.counter, f"{place}.counter")
        modulo = rules.counter_values(counter)
        if counter.is_signed or counter.is_float or modulo > 2**counter.length:
            raise InputError(
                self._files[0], f"{place}.counter",
                f"{counter.name} cannot be a counter of 0..{modulo - 1}", "name the counter signal",
            )  # fmt: skip
        plan.counter = counter.name
        plan.check = CounterCheck(modulo)
        cycle_s = rules.cycle_s(message)
        if cycle_s is not None:
            plan.seen = Seen(modulo, round(cycle_s * 1e9))
        if rules.clock == "counter":
            plan.clock = self._clock(message, cycle_s, modulo, place)

    def _clock(self, message: Any, cycle_s: float | None, modulo: int, place: str) -> SampleClock:
        if cycle_s is None:
            raise InputError(
                self._files[1], message.name, "has no cycle time (GenMsgCycleTime)",
                f"add it, or set 'cycle_time_s' (or 'clock: stamp') under {place} in "
                f"{self._files[0]}",
            )  # fmt: skip
        period_ns = round(cycle_s * 1e9)
        sender = message.senders[0] if message.senders else f"message {message.name}"
        key = (sender, period_ns, modulo)
        return self._clocks.setdefault(key, SampleClock(period_ns, modulo))

    def _sync_key(self, database: Any, mapping: SignalMapping) -> tuple[int, bool] | None:
        name = mapping.sync_message
        if name is None:
            return None
        message = self._message(database, name, "sync")
        key = self._key(message, mapping.rules(name))
        if key not in self._plans:
            raise InputError(
                self._files[0], "sync", f"{name} carries no mapped signal",
                "name the message that carries the motor speed or angle",
            )  # fmt: skip
        return key

    def _key(self, message: Any, rules: MessageRules) -> tuple[int, bool]:
        extended = message.is_extended_frame if rules.extended is None else rules.extended
        return int(message.frame_id), bool(extended)

    def _message(self, database: Any, name: str, place: str) -> Any:
        message = find_message(database, name)
        if message is None:
            raise InputError(
                self._files[0], place, f"{self._files[1]} has no message {name}",
                nearest(name, (each.name for each in database.messages)),
            )  # fmt: skip
        if message.is_container:
            raise InputError(
                self._files[0], place, f"{name} is a container message, which is not supported"
            )
        same_id = [m.name for m in database.messages if _same_id(m, message)]
        if len(same_id) > 1:
            raise InputError(
                self._files[1], name, f"id 0x{message.frame_id:X} belongs to several messages: "
                + ", ".join(same_id), "keep one of them",
            )  # fmt: skip
        return message

    def _signal(self, message: Any, name: str, place: str) -> Any:
        for signal in message.signals:
            if signal.name == name:
                return signal
        raise InputError(
            self._files[0], place,
            f"message {message.name} of {self._files[1]} has no signal {name}",
            nearest(name, (each.name for each in message.signals)),
        )  # fmt: skip


class FrameEncoder:
    """Encodes one message from values in DBC units, filling in its counter and CRC.

    Which signals are counter and CRC is said by ``rules``, else by the DBC's attribute
    ``GenSigFuncType`` (``CNTR``, ``CHK``). A value beyond its range is clipped, NaN is sent as
    'signal not available' where the signal has such a value, and both are counted in
    ``clipped`` and ``not_available``: the hot path never raises.
    """

    def __init__(
        self,
        database: Any,
        message_name: str,
        *,
        rules: MessageRules | None = None,
        dbc_file: object = "DBC",
    ) -> None:
        message = find_message(database, message_name)
        if message is None:
            raise InputError(
                dbc_file, message_name, "no such message",
                nearest(message_name, (each.name for each in database.messages)),
            )  # fmt: skip
        others = [m.name for m in database.messages if _same_id(m, message) and m is not message]
        if others:
            raise InputError(
                dbc_file, message_name,
                f"would be sent by id 0x{message.frame_id:X}, which is also that of {others[0]}",
                "give one of them another id",
            )  # fmt: skip
        for signal in message.signals:
            if not signal.scale:
                place = f"{message_name}.{signal.name}"
                raise InputError(dbc_file, place, "has factor 0", "give it that of its unit")
        self._message = message
        self.can_id: int = message.frame_id
        self.extended: bool = message.is_extended_frame
        self.fd: bool = message.is_fd
        self.clipped = 0
        self.not_available = 0
        rules = rules or rules_of(message)
        self._counter = rules.counter
        self._modulo = self._next = 0
        self._crc: CrcRule | None = None
        for signal in message.signals:
            if signal.name == rules.counter:
                self._modulo = rules.counter_values(signal)
            elif signal.name == rules.crc:
                self._crc = crc_rule(message, signal, rules, dbc_file, message_name)
        own = {rules.counter, rules.crc}
        self._signals = tuple(WriteSignal(s) for s in message.signals if s.name not in own)
        self._raw: dict[str, int | float] = {s.name: 0 for s in message.signals}
        self._packing = packing_of(message)
        places = {} if self._packing is None else self._packing.places
        self._fields = tuple((s, s.name, *places[s.name][:2]) for s in self._signals if places)
        self._compiled: CompiledPayload | None = None

    def warm_up(self) -> None:
        """Encode by a compiled call from here on, which is compiled (or loaded) now."""
        from eps_hil.compiled import interpreted

        if self._packing is not None and not interpreted():
            from eps_hil.bus.live_frames import compiled_payload

            self._compiled = compiled_payload(self._packing, self._signals, self._crc)

    def encode(self, values: Mapping[str, float]) -> bytes:
        """Payload for values by DBC signal name; a signal not given is sent as not available."""
        packing, crc, compiled = self._packing, self._crc, self._compiled
        if compiled is not None and packing is not None:
            place = packing.places.get(self._counter)
            counter = 0 if place is None else (self._next & place[1]) << place[0]
            found = compiled.payload(values, counter)
            if found is not None:
                if place is not None:
                    self._next = (self._next + 1) % self._modulo
                return found
        data = self._by_cantools(values) if packing is None else self._packed(packing, values)
        if crc is None:
            return data
        return data[: crc.byte] + bytes((crc.expected(data),)) + data[crc.byte + 1 :]

    def _packed(self, packing: Packing, values: Mapping[str, float]) -> bytes:
        number = 0
        for signal, name, shift, mask in self._fields:
            raw, fate = signal.write(values.get(name, math.nan))
            if fate:
                self.clipped += fate > 0
                self.not_available += fate < 0
            number |= (int(raw) & mask) << shift
        if self._counter is not None:
            shift, mask, _ = packing.places[self._counter]
            number |= (self._next & mask) << shift
            self._next = (self._next + 1) % self._modulo
        return number.to_bytes(packing.length, packing.order)

    def _by_cantools(self, values: Mapping[str, float]) -> bytes:
        raw = self._raw
        for signal in self._signals:
            value = values.get(signal.name, math.nan)
            raw[signal.name], fate = signal.write(value)
            if fate:
                self.clipped += fate > 0
                self.not_available += fate < 0
        if self._counter is not None:
            raw[self._counter] = self._next
            self._next = (self._next + 1) % self._modulo
        data: bytes = self._message.encode(raw, scaling=False, strict=False)
        return data

    def frame(self, values: Mapping[str, float], t_ns: int = 0) -> Frame:
        """The payload of :meth:`encode` as a frame with the message's id and format."""
        return frame_of(
            t_ns, self.can_id, self.encode(values), self.extended, self.fd,
            error=False, own=False, remote=False, brs=False,
        )  # fmt: skip


def data_id_of(message: Any) -> int:
    """Data id of profile 1: the DBC's attribute ``CrcDataId``, else the id's low 16 bits."""
    attributes = message.dbc.attributes if message.dbc else {}
    if "CrcDataId" in attributes:
        return int(attributes["CrcDataId"].value)
    return int(message.frame_id) & 0xFFFF


def crc_rule(message: Any, signal: Any, rules: MessageRules, file: object, place: str) -> CrcRule:
    byte = crc_byte(signal)
    if byte is None:
        raise InputError(file, place, f"{signal.name} is not one whole byte", "name a CRC-8 signal")
    data_id = rules.crc_data_id
    if data_id is None and rules.crc_profile == E2E_P01:
        data_id = data_id_of(message)
    return CrcRule.make(byte, rules.crc_profile, data_id)


def rules_of(message: Any) -> MessageRules:
    """Counter and CRC by the DBC's own words (attribute ``GenSigFuncType``)."""
    found: dict[str, str] = {}
    for signal in message.signals:
        attribute = signal.dbc.attributes.get("GenSigFuncType") if signal.dbc else None
        if attribute is not None:
            choices = attribute.definition.choices or []
            value = attribute.value  # an index, or the text itself, as the file has it
            found[choices[value] if isinstance(value, int) else str(value)] = signal.name
    return MessageRules(counter=found.get("CNTR"), crc=found.get("CHK"))


def _same_id(one: Any, other: Any) -> bool:
    return bool(one.frame_id == other.frame_id and one.is_extended_frame == other.is_extended_frame)
