"""A first mapping, model and configuration out of a database, or a mapping out of a table."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from eps_hil.bus.database import load_database
from eps_hil.check.guess import LEAST, Candidate, Guess, data_signs, guess
from eps_hil.errors import InputError
from eps_hil.examples import CONFIGS
from eps_hil.recordings.foreign import read_table

_COUNTERS = ("counter", "alive", "rollingcounter", "sequence")
_FAST_MS = 10
DOUBT = 0.8
"""Below this a line of the mapping is marked."""


@dataclass(frozen=True, slots=True)
class Begun:
    """Texts by file name, the guesses, and what could not be told."""

    files: Mapping[str, str]
    guesses: tuple[Guess, ...]
    open: tuple[str, ...]


def from_database(path: Path, interface: str, channel: str) -> Begun:
    """Mapping, model and configuration for a DBC; :class:`InputError` where nothing is found."""
    database, contradiction = _read(path)
    found = guess(
        Candidate(signal.name, signal.unit, message.name)
        for message in database.messages
        for signal in message.signals
    )
    _check(path, found)
    carriers = {one.of.message for one in found.values()}
    lines, unknown = ["signals:"], []
    for name, one in found.items():
        scale = "" if one.scale == 1.0 else f", scale: {one.scale!r}"
        entry = f"{{message: {one.of.message}, signal: {one.of.name}{scale}}}"
        lines.append(f"  {name}: {entry}{_mark(one)}")
    lines.append("messages:")
    for message in database.messages:
        if message.name not in carriers:
            continue
        counter = _counter(message)
        if counter is None:
            unknown.append(f"{message.name} has no counter that I know: lost frames are not seen")
            continue
        fast = message.cycle_time and message.cycle_time <= _FAST_MS
        clock = ", clock: counter" if fast else ""
        lines.append(f"  {message.name}: {{counter: {counter}{clock}}}")
        if not message.cycle_time:
            unknown.append(f"{message.name} has no cycle time in the database")
    if lines[-1] == "messages:":
        lines.pop()
    if contradiction:
        lines.append("strict: false  # the database contradicts itself, and is read all the same")
        unknown.append(f"which of it is right: {contradiction}")
    unknown += [
        "signs: a database does not say them (positive motor torque, torsion-bar torque and speed"
        " turn the same way, rack force opposes)",
        "CRCs are not checked: a database does not say their polynomial (crc, crc_profile)",
        "the model's numbers are the reference rig's: eps-hil identify",
    ]
    head = "# Guessed by eps-hil init: check every line, above all signs.\n"
    model = (CONFIGS / "reference_rig.yaml").read_text(encoding="utf-8")
    config = (
        f"bus: {{interface: {_plain(interface)}, channel: {_plain(channel)}}}\n"
        f"dbc: [{_plain(str(path.resolve()))}]\n"
        "signals: signals.yaml\nmodel: model.yaml\n"
        "publish: {enabled: false}     # sends nothing before you say so\n"
    )
    files = {
        "signals.yaml": head + "\n".join(lines) + "\n",
        "model.yaml": head + model.partition("\n")[2],
        "rig.yaml": f"{head}{config}",
    }
    return Begun(files, tuple(found.values()), tuple(unknown))


def _read(path: Path) -> tuple[Any, str]:
    """The database, and where it contradicts itself; "" if nowhere."""
    try:
        return load_database([path]), ""
    except InputError as error:
        return load_database([path], strict=False), error.problem


def from_table(path: Path) -> Begun:
    """Mapping of a table's columns, signs by its data."""
    table = read_table(path)
    names = list(table)
    time = next((name for name in names if name.lower().strip() in _TIMES), None)
    if time is None:
        raise InputError(path, "header", "has no time column", "name it time_s or Time")
    found = guess(_column(name) for name in names if name != time)
    _check(path, found)
    numbers = {name: table[_header(names, one)] for name, one in found.items()}
    instants = table[time]
    signs = data_signs(numbers, instants) if np.all(np.diff(instants) > 0) else {}
    lines, unknown = [f"time: {{column: {_quoted(time)}}}", "signals:"], []
    for name, one in found.items():
        sign, sure = signs.get(name, (1, 0.0))
        told = f" sign by the data, correlation {sure:.2f}" if name in signs else ""
        column = _header(names, one)
        lines.append(
            f"  {name}: {{column: {_quoted(column)}, scale: {sign * one.scale!r}}}{_mark(one)}"
            + (f"  #{told}" if told else "")
        )
        if name not in signs and name not in ("motor_torque_nm", "motor_speed_rad_s"):
            unknown.append(f"the sign of {name}")
    unknown.append("the signs of motor torque and speed, from which the others follow")
    return Begun({"columns.yaml": "\n".join(lines) + "\n"}, tuple(found.values()), tuple(unknown))


_TIMES = {"time_s", "time", "t", "time [s]", "time(s)", "timestamp", "t_s"}


def _quoted(text: str) -> str:
    """As YAML takes it to the letter, backslashes (``nMot\\ETKC:1``) too."""
    return "'" + text.replace("'", "''") + "'"


def _plain(text: str) -> str:
    """Without quotes where YAML needs none."""
    return text if re.fullmatch(r"[\w/][\w./-]*", text) else _quoted(text)


def _column(header: str) -> Candidate:
    """``n_mot [rpm]``, ``MotorSpeed (rpm)`` or a bare name."""
    said = re.match(r"^(.*?)\s*[\[(]([^\])]*)[\])]\s*$", header)
    return Candidate(said.group(1), said.group(2)) if said else Candidate(header, None)


def _header(names: list[str], one: Guess) -> str:
    return next(name for name in names if _column(name) == one.of)


def _check(path: Path, found: Mapping[str, Guess]) -> None:
    if not any(name in found for name in ("motor_speed_rad_s", "motor_angle_rad")):
        known = ", ".join(f"{one.canonical} = {one.of.name}" for one in found.values()) or "nothing"
        raise InputError(
            path, "", f"no signal looks like the rotor's speed or angle (found: {known})",
            "write the mapping by hand: docs/howto-connect-my-rig.md",
        )  # fmt: skip


def _counter(message: Any) -> str | None:
    for signal in message.signals:
        if any(word in signal.name.lower() for word in _COUNTERS):
            return str(signal.name)
    return None


def _mark(one: Guess) -> str:
    if one.sure >= DOUBT:
        return ""
    doubt = "UNSURE" if one.sure >= LEAST else "DOUBTFUL"
    return f"   # {doubt} ({one.sure:.0%}): {one.why}"
