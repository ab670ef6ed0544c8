"""Two channels' clocks against each other, by frames that both have (a gateway, two interfaces)."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from eps_hil.clocks.cadence import Line, line_with_steps, moved_to
from eps_hil.clocks.same_frames import FEWEST, Ambiguous, Same, same_frames
from eps_hil.clocks.stamps import Channel

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

_BLOCKS = 240
_PER_BLOCK = 24


@dataclass(frozen=True, slots=True)
class Between:
    """Stamps of ``channel`` less those of ``reference``: at the log's start, and how they drift.

    Half widths at 95 %. ``pairs``: frames that both channels have.
    """

    channel: str
    reference: str
    pairs: int
    base_ns: int
    """A whole part of the difference: clocks may be years apart."""
    line: Line
    """What is beyond it over time since the reference's first stamp, s, with steps that the
    channels by themselves did not show."""
    offset_s: float
    offset_half_width_s: float
    drift_ppm: float
    drift_half_width_ppm: float
    jitter_s: float
    within_s: float | None
    """How near the clocks were taken to be, as payloads repeat; None where nothing was taken."""

    def on_reference(self, t_ns: Integers, reference_start_ns: int) -> Integers:
        """Stamps (n,) of the channel by the reference's clock."""
        rough = t_ns - self.base_ns
        late_s = self.line.at(np.asarray((rough - reference_start_ns) * 1e-9, np.float64))
        at_s: Floats = np.asarray((rough - reference_start_ns) * 1e-9 - late_s, np.float64)
        return np.asarray(rough - np.round(self.line.at(at_s) * 1e9).astype(np.int64))


@dataclass(frozen=True, slots=True)
class Untied:
    """A channel whose clock cannot be compared, and why, in words."""

    channel: str
    reference: str
    why: str


def between(channel: Channel, reference: Channel, least_s: float = 30e-6) -> Between | Untied:
    """How ``channel``'s clock lies to the ``reference``'s, both without their own jumps.

    ``least_s``: smallest step that is looked for.
    """
    same = same_frames(channel, reference)
    if not isinstance(same, Same):
        return Untied(channel.name, reference.name, _why(same))
    start_ns = int(reference.t_ns[0])
    apart_ns = same.t_ns - same.reference_ns
    base_ns = int(np.median(apart_ns))
    t: Floats = np.asarray((same.reference_ns - start_ns) * 1e-9, np.float64)
    difference: Floats = np.asarray((apart_ns - base_ns) * 1e-9, np.float64)
    blocks = min(_BLOCKS, max(len(t) // _PER_BLOCK, 2))
    groups = np.array_split(np.arange(len(t)), blocks)
    middle = np.array([float(np.mean(t[g])) for g in groups], np.float64)
    usual = np.array([float(np.median(difference[g])) for g in groups], np.float64)
    line = moved_to(line_with_steps(middle, usual, least_s), t, difference)
    before = float(line.at(np.zeros(1))[0])
    wide = float(np.hypot(line.errors[0], line.middle_s * line.slope_sigma))
    jitter = difference - line.at(t)
    return Between(
        channel=channel.name,
        reference=reference.name,
        pairs=len(t),
        base_ns=base_ns,
        line=line,
        offset_s=base_ns * 1e-9 + before,
        offset_half_width_s=1.96 * wide,
        drift_ppm=1e6 * line.slope,
        drift_half_width_ppm=1.96e6 * line.slope_sigma,
        jitter_s=float(np.sqrt(np.mean(jitter**2))),
        within_s=same.within_s,
    )


def _why(same: Ambiguous | None) -> str:
    if same is None:
        return f"fewer than {FEWEST} frames in common, by id and payload: cannot be compared"
    nearest, apart = same.nearest_ns * 1e-9, same.apart_ns * 1e-9
    return (
        f"payloads repeat: {_time(nearest)} fits, and so do others, {_time(apart)} and more from "
        "it; nothing is corrected by it"
    )


def _time(seconds: float) -> str:
    return f"{seconds:.3f} s" if abs(seconds) >= 10.0 else f"{1e3 * seconds:.1f} ms"
