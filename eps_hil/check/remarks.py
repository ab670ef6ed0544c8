"""What files say that starts, and is probably not meant or may do harm."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, fields
from difflib import get_close_matches
from enum import StrEnum
from pathlib import Path
from typing import Any

from eps_hil import yaml_file
from eps_hil.bus import units
from eps_hil.bus.database import find_message
from eps_hil.bus.mapping import SignalMapping
from eps_hil.bus.protection import E2E_P01
from eps_hil.physics.effects.catalogue import catalogue
from eps_hil.physics.model import Model
from eps_hil.service.config import ServiceConfig
from eps_hil.service.input_check import JUDGED, scale_problem
from eps_hil.signals import CANONICAL

SLOWEST_SYNC_MS = 20
_NEARLY = 0.8
"""Alike enough to be meant: efects and effects."""
_NETWORK = Path("/sys/class/net")
_LOST = {
    "torque_sensor_nm": "torsion-bar torque: the driver's share of the rack force is not estimated",
    "rack_force_n": "load cell: estimate and truth cannot be compared, nor a model diagnosed",
}
_COUNTERS = ("counter", "alive", "rolling", "sequence")
_CHECKSUMS = ("crc", "checksum", "chks")


class Level(StrEnum):
    """How bad it is; the worst first."""

    ERROR = "error"
    WARNING = "warning"
    NOTE = "note"


@dataclass(frozen=True, slots=True)
class Remark:
    """One thing to say: where, what, and what to do."""

    level: Level
    place: str
    text: str
    remedy: str = ""

    def __str__(self) -> str:
        where = f"{self.place}: " if self.place else ""
        return f"{self.level}: {where}{self.text}" + (f"; {self.remedy}" if self.remedy else "")


def _warning(path: Path, place: str, text: str, remedy: str = "") -> Remark:
    return Remark(Level.WARNING, f"{path}: {place}" if place else str(path), text, remedy)


def of_model(path: Path, model: Model) -> Iterator[Remark]:
    """A model file whose numbers contradict one another, or look like another unit or side."""
    if model.pinion_ratio_rad_per_m >= model.rack_to_rotor_ratio_rad_per_m:
        yield _warning(
            path, "model.pinion_ratio_rad_per_m", "the pinion turns no slower than the rotor",
            "i_pi is usually 1/10 to 1/30 of i_APA: swapped?",
        )  # fmt: skip
    if not 1e-5 <= model.inertia_kg_m2 <= 1e-2:
        yield _warning(
            path, "model.inertia_kg_m2", f"{model.inertia_kg_m2:g} kg m2 is no rotor's inertia",
            "J_1m is at the rotor, usually 1e-4 to 1e-3 kg m2",
        )  # fmt: skip
    friction = model.friction
    for name in ("offset_pos_nm", "offset_neg_nm"):
        if getattr(friction, name) > 1.0:
            yield _warning(
                path, f"model.friction.{name}", f"{getattr(friction, name):g} Nm at the rotor",
                "friction is at the rotor, not at the column: divide by i_APA/i_pi?",
            )  # fmt: skip
    if friction.load_pos_nm_per_n == friction.load_neg_nm_per_n == 0.0:
        yield _warning(
            path, "model.friction.load_pos_nm_per_n", "friction does not grow with the load",
            "identify it, or the estimate is low under load",
        )  # fmt: skip
    delays = model.delays_s
    if not any((delays.motor_speed, delays.motor_torque, delays.torque_sensor, delays.rack_force)):
        yield _warning(
            path, "model.delays_s", "no signal is late at all",
            "`eps-hil identify` measures the delays",
        )  # fmt: skip
    yield from _misspelt(path)
    twice = [name for name, n in Counter(e["effect"] for e in model.effects).items() if n > 1]
    for name in twice:
        yield _warning(path, "model.effects", f"'{name}' stands there more than once: they add up")
    for entry in model.effects:
        if not catalogue()[entry["effect"]].simulated:
            said = (
                f"'{entry['effect']}' is of what a rig reports: every verb but rig refuses the file"
            )
            yield Remark(Level.NOTE, f"{path}: model.effects", said)


def _misspelt(path: Path) -> Iterator[Remark]:
    """Further keys may stand in a model: one that was meant for its own is read by nobody."""
    given = yaml_file.read(path)["model"]
    missing = [one.name for one in fields(Model) if one.name not in given]
    for key in given:
        for near in get_close_matches(str(key), missing, n=1, cutoff=_NEARLY):
            said = f"'{key}' is read by nobody, and {near} has its default"
            yield _warning(path, f"model.{key}", said, f"did you mean {near}?")


def of_signals(path: Path, mapping: SignalMapping) -> Iterator[Remark]:
    """What the mapping leaves out, and a clock or counter that it does not use."""
    for name, what in _LOST.items():
        if name not in mapping.signals:
            yield Remark(Level.NOTE, f"{path}: signals.{name}", f"no {what}")
    sync = mapping.sync_message
    if sync is None:
        yield _warning(
            path, "sync", "no message carries motor speed or angle: nothing steps the estimator",
            "map motor_speed_rad_s or motor_angle_rad, or name the message as 'sync'",
        )  # fmt: skip
        return
    rules = mapping.rules(sync)
    if rules.counter is None:
        yield _warning(
            path, f"messages.{sync}", "no counter: a lost or repeated frame is not noticed",
            "name its counter signal, if it has one",
        )  # fmt: skip
    elif rules.clock == "stamp":
        yield Remark(
            Level.NOTE, f"{path}: messages.{sync}",
            "sample instants are receive stamps, though there is a counter",
            "'clock: counter' takes out the bus's jitter, where the sender is periodic",
        )  # fmt: skip


def of_mapping(path: Path, mapping: SignalMapping, database: Any, model: Model) -> Iterator[Remark]:
    """The mapping against the database: units, cycle times, counters and CRCs that are not used."""
    yield from of_signals(path, mapping)
    for name, source in mapping.signals.items():
        message = find_message(database, source.message) if source.message else None
        signal = None if message is None else _signal(message, source.signal)
        if signal is not None and source.torque_constant_nm_per_a is None:
            problem = scale_problem(name, source, database, model)
            said = () if problem is None else (_warning(path, f"signals.{name}", *problem),)
            yield from said if name in JUDGED else _unit(path, name, signal, source.scale)
    sync = find_message(database, mapping.sync_message or "")
    cycle_s = None if sync is None else mapping.rules(sync.name).cycle_s(sync)
    if sync is not None and cycle_s is None:
        yield _warning(
            path, "sync", f"the database gives {sync.name} no cycle time",
            f"add GenMsgCycleTime to the DBC, or messages.{sync.name}.cycle_time_s here",
        )  # fmt: skip
    elif sync is not None and cycle_s is not None and 1e3 * cycle_s > SLOWEST_SYNC_MS:
        yield _warning(path, "sync", f"{sync.name} comes every {1e3 * cycle_s:g} ms only")
    for carrier in sorted({one.carrier for one in mapping.signals.values() if one.carrier}):
        message, rules = find_message(database, carrier), mapping.rules(carrier)
        for what, words, used, beside in (
            ("counter", _COUNTERS, rules.counter, ""),
            ("crc", _CHECKSUMS, rules.crc, f" and crc_profile, if it is not {E2E_P01}"),
        ):
            spare = [] if message is None or used is not None else _named(message, words)
            if spare:
                yield _warning(
                    path, f"messages.{carrier}", f"{spare[0]} of the database is not checked",
                    f"'{what}: {spare[0]}'{beside}",
                )  # fmt: skip


def _unit(path: Path, name: str, signal: Any, scale: float) -> Iterator[Remark]:
    known, wanted = units.known(signal.unit), units.quantity(CANONICAL[name].unit)
    if known is None:
        return
    measured, factor = known
    if measured not in (wanted, "current"):
        yield _warning(
            path, f"signals.{name}", f"{signal.name} is in {signal.unit}, a {measured}",
            f"{CANONICAL[name].unit} was expected: another signal?",
        )  # fmt: skip
    elif factor != 1.0 and abs(scale) == 1.0:
        yield _warning(
            path, f"signals.{name}", f"{signal.name} is in {signal.unit}, scale is {scale:g}",
            f"to {CANONICAL[name].unit} it is {factor * scale:.7g}",
        )  # fmt: skip


def of_database(path: Path, database: Any) -> Iterator[Remark]:
    """A database by itself."""
    silent = [one.name for one in database.messages if not one.cycle_time]
    if silent:
        yield Remark(
            Level.NOTE, str(path),
            f"{len(silent)} of {len(database.messages)} messages without cycle time"
            f" ({', '.join(silent[:3])}{', …' if len(silent) > 3 else ''})",
        )  # fmt: skip
    ids = Counter((one.frame_id, one.is_extended_frame) for one in database.messages)
    for can_id, extended in [one for one, n in ids.items() if n > 1]:
        place = f"id 0x{can_id:X}{' (29 bits)' * extended}"
        yield _warning(path, place, "stands for several messages")


def of_bus(path: Path, config: ServiceConfig) -> Iterator[Remark]:
    """Where the frames will go, and whether that place is there on this machine."""
    bus = config.bus
    if bus.interface == "udp_multicast" and bus.options.get("hop_limit", 1) != 0:
        yield _warning(
            path, "bus.options", "frames leave this machine: UDP multicast with hop limit 1",
            "hop_limit: 0 keeps them here",
        )  # fmt: skip
    if bus.interface == "socketcan" and _NETWORK.is_dir():
        if not (_NETWORK / bus.channel).exists():
            yield _warning(path, "bus.channel", f"this machine has no interface {bus.channel}")
        elif not _is_up(bus.channel):
            yield _warning(
                path, "bus.channel", f"{bus.channel} is down", f"ip link set {bus.channel} up"
            )


def of_override(path: Path, config: ServiceConfig) -> Iterator[Remark]:
    """A file that can command a torque is said to."""
    if config.override is not None:
        limit = config.override.limits.max_torque_nm
        yield _warning(
            path, "override", f"`calibrate torque-injection` may command up to {limit:g} Nm",
            "read docs/safety.md; without this block nothing can",
        )  # fmt: skip
        if config.override.status_message is None:
            yield _warning(
                path, "override.status_message", "the ECU does not say whether it obeys",
                "name its status message, if it has one",
            )  # fmt: skip


def _is_up(channel: str) -> bool:
    try:
        return bool(int((_NETWORK / channel / "flags").read_text(), 16) & 1)
    except (OSError, ValueError):
        return True


def _signal(message: Any, name: str | None) -> Any:
    return next((one for one in message.signals if one.name == name), None)


def _named(message: Any, words: tuple[str, ...]) -> list[str]:
    return [one.name for one in message.signals if any(word in one.name.lower() for word in words)]
