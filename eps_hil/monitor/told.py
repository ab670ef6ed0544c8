"""Messages of the service and the ECU that are not signals of the rig: their newest good frame."""

from collections.abc import Mapping
from typing import Any

from eps_hil.bus.codec import crc_rule, rules_of
from eps_hil.bus.database import find_message
from eps_hil.bus.frame import Frame
from eps_hil.bus.signal_codec import no_value_raws
from eps_hil.monitor.meters import RateMeter


class Told:
    """One message: keeps the newest frame whose CRC is right, and decodes it when asked."""

    def __init__(self, message: Any) -> None:
        rules = rules_of(message)
        self.name: str = message.name
        self.key = (int(message.frame_id), bool(message.is_extended_frame))
        self.bad = 0
        self.t_ns: int | None = None
        self._message, self._data = message, b""
        self._length = int(message.length)
        crc = next((s for s in message.signals if s.name == rules.crc), None)
        self._crc = None if crc is None else crc_rule(message, crc, rules, "DBC", message.name)
        # a label "invalid" among others is a state, and not a missing value
        self._none = {
            signal.name: no_value_raws(signal)
            for signal in message.signals
            if len(signal.choices or ()) == 1
        }
        self._rate = RateMeter()

    def take(self, frame: Frame) -> bool:
        """Keep a frame; False (and counted) for one that is too short or damaged."""
        data = frame.data[: self._length]
        if len(data) < self._length or (self._crc is not None and not self._crc.good(data)):
            self.bad += 1
            return False
        self.t_ns, self._data = frame.t_ns, data
        self._rate.add(frame.t_ns)
        return True

    def values(self) -> Mapping[str, Any]:
        """Signals of the newest good frame, labels as text; empty without one."""
        found = self._decoded()
        return {name: value if isinstance(value, int | float) else str(value)
                for name, value in found.items()}  # fmt: skip

    def numbers(self) -> Mapping[str, float]:
        """The same with labels as numbers; NaN for 'signal not available'."""
        return {name: self._number(name, value) for name, value in self._decoded().items()}

    def _decoded(self) -> Mapping[str, Any]:
        if self.t_ns is None:
            return {}
        try:
            return dict(self._message.decode(self._data))
        except Exception:  # cantools raises what it likes
            return {}

    def _number(self, name: str, value: Any) -> float:
        raw = getattr(value, "value", value)
        none = raw is not value and raw in self._none.get(name, ())
        return float("nan") if none or not isinstance(raw, int | float) else float(raw)

    def age_s(self, now_ns: int) -> float:
        """Since the newest good frame; infinite without one."""
        return float("inf") if self.t_ns is None else (now_ns - self.t_ns) * 1e-9

    def rate_hz(self, now_ns: int) -> float:
        """Good frames in the last second."""
        return self._rate.per_s(now_ns)


def told_of(database: Any, name: str | None) -> Told | None:
    """A reader of message ``name``; None where the database has none of that name."""
    message = None if name is None else find_message(database, name)
    return None if message is None else Told(message)
