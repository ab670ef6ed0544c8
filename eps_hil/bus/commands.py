"""Which messages command something, so that no program sends them in passing.

A log holds what a bus carried, commands of a torque included. A program that sends frames it did
not make itself must know which of them move a motor or a rig; what is not certain counts as a
command (docs/safety.md). Ids are compared by number, in the 11-bit and in the 29-bit format.
"""

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

from eps_hil.bus.database import find_message, load_database, nearest
from eps_hil.bus.units import torque_nm
from eps_hil.errors import InputError

ATTRIBUTE = "EpsHilCommand"
"""Message attribute of a DBC: ``No``, ``Torque`` or ``SetPoint``; ``dbc/eps_rig.dbc`` has it."""
TORQUE_MESSAGE, RIG_MESSAGE = "EPSHIL_TorqueOverride", "RIG_Command"

_WANTS = re.compile(r"(?<!f)req|cmd|command|demand|dmd|desired|set_?point|target|override", re.I)
_TORQUE_NAME = re.compile(r"torque|trq|tq", re.I)


class Kind(StrEnum):
    """What a message commands."""

    TORQUE = "commands a torque"
    SET_POINT = "commands a set-point"
    SUSPECTED = "looks like the command of a torque"


@dataclass(frozen=True, slots=True)
class Command:
    """One message that commands something; ``can_id`` without flags."""

    can_id: int
    name: str
    kind: Kind

    def __str__(self) -> str:
        return f"0x{self.can_id:X} {self.name} ({self.kind})"


Commands = Mapping[int, Command]

OWN: Commands = {
    0x080: Command(0x080, TORQUE_MESSAGE, Kind.TORQUE),
    0x0A0: Command(0x0A0, RIG_MESSAGE, Kind.SET_POINT),
}
"""Those of the project's own database: what counts where no database says otherwise."""

_OWN_KINDS = {each.name: each.kind for each in OWN.values()}
_ATTRIBUTE_KINDS = {
    0: None, "No": None, 1: Kind.TORQUE, "Torque": Kind.TORQUE, 2: Kind.SET_POINT,
    "SetPoint": Kind.SET_POINT,
}  # fmt: skip


def of_database(
    database: Any, *, torque: Collection[str] = (), marked: Collection[str] = ()
) -> Commands:
    """The commands of a cantools database, certain ones only, by id.

    A message is one by its attribute :data:`ATTRIBUTE`, by a name of the project's own, by
    standing in ``torque`` (an override block's) or in ``marked`` (the mapping's ``commands``).
    """
    found = {}
    for message in database.messages:
        kind = _certain(message, torque, marked)
        if kind is not None:
            found[int(message.frame_id)] = Command(int(message.frame_id), message.name, kind)
    return found


def of_replay(*known: tuple[Any, Commands]) -> Commands:
    """What a replay leaves out, by (database, its certain commands) of each that is ``known``.

    A command by one database is one, whatever another says. Beside the certain ones: what looks
    like the command of a torque, and the project's own ids that no database knows.
    """
    messages = [message for database, _ in known for message in database.messages]
    told = {int(message.frame_id) for message in messages}
    found = {can_id: own for can_id, own in OWN.items() if can_id not in told}
    for message in messages:
        can_id = int(message.frame_id)
        if _attribute(message) is None and _suspicious(message):
            found[can_id] = Command(can_id, message.name, Kind.SUSPECTED)
    for _, certain in known:
        found |= certain
    return found


def load_commands(
    dbc: Sequence[str | Path],
    signals: str | Path | None,
    torque: Collection[str] = (),
    beside: Collection[str] = (),
) -> tuple[Any, Commands]:
    """(database, its certain commands); :class:`InputError` where a file or a name is wrong.

    ``beside``: commands by another's mapping, which this database may have or not.
    """
    from eps_hil.bus.mapping import load_mapping

    mapping = None if signals is None else load_mapping(signals)
    database = load_database(dbc, strict=mapping is None or mapping.strict)
    marked = () if mapping is None else mapping.commands
    for name in marked:
        if find_message(database, name) is None:
            raise InputError(
                signals, "commands", f"{', '.join(map(str, dbc))} has no message {name}",
                nearest(name, (each.name for each in database.messages)),
            )  # fmt: skip
    return database, of_database(database, torque=torque, marked=(*marked, *beside))


def refuse_command(commands: Commands, can_id: int, file: object, place: str) -> None:
    """:class:`InputError` if a message that a program is to send is the command of something."""
    command = commands.get(can_id)
    if command is not None:
        raise InputError(
            file, place, f"{command.name} {command.kind}, and only an armed override or a "
            "programme sends that", "name another message",
        )  # fmt: skip


def names(commands: Iterable[Command]) -> str:
    """For a line to a person."""
    return ", ".join(str(each) for each in sorted(commands, key=lambda each: each.can_id))


def _certain(message: Any, torque: Collection[str], marked: Collection[str]) -> Kind | None:
    if message.name in torque:
        return Kind.TORQUE
    if message.name in _OWN_KINDS:
        return _OWN_KINDS[message.name]
    value = _attribute(message)
    kind = None if value is None else _ATTRIBUTE_KINDS.get(value, Kind.TORQUE)
    return Kind.SET_POINT if kind is None and message.name in marked else kind


def _attribute(message: Any) -> int | str | None:
    attributes = getattr(message.dbc, "attributes", None) or {}
    found = attributes.get(ATTRIBUTE)
    return None if found is None else found.value


def _suspicious(message: Any) -> bool:
    return any(
        _WANTS.search(signal.name)
        and (torque_nm(signal.unit) is not None or _TORQUE_NAME.search(signal.name))
        for signal in message.signals
    )
