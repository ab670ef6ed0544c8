"""How the service itself is doing: rates, lateness, loss. Counts in, figures out; no clock."""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from eps_hil.bus.port import BusState, PortCounts
from eps_hil.service.core import ServiceCore

_BINS = 20_000
_BIN_NS = 1_000
_NOT_OURS_NS = 10_000_000_000
TOTALS = ("Overruns", "LostFrames", "CrcErrors", "SendDrops")
_BUS_STATES = {state: number for number, state in enumerate(BusState)}
"""``BusState`` of the DBC: unknown, error_active, error_warning, error_passive, bus_off, lost."""


class Lateness:
    """From the receive stamp of a sync frame to the end of its step, over a whole run.

    A histogram of 1 us bins to 20 ms, so that a run of any length needs the same memory; what
    is later counts into the last bin, and the largest is kept exactly. Stamps of a clock that
    is not this machine's (further than 10 s off, or in the future) are left out.
    """

    def __init__(self) -> None:
        self.count = self.overruns = self.max_ns = 0
        self._recent_max_ns = 0
        self._bins = [0] * (_BINS + 1)

    def add(self, late_ns: int, period_ns: int) -> None:
        """One step; later than a period is an overrun."""
        if not 0 <= late_ns < _NOT_OURS_NS:
            return
        self.count += 1
        self.overruns += late_ns > period_ns
        self._bins[min(late_ns // _BIN_NS, _BINS)] += 1
        self._recent_max_ns = max(self._recent_max_ns, late_ns)
        self.max_ns = max(self.max_ns, late_ns)

    def take_recent_max_ns(self) -> int:
        """The largest since the last call."""
        recent, self._recent_max_ns = self._recent_max_ns, 0
        return recent

    def quantile_ns(self, share: float) -> int:
        """Upper edge of the bin that ``share`` of the steps reach (0 without steps)."""
        wanted = share * self.count
        seen = 0
        for index, number in enumerate(self._bins[:_BINS]):
            seen += number
            if number and seen >= wanted:
                return min((index + 1) * _BIN_NS, self.max_ns)
        return self.max_ns


@dataclass(frozen=True, slots=True)
class Loss:
    """Frames that are missing or wrong, by whoever noticed."""

    by_counter: int
    in_kernel: int
    crc: int
    send_dropped: int

    @classmethod
    def of(cls, faults: Mapping[str, int], counts: PortCounts) -> "Loss":
        """From the decoder's faults and the port's counts."""
        return cls(
            faults.get("lost_frames", 0),
            counts.lost_in_kernel,
            faults.get("crc", 0) + faults.get("length", 0),
            counts.send_dropped,
        )


class StepRate:
    """Steps in the last second, from a total that is looked at every so often."""

    def __init__(self) -> None:
        self._seen: deque[tuple[float, int]] = deque()

    def update(self, now_s: float, steps: int) -> float:
        """The rate in Hz over the last second (or as much of it as there was)."""
        seen = self._seen
        seen.append((now_s, steps))
        while len(seen) > 2 and now_s - seen[1][0] >= 1.0:
            seen.popleft()
        span = now_s - seen[0][0]
        return (steps - seen[0][1]) / span if span > 0 else 0.0


def totals_modulo(message: Any | None) -> dict[str, int]:
    """Where each total of a health message begins again at 0: by the signal's width."""
    if message is None:
        return {}
    return {s.name: 2**s.length for s in message.signals if s.name in TOTALS}


def health_values(
    loss: Loss,
    lateness: Lateness,
    rate_hz: float,
    state: BusState,
    modulo: Mapping[str, int],
) -> dict[str, float]:
    """Signals of ``EPSHIL_Health``; ``modulo``: see :func:`totals_modulo`.

    A total that stayed at the end of its range would hide everything that happens afterwards.
    """
    totals = {
        "Overruns": lateness.overruns,
        "LostFrames": loss.by_counter + loss.in_kernel,
        "CrcErrors": loss.crc,
        "SendDrops": loss.send_dropped,
    }
    wrapped = {name: total % modulo.get(name, total + 1) for name, total in totals.items()}
    return {
        "BusState": _BUS_STATES[state],
        "StepRate": rate_hz,
        "MaxLateness": lateness.take_recent_max_ns() * 1e-6,
        **wrapped,
    }


@dataclass(frozen=True, slots=True)
class Summary:
    """What a run came to."""

    duration_s: float
    steps: int
    valid_steps: int
    published: int
    skipped: int
    foreign: int
    loss: Loss
    late_p50_ms: float
    late_p99_ms: float
    late_max_ms: float
    overruns: int
    bus_losses: int = 0
    failures: Mapping[str, int] = field(default_factory=dict)
    """Errors of the jobs beside the estimates, by what failed; rows that a log lost."""

    @classmethod
    def of(
        cls,
        core: ServiceCore,
        lateness: Lateness,
        loss: Loss,
        duration_s: float,
        published: int,
        bus_losses: int = 0,
        failures: Mapping[str, int] | None = None,
    ) -> "Summary":
        """From the counters of a run that has ended."""
        return cls(
            duration_s,
            core.steps,
            core.valid_steps,
            published,
            core.skipped,
            core.foreign,
            loss,
            lateness.quantile_ns(0.5) * 1e-6,
            lateness.quantile_ns(0.99) * 1e-6,
            lateness.max_ns * 1e-6,
            lateness.overruns,
            bus_losses,
            dict(failures or {}),
        )

    def lines(self) -> list[str]:
        """As a person reads it."""
        rate = self.steps / self.duration_s if self.duration_s > 0 else 0.0
        share = 100 * self.valid_steps / self.steps if self.steps else 0.0
        loss = self.loss
        said = [
            f"steps      {self.steps} in {self.duration_s:.1f} s ({rate:.0f} Hz), "
            f"{share:.1f} % valid",
            f"published  {self.published}, {self.skipped} left out because the loop was late, "
            f"{loss.send_dropped} dropped by a full send queue",
            f"lost       {loss.by_counter} frames by counter, {loss.in_kernel} in the kernel, "
            f"{loss.crc} with a bad CRC or length",
            f"lateness   p50 {self.late_p50_ms:.3f} ms, p99 {self.late_p99_ms:.3f} ms, "
            f"max {self.late_max_ms:.3f} ms, {self.overruns} steps later than their period",
        ]
        if self.bus_losses:
            said.append(f"bus        lost and opened again {self.bus_losses} times")
        said += [f"trouble    {what}: {number}" for what, number in self.failures.items()]
        if self.foreign:
            said.append(f"WARNING    {self.foreign} frames of our ids came from somebody else")
        return said
