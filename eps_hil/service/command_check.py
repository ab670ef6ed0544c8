"""Whether what the guard allows is what a command frame says, asked before anything is armed.

Every frame is read again by cantools, which did not write it: a scale, a range, a width, an E2E
header or a neighbour in the message may make another torque of the one that was judged.
"""

import math
import re
from collections.abc import Callable
from typing import Any

from eps_hil.bus import e2e, units
from eps_hil.bus.codec import rules_of
from eps_hil.bus.frame import Frame
from eps_hil.bus.signal_codec import no_value_raws
from eps_hil.errors import InputError
from eps_hil.service.config import OverrideConfig
from eps_hil.service.guard import Command

_FINEST = 0.05
"""Steps of the torque signal may be no coarser than this share of ``max_torque_nm``."""
_NOTHING = 0.01
"""Zero torque may read as this share of ``max_torque_nm``: an offset between two steps."""
_FRAMES = 20
"""Frames of one command that are read: more than a counter of four bits has."""
_OFF = re.compile(r"(?i)\b(off|release[ds]?|inactive|disabled?|no ?request|none|idle|passive)\b")
_ON = re.compile(r"(?i)\b(on|enabled?|active|request(ed)?|override)\b")

OTHER_UNIT = "other"
"""``torque_unit`` of a signal in no unit of torque: ``torque_scale`` is taken as it stands."""
_SAME = 0.01
"""By so much a scale may differ from what unit and gear say."""

Frames = Callable[[Command], Frame]


def check_command(
    override: OverrideConfig,
    message: Any,
    frame: Frames,
    sensor_to_rotor: float,
    file: object,
    dbc_file: str,
) -> None:
    """``InputError`` where frames of ``frame`` do not say what they were asked for.

    ``message``: the command message of the database; ``sensor_to_rotor``: torque at the rotor of
    1 Nm in the torsion bar.
    """
    _check_places(override, message, file)
    _check_reach(override, message, file)
    _check_unit(override, message, sensor_to_rotor, file)
    _check_labels(override, message, file)
    header = 0 if override.e2e is None else _touched(override.e2e, int(message.length))
    for name in (override.torque_signal, override.request_signal):
        if header & _bits(message, name):
            raise InputError(
                file, "override.e2e", f"its header lies over {name} of {message.name}",
                "mend profile or offset",
            )  # fmt: skip
    most = override.limits.max_torque_nm
    for torque_nm in (0.0, most, -most, most / 3, -most / 7):
        for _ in range(_FRAMES):
            _check_frame(override, message, frame(Command(torque_nm, True)), torque_nm, True, file)
    for _ in range(_FRAMES):
        _check_frame(override, message, frame(Command(0.0, False)), 0.0, False, file)
    _check_others(override, message, frame(Command(0.0, False)), header, file, dbc_file)


def _check_places(override: OverrideConfig, message: Any, file: object) -> None:
    """The torque, the request, counter and CRC are four signals; the requests two values."""
    rules = rules_of(message)
    kept = {rules.counter: "counter", rules.crc: "CRC"}
    for field in ("torque_signal", "request_signal"):
        name = getattr(override, field)
        if name in kept:
            raise InputError(
                file, f"override.{field}", f"{name} is the {kept[name]} of {message.name}",
                "name the signal that carries the torque or the request",
            )  # fmt: skip
    if override.torque_signal == override.request_signal:
        raise InputError(
            file, "override.request_signal", f"{override.request_signal} is the torque signal too",
            "name the signal that says enable or release",
        )  # fmt: skip
    if override.enable_value == override.release_value:
        raise InputError(
            file, "override.release_value", f"{override.release_value} is the enable_value too",
            "give the value by which the ECU releases",
        )  # fmt: skip


def _check_reach(override: OverrideConfig, message: Any, file: object) -> None:
    """A torque that the message cannot carry would be clipped behind the guard's back."""
    signal = message.get_signal_by_name(override.torque_signal)
    limit = override.limits.max_torque_nm
    most = limit / abs(override.torque_scale or math.nan)
    low = -math.inf if signal.minimum is None else signal.minimum
    high = math.inf if signal.maximum is None else signal.maximum
    if not low <= -most <= most <= high:
        raise InputError(
            file, "override.limits.max_torque_nm",
            f"{signal.name} carries {low:g} to {high:g} {signal.unit or ''} only",
            "lower the limit, or mend torque_scale",
        )  # fmt: skip
    step_nm = 0.0 if signal.is_float else abs(float(signal.scale) * override.torque_scale)
    if step_nm > _FINEST * limit:
        raise InputError(
            file, "override.torque_signal",
            f"one step of {signal.name} is {step_nm:g} Nm at the rotor, of {limit:g} Nm allowed",
            "a signal with finer steps is needed, or torque_scale is wrong",
        )  # fmt: skip


def _check_unit(
    override: OverrideConfig, message: Any, sensor_to_rotor: float, file: object
) -> None:
    """Nm are Nm at the rotor, or at the torsion bar: else the ECU would make more of the torque."""
    signal = message.get_signal_by_name(override.torque_signal)
    stated = override.torque_unit
    unit = _torque_unit(stated, signal, file)
    if stated == OTHER_UNIT:
        return
    likely = unit, unit * abs(sensor_to_rotor)
    if all(abs(abs(override.torque_scale) - each) > _SAME * each for each in likely):
        raise InputError(
            file, "override.torque_scale",
            f"{override.torque_scale:g} Nm at the rotor for 1 {stated or signal.unit} of "
            f"{signal.name}",
            f"{likely[0]:g} where that is torque at the rotor, {likely[1]:g} where it is at the "
            "steering wheel; mend the signal's unit if it is none of them",
        )  # fmt: skip


def _torque_unit(stated: str | None, signal: Any, file: object) -> float:
    """Nm of 1 of the torque signal's unit, by the database or else as ``stated``."""
    by_database, by_file = units.torque_nm(signal.unit), units.torque_nm(stated)
    if stated is not None and by_file is None and stated != OTHER_UNIT:
        raise InputError(
            file, "override.torque_unit", f"{stated} is no unit of torque that is known",
            f"Nm, mNm, or '{OTHER_UNIT}' where torque_scale shall be taken as it stands",
        )  # fmt: skip
    if stated is not None and by_database is not None and by_database != by_file:
        raise InputError(
            file, "override.torque_unit", f"{signal.name} is in {signal.unit} by the database",
            "leave it out, or mend the database",
        )  # fmt: skip
    found = by_database if stated is None else by_file
    if found is None and stated is None:
        raise InputError(
            file, "override.torque_unit",
            f"is missing, and '{signal.unit or ''}' of {signal.name} is no known unit of torque",
            f"state it: Nm, mNm, or '{OTHER_UNIT}' (a current, say) where torque_scale shall be "
            "taken as it stands",
        )  # fmt: skip
    return found or 0.0


def _check_labels(override: OverrideConfig, message: Any, file: object) -> None:
    """What the database calls the two requests is not the other way round."""
    signal = message.get_signal_by_name(override.request_signal)
    for field, wrong in (("enable_value", _OFF), ("release_value", _ON)):
        value = getattr(override, field)
        label = str((signal.choices or {}).get(value, "")).replace("_", " ")
        other = _ON if wrong is _OFF else _OFF
        if value in no_value_raws(signal) or (wrong.search(label) and not other.search(label)):
            raise InputError(
                file, f"override.{field}", f"{value} of {signal.name} is '{label}' in the database",
                "give the value that says so there",
            )  # fmt: skip


def _check_frame(
    override: OverrideConfig,
    message: Any,
    frame: Frame,
    torque_nm: float,
    enable: bool,
    file: object,
) -> None:
    """The frame says this torque (Nm at the rotor) and this request."""
    read = message.decode(frame.data, decode_choices=False)
    signal = message.get_signal_by_name(override.torque_signal)
    said_nm = float(read[override.torque_signal]) * override.torque_scale
    most = override.limits.max_torque_nm
    step_nm = 1e-6 * most if signal.is_float else abs(float(signal.scale) * override.torque_scale)
    off_nm = _NOTHING * most if torque_nm == 0.0 else 0.501 * step_nm
    if not abs(said_nm - torque_nm) <= off_nm:
        raise InputError(
            file, "override.torque_signal",
            f"{torque_nm:g} Nm at the rotor is {said_nm:g} Nm in {signal.name} as the database "
            "reads it",
            "mend its width, sign, offset or range in the database, or torque_scale",
        )  # fmt: skip
    field = "enable_value" if enable else "release_value"
    asked, said = getattr(override, field), read[override.request_signal]
    if float(said) != asked:
        raise InputError(
            file, f"override.{field}",
            f"{asked} is {said:g} in {override.request_signal} as the database reads it",
            "give a value that the signal can carry",
        )  # fmt: skip


def _check_others(
    override: OverrideConfig, message: Any, frame: Frame, header: int, file: object, dbc_file: str
) -> None:
    """Every other signal says nothing, or zero, or what the database starts it with."""
    rules = rules_of(message)
    known = {override.torque_signal, override.request_signal, rules.counter, rules.crc}
    read = message.decode(frame.data, decode_choices=False)
    for signal in message.signals:
        if signal.name in known or signal.name not in read or header & _bits(message, signal.name):
            continue
        started = signal.raw_initial is not None or no_value_raws(signal)
        value = float(read[signal.name])
        if value != 0.0 and not started:
            raise InputError(
                dbc_file, f"{message.name}.{signal.name}",
                f"would say {value:g} {signal.unit or ''} in every command of {file}",
                "give it a start value (GenSigStartValue)",
            )  # fmt: skip


def _bits(message: Any, name: str) -> int:
    """The bits of a signal in the payload's bytes, as one number."""
    signal = message.get_signal_by_name(name)
    mask = 0
    for k in range(signal.length):
        if signal.byte_order == "little_endian":
            place = signal.start + k
        else:  # the most significant bit first, down within a byte, then on to the next
            row, column = divmod(signal.start, 8)
            down = 7 - column + k
            place = 8 * (row + down // 8) + 7 - down % 8
        mask |= 1 << place
    return mask


def _touched(rule: e2e.E2eProfile, length: int) -> int:
    """The bits that the profile writes into a payload of ``length`` bytes."""
    mask, protector = 0, e2e.E2eProtector(rule, length)
    for fill in (0x00, 0xFF):
        for _ in range(_FRAMES):
            changed = protector.protect(bytes([fill]) * length)
            mask |= int.from_bytes(changed, "little") ^ int.from_bytes([fill] * length, "little")
    return mask
