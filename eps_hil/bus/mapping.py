"""The mapping file (CONTRACT 5): which DBC signal is which canonical signal."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, ConfigDict, Field, with_config
from pydantic_core import PydanticCustomError

from eps_hil import yaml_file
from eps_hil.bus.database import nearest
from eps_hil.bus.protection import E2E_P01, PROFILES
from eps_hil.bus.supply_power import CURRENT, VOLTAGE, SupplyPower
from eps_hil.errors import InputError
from eps_hil.series import Pace
from eps_hil.signals import CANONICAL

_STRICT = ConfigDict(extra="forbid")
_SPEED, _ANGLE, _TORQUE = "motor_speed_rad_s", "motor_angle_rad", "motor_torque_nm"
_SENSOR = "torque_sensor_nm"

Finite = Annotated[float, Field(allow_inf_nan=False)]


def _wrong(problem: str) -> PydanticCustomError:
    """A validation error whose text is the problem and nothing else."""
    return PydanticCustomError("mapping", "{problem}", {"problem": problem})


def _canonical(name: str) -> str:
    if name not in CANONICAL:
        raise _wrong(f"unknown canonical signal; {nearest(name, CANONICAL)}")
    return name


def _not_zero(value: float) -> float:
    if value == 0.0:
        raise _wrong("must not be zero")
    return value


def _profile(name: str) -> str:
    if name not in PROFILES:
        raise _wrong(f"unknown CRC profile; {nearest(name, PROFILES)}")
    return name


NotZero = Annotated[Finite, AfterValidator(_not_zero)]
CanonicalName = Annotated[str, AfterValidator(_canonical)]
CrcProfile = Annotated[str, AfterValidator(_profile)]


@with_config(_STRICT)
@dataclass(frozen=True, slots=True)
class SignalSource:
    """Where one canonical signal comes from.

    Either ``message`` and ``signal`` of the DBC: canonical = DBC value * ``scale`` + ``offset``
    (with ``torque_constant_nm_per_a`` that result is a current in A, and the torque is the
    constant times it). Or ``derive_from`` another canonical signal by a straight line over
    ``window_s``: then no message carries it and the estimator derives it. Or ``supply_power``:
    a motor torque out of the current that the steering module draws from its supply.
    """

    message: str | None = None
    signal: str | None = None
    scale: NotZero = 1.0
    offset: Finite = 0.0
    torque_constant_nm_per_a: NotZero | None = None
    derive_from: CanonicalName | None = None
    window_s: Annotated[float, Field(gt=0, le=1, allow_inf_nan=False)] | None = None
    supply_power: SupplyPower | None = None

    def __post_init__(self) -> None:
        if self.supply_power is not None:
            if any(each is not None for each in (self.message, self.signal, self.derive_from)):
                raise ValueError("supply_power names its own message and signals")
        elif self.derive_from is not None:
            if self.message is not None or self.signal is not None:
                raise _wrong("give either message and signal, or derive_from, not both")
        elif self.message is None or self.signal is None:
            raise _wrong("needs both message and signal (or derive_from)")
        elif self.window_s is not None:
            raise _wrong("window_s belongs to derive_from")

    @property
    def derived(self) -> bool:
        """Whether the estimator derives it, so that no frame carries it."""
        return self.derive_from is not None

    @property
    def carrier(self) -> str | None:
        """The message that it is read from; None if no frame carries it."""
        return self.message if self.supply_power is None else self.supply_power.message

    def reads(self, name: str) -> tuple[tuple[str, str, float, float], ...]:
        """What is read for canonical signal ``name``: (DBC signal, reads as, factor, offset)."""
        if self.supply_power is not None:
            power = self.supply_power
            return (power.current, CURRENT, 1.0, 0.0), (power.voltage, VOLTAGE, 1.0, 0.0)
        factor = self.torque_constant_nm_per_a or 1.0
        return ((str(self.signal), name, self.scale * factor, self.offset * factor),)


@with_config(_STRICT)
@dataclass(frozen=True, slots=True)
class MessageRules:
    """How one message is checked and timed.

    ``counter``, ``crc``: names of its signals; ``crc_profile``: see :data:`PROFILES`;
    ``crc_data_id``: default for profile 1 is the CAN id, for a plain CRC none;
    ``counter_modulo``: where the counter does not use its full width, unless it is one less by
    the DBC's maximum (profile 1 proper: 0 to 14);
    ``clock``: ``counter`` takes sample instants from the counter, ``stamp`` from the receive
    stamp; ``extended``: 29-bit (true) or 11-bit id where a log disagrees with the DBC;
    ``cycle_time_s``: in place of the DBC's GenMsgCycleTime, which counts whole milliseconds.
    """

    counter: str | None = None
    counter_modulo: Annotated[int, Field(ge=2)] | None = None
    crc: str | None = None
    crc_profile: CrcProfile = E2E_P01
    crc_data_id: Annotated[int, Field(ge=0, le=0xFFFF)] | None = None
    clock: Literal["counter", "stamp"] = "stamp"
    extended: bool | None = None
    cycle_time_s: Annotated[float, Field(ge=5e-5, le=60, allow_inf_nan=False)] | None = None

    def counter_values(self, counter: Any) -> int:
        """How many values the counter (a signal of cantools) takes before it begins again."""
        full = int(2**counter.length)
        by_profile = counter.maximum == full - 2  # the last value says that there is no counter
        return self.counter_modulo or (full - 1 if by_profile and full > 2 else full)

    def __post_init__(self) -> None:
        if self.clock == "counter" and self.counter is None:
            raise _wrong("'clock: counter' needs the name of the counter signal")

    def cycle_s(self, message: Any) -> float | None:
        """Cycle time of a message (of cantools) in seconds; None where nobody says one."""
        if self.cycle_time_s is not None:
            return self.cycle_time_s
        return message.cycle_time / 1e3 if (message.cycle_time or 0) > 0 else None


@with_config(_STRICT)
@dataclass(frozen=True, slots=True)
class SignalMapping:
    """A whole mapping file.

    ``sync``: the message on which the estimator steps (default: the one that carries the motor
    speed, else the motor angle, else None); ``strict``: how the DBC is read;
    ``commands``: messages of the DBC that command something, beside those that are known to
    (``bus/commands.py``): no replay sends them.
    """

    signals: Annotated[Mapping[CanonicalName, SignalSource], Field(min_length=1)]
    sync: str | None = None
    messages: Mapping[str, MessageRules] = field(default_factory=dict)
    strict: bool = True
    commands: tuple[str, ...] = ()

    def _check_supply_power(self, name: str) -> None:
        if name != _TORQUE:
            raise ValueError(f"{name}: supply_power belongs to {_TORQUE}")
        for needed in (_ANGLE, _SENSOR):
            if needed not in self.signals or self.signals[needed].derived:
                raise ValueError(f"{name}: supply_power needs {needed}, which is not mapped")

    @property
    def sync_message(self) -> str | None:
        """Name of the message on which the estimator steps."""
        if self.sync is not None:
            return self.sync
        for name in (_SPEED, _ANGLE):
            source = self.signals.get(name)
            if source is not None and source.message is not None:
                return source.message
        return None

    @property
    def pace(self) -> Pace:
        """What it says of the estimator's timing."""
        speed = self.signals.get(_SPEED)
        window_s = None if speed is None else speed.window_s
        return Pace(window_s, self.rules(self.sync_message or "").cycle_time_s)

    def rules(self, message: str) -> MessageRules:
        """The rules of a message; a message without an entry has neither counter nor CRC."""
        return self.messages.get(message, _NO_RULES)


_NO_RULES = MessageRules()


def load_mapping(path: str | Path) -> SignalMapping:
    """Read a mapping file; :class:`InputError` in one line with the line of the mistake."""
    content = yaml_file.read(path)
    if not isinstance(content, dict) or "signals" not in content:
        raise InputError(
            path, "signals", "section is missing",
            "add 'signals:' with lines like 'motor_speed_rad_s: {message: M, signal: S}'",
        )  # fmt: skip
    entries = content["signals"].values() if isinstance(content["signals"], dict) else ()
    fields = set().union(*(one for one in entries if isinstance(one, dict)))
    if fields & {"column", "sum"} and not fields & {"message", "signal"}:
        raise InputError(
            path, "signals", "maps columns of a table, not signals of a database",
            "write lines like 'motor_speed_rad_s: {message: M, signal: S}'",
        )  # fmt: skip
    mapping = yaml_file.validate(path, content, SignalMapping)
    for name, source in mapping.signals.items():
        problem = _misplaced(mapping, name, source)
        if problem:
            raise InputError(path, f"signals.{name}", problem, "correct the entry")
    return mapping


def _misplaced(mapping: SignalMapping, name: str, source: SignalSource) -> str:
    """What is wrong with an entry in view of the others; empty if nothing."""
    if source.torque_constant_nm_per_a is not None and name != _TORQUE:
        return f"torque_constant_nm_per_a belongs to {_TORQUE}"
    if source.derive_from is None:
        return ""
    if (name, source.derive_from) != (_SPEED, _ANGLE):
        return f"only {_SPEED} can be derived, and from {_ANGLE}"
    angle = mapping.signals.get(_ANGLE)
    return f"{_ANGLE}, which it derives from, is not mapped" if not angle or angle.derived else ""
