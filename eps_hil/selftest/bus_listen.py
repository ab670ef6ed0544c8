"""What comes on the configured bus, and how late it is read. Listens only: nothing is sent."""

import time
from dataclasses import dataclass

from eps_hil.bus.port import open_port
from eps_hil.selftest.check import Check, Verdict, graded
from eps_hil.service.setup import Parts

_GOOD_P99_US, _LIMITED_P99_US = 500.0, 1000.0
_FAST_ENOUGH = 0.98


@dataclass(frozen=True, slots=True)
class Heard:
    """``late_us`` (p50, p99) from stamp to reading; ``sync_hz`` of the sync frame; ``lost``."""

    frames: int
    late_us: tuple[float, float]
    sync_hz: float
    wanted_hz: float
    lost: int


def listen(parts: Parts, seconds: float) -> Heard:
    """:class:`~eps_hil.errors.BusError` where the bus cannot be opened."""
    bus, decoder = parts.config.bus, parts.decoder
    port = open_port(
        bus.interface, bus.channel, fd=bus.fd, receive_ids=decoder.receive_ids, send_ids=(),
        options=bus.options,
    )  # fmt: skip
    late_ns: list[int] = []
    syncs = 0
    try:
        until = time.monotonic() + seconds
        while (left := until - time.monotonic()) > 0:
            for frame in port.recv(left):
                late_ns.append(time.time_ns() - frame.t_ns)
                syncs += decoder.sync(frame)
        lost = port.counts.lost_in_kernel
    finally:
        port.close()
    late_ns.sort()
    p50, p99 = (late_ns[int(q * len(late_ns))] * 1e-3 if late_ns else 0.0 for q in (0.5, 0.99))
    return Heard(len(late_ns), (p50, p99), syncs / seconds, 1 / parts.sync_period_s, lost)


def judge(found: Heard, name: str) -> list[Check]:
    """A bus without traffic is no shortcoming of this PC."""
    if not found.frames:
        return [
            Check("bus", f"frames on {name}", "none", "", Verdict.UNKNOWN,
                  "the rig is off, or on another bus", "start the rig and run this again")
        ]  # fmt: skip
    late = graded(found.late_us[1], _GOOD_P99_US, _LIMITED_P99_US)
    slow = found.sync_hz < _FAST_ENOUGH * found.wanted_hz
    return [
        Check(
            "bus", f"frames on {name}, read at normal priority",
            f"{found.frames}, late p50 {found.late_us[0]:.0f} us, p99 {found.late_us[1]:.0f} us, "
            f"{found.lost} lost", "none lost", Verdict.LIMITED if found.lost else Verdict.GOOD,
            f"p99 {_GOOD_P99_US:.0f} us or less would be good at real-time priority",
            "a larger receive buffer; end what runs beside it" if found.lost else
            "" if late is Verdict.GOOD else "see the wake-ups", found.late_us[1], "us",
        ),
        Check(
            "sync_rate", "sync frame", f"{found.sync_hz:.0f} Hz", f"{found.wanted_hz:.0f} Hz",
            Verdict.LIMITED if slow else Verdict.GOOD, "the estimator steps on it",
            "the rig sends it too seldom, or the DBC's cycle time is wrong" if slow else "",
            found.sync_hz, "Hz",
        ),
    ]  # fmt: skip
