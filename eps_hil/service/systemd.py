"""What a service manager wants to hear: sd_notify's protocol (man 3 sd_notify), without systemd.

Lines of ``KEY=VALUE`` in a datagram to the socket that ``NOTIFY_SOCKET`` names. Whoever started the
program without one hears nothing. The watchdog is fed by the loop that does the work, so that a
loop that hangs starves it and is killed and started anew.
"""

import os
import socket
from collections.abc import Mapping

_FED_PER_INTERVAL = 3
_WAITING_US = 180_000_000


class Notifier:
    """One process's line to whoever started it; what cannot be delivered is left out."""

    def __init__(self, environment: Mapping[str, str] | None = None) -> None:
        environment = os.environ if environment is None else environment
        self._address = _address(environment.get("NOTIFY_SOCKET", ""))
        self.watchdog_s = _watchdog_s(environment) if self._address else 0.0
        """Within this time a sign of life is wanted; 0: none is."""
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) if self._address else None
        if self._socket is not None:
            self._socket.setblocking(False)

    @property
    def feed_s(self) -> float:
        """How often to call :meth:`alive`; 0: never."""
        return self.watchdog_s / _FED_PER_INTERVAL

    def ready(self, status: str) -> None:
        """Started up; ``status``: one line that ``systemctl status`` shows."""
        self._tell(f"READY=1\nSTATUS={status}")

    def alive(self) -> None:
        """A sign of life."""
        self._tell("WATCHDOG=1")

    def status(self, line: str) -> None:
        """What ``systemctl status`` shows from now on."""
        self._tell(f"STATUS={line}")

    def waiting(self, line: str) -> None:
        """Not ready yet, for a reason: the time for starting up begins anew."""
        self._tell(f"STATUS=waiting: {line}\nEXTEND_TIMEOUT_USEC={_WAITING_US}")

    def stopping(self) -> None:
        """The end has begun."""
        self._tell("STOPPING=1")

    def close(self) -> None:
        """Hang up."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _tell(self, text: str) -> None:
        if self._socket is None or self._address is None:
            return
        try:
            self._socket.sendto(text.encode(), self._address)
        except OSError:  # nobody there any more, or too busy to listen: no reason to fail
            return


def _address(name: str) -> str | None:
    """``/path``, or ``@abstract`` as the kernel writes it; None for neither."""
    if name.startswith("@"):
        return "\0" + name[1:]
    return name if name.startswith("/") else None


def _watchdog_s(environment: Mapping[str, str]) -> float:
    """The interval that is meant for this very process."""
    wanted, of = environment.get("WATCHDOG_USEC", ""), environment.get("WATCHDOG_PID", "")
    if not wanted.isdecimal() or (of and of != str(os.getpid())):
        return 0.0
    return int(wanted) * 1e-6
