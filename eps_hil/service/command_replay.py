"""The torque commands of a log as a source of an override session: just another wish.

What the log asked for at each instant is asked for again; the guard judges it as it judges every
request, and the frames on the bus are the session's own, with fresh counters and CRCs. No frame of
the log is sent.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from eps_hil.bus.codec import crc_rule, rules_of
from eps_hil.bus.database import find_message, load_database
from eps_hil.bus.e2e import E2eProtector
from eps_hil.bus.frame import Frame
from eps_hil.bus.protection import CrcRule
from eps_hil.bus.replay import offsets
from eps_hil.errors import InputError
from eps_hil.service.override_setup import OverrideParts

HOLD_NS = 20_000_000
"""So long after a command of the log its torque is still wanted; an ECU lets go then too."""


@dataclass(frozen=True, slots=True)
class LoggedCommand:
    """One command of the log, ``t_ns`` after the first; torque None: release, or not readable."""

    t_ns: int
    torque_nm: float | None


def read_commands(
    frames: Iterable[Frame], parts: OverrideParts, log: object
) -> list[LoggedCommand]:
    """The log's commands; :class:`InputError` where there are none that enable a torque, and
    where one is beyond ``override.limits.max_torque_nm``, which could only end in a trip."""
    read = _Reader(parts)
    key = (parts.command.can_id, parts.command.extended)
    found = [
        LoggedCommand(t_ns, read(frame))
        for t_ns, frame in offsets(
            one for one in frames if (one.can_id, one.extended) == key and not one.error
        )
        if not frame.remote
    ]
    torques = [abs(each.torque_nm) for each in found if each.torque_nm is not None]
    name = parts.override.command_message
    if not torques:
        problem = f"holds no {name} (0x{key[0]:X}) that enables a torque"
        raise InputError(log, "--commands", problem, "is it the log of an override?")
    limit_nm = parts.override.limits.max_torque_nm
    if max(torques) > limit_nm:
        raise InputError(
            log, "--commands", f"commands up to {max(torques):g} Nm, and the guard allows "
            f"{limit_nm:g} Nm", "see override.limits.max_torque_nm",
        )  # fmt: skip
    return found


class CommandReplay:
    """See :class:`~eps_hil.service.override_core.Source`."""

    def __init__(self, commands: Sequence[LoggedCommand]) -> None:
        self._commands = commands
        self._start_ns: int | None = None
        self._newest_ns = self._went_on_ns = -(10**18)
        self._next = 0
        self.over = False
        """The last command has been asked for."""

    @property
    def done(self) -> tuple[int, int]:
        """(commands asked for so far, all)."""
        return self._next, len(self._commands)

    def step(
        self, t_ns: int, values: Mapping[str, float], *, engaged: bool, now_ns: int
    ) -> float | None:
        """What the log asked for as long after its first command as this is after the first
        engaged step; None where it asked for nothing for 20 ms, or sample time stood so long."""
        if t_ns > self._newest_ns:
            self._newest_ns, self._went_on_ns = t_ns, now_ns
        if not engaged or self.over:
            return None
        if now_ns - self._went_on_ns > HOLD_NS:
            return None
        if self._start_ns is None:
            self._start_ns = t_ns
        place_ns = t_ns - self._start_ns
        commands = self._commands
        while self._next < len(commands) and commands[self._next].t_ns <= place_ns:
            self._next += 1
        newest = commands[max(self._next - 1, 0)]
        stale = place_ns - newest.t_ns > HOLD_NS
        self.over = stale and self._next == len(commands)
        return None if stale else newest.torque_nm


class _Reader:
    """A frame of the command message -> torque (Nm), or None."""

    def __init__(self, parts: OverrideParts) -> None:
        override = self._override = parts.override
        database = load_database(parts.config.dbc, strict=parts.mapping.strict)
        message: Any = find_message(database, override.command_message)
        self._message = message
        self._signal = message.get_signal_by_name(override.torque_signal)
        self._crc: CrcRule | E2eProtector | None = None
        rules = rules_of(message)
        if override.e2e is not None:  # header and CRC are the profile's then, not the DBC's
            self._crc = E2eProtector(override.e2e, message.length)
        elif rules.crc is not None:
            crc = message.get_signal_by_name(rules.crc)
            dbc_file, place = parts.config.dbc[0], override.command_message
            self._crc = crc_rule(message, crc, rules, dbc_file, place)

    def __call__(self, frame: Frame) -> float | None:
        data = frame.data[: self._message.length]
        if len(data) < self._message.length or not (self._crc is None or self._crc.good(data)):
            return None
        try:
            raw = self._message.decode(data, decode_choices=False)
        except Exception:  # cantools raises what it likes
            return None
        override, signal = self._override, self._signal
        if raw.get(override.request_signal) != override.enable_value:
            return None
        value = float(raw.get(override.torque_signal, math.nan))
        low = -math.inf if signal.minimum is None else float(signal.minimum)
        high = math.inf if signal.maximum is None else float(signal.maximum)
        return value * override.torque_scale if low <= value <= high else None
