"""The live line of ``eps-hil run``: a snapshot of the latest values, and how it reads."""

from dataclasses import dataclass

from eps_hil.estimation.stream import Estimate
from eps_hil.estimation.validity import words
from eps_hil.service.core import ServiceCore


@dataclass(frozen=True, slots=True)
class Snapshot:
    """The latest values. ``load_cell_n``: what the rig measured at the estimate's instant."""

    estimate: Estimate | None
    load_cell_n: float | None
    age_ms: float
    rate_hz: float
    silent: bool
    bus_lost: bool

    @classmethod
    def of(cls, core: ServiceCore, rate_hz: float, *, silent: bool, bus_lost: bool) -> "Snapshot":
        """Read off a running core."""
        estimate = core.latest
        if estimate is None:
            return cls(None, None, 0.0, rate_hz, silent, bus_lost)
        return cls(
            estimate,
            core.load_cell_at(estimate.t_ns),
            (core.sync_t_ns - estimate.t_ns) * 1e-6,
            rate_hz,
            silent,
            bus_lost,
        )

    def line(self) -> str:
        """One line of at most 100 characters."""
        if self.bus_lost:
            return "bus lost, waiting for it"
        if self.silent or self.estimate is None:
            return "no input: the sync frame is missing"
        estimate = self.estimate
        said = f"rack force {estimate.rack_force_n:+8.0f} N"
        if self.load_cell_n is not None:
            said += f"  load cell {self.load_cell_n:+8.0f} N"
        verdict = "valid" if estimate.valid else f"INVALID: {words(estimate.reason)}"
        return f"{said}  {self.rate_hz:5.0f} Hz  age {self.age_ms:4.1f} ms  {verdict}"[:100]
