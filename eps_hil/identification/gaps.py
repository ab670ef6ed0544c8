"""Stretches without samples: what is left out, and whether time itself was lost there.

A bus that loses frames leaves a hole in which the rig went on. A simulated rig or a logger that was
held up leaves a hole in the stamps in which nothing happened: the rotor turns by less, or by more,
than its speed times the stamps say. Bridged, such a hole is an acceleration that never was.
"""

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from eps_hil.identification.finding import Finding
from eps_hil.series import usual_step_ns

Floats = npt.NDArray[np.float64]
Stamps = npt.NDArray[np.int64]
Clean = Mapping[str, tuple[Stamps, Floats]]

LONGEST_S = 0.005
"""Longer stretches without samples (and than five periods) are left out instead of bridged."""
_ALLOWED = 0.3
_CLEAR_RAD = 0.05


def longest_s(t_ns: Stamps) -> float:
    """The longest stretch without samples that may be bridged, for a signal with these stamps."""
    return max(LONGEST_S, 5e-9 * usual_step_ns(t_ns))


def holes(t_ns: Stamps) -> list[tuple[int, int]]:
    """(last stamp before, first stamp after) of every stretch that is too long, ns."""
    where = np.flatnonzero(np.diff(t_ns) > 1e9 * longest_s(t_ns))
    return [(int(t_ns[k]), int(t_ns[k + 1])) for k in where]


def findings(name: str, clean: Clean) -> list[Finding]:
    """What a person should know of the holes of one recording."""
    told = []
    counts = {key: len(holes(t_ns)) for key, (t_ns, _) in clean.items()}
    longest = {key: longest_s(t_ns) for key, (t_ns, _) in clean.items()}
    alike = len(counts) > 1 and len({(counts[k], round(longest[k], 4)) for k in counts}) == 1
    for key, count in counts.items():
        if count:
            words = f"{count} {_gaps(count)} longer than {longest[key]:.3g} s left out"
            words += ", in all signals" if alike else ""
            told.append(Finding("gaps", name, "" if alike else key, words))
            if alike:
                break
    if "motor_speed_rad_s" in clean and "motor_angle_rad" in clean:
        told += _lost_time(name, clean)
    return told


def _lost_time(name: str, clean: Clean) -> list[Finding]:
    """Holes over which the angle moves by something else than the speed says."""
    t_ns, angle = clean["motor_angle_rad"]
    speed_ns, speed = clean["motor_speed_rad_s"]
    lost = []
    for before, after in holes(t_ns):
        ends = np.interp([before, after], speed_ns, speed)
        told = 1e-9 * (after - before) * float(ends.mean())
        moved = float(np.subtract(*np.interp([after, before], t_ns, angle)))
        bent = 1e-9 * (after - before) * abs(float(ends[1] - ends[0]))
        if abs(moved - told) > _ALLOWED * abs(told) + bent + _CLEAR_RAD:
            lost.append((before, after, moved, told))
    if not lost:
        return []
    before, after, moved, told = max(lost, key=lambda one: abs(one[2] - one[3]))
    origin = min(int(stamps[0]) for stamps, _ in clean.values())
    words = (
        f"over {len(lost)} {_gaps(len(lost))} the angle does not move as the speed says (at "
        f"{1e-9 * (before - origin):.2f} s, {1e-6 * (after - before):.0f} ms: by {moved:.2g} "
        f"instead of {told:.2g} rad): the clock of the stamps jumped, or the rig stood still; "
        "left out"
    )
    return [Finding("lost_time", name, "motor_angle_rad", words)]


def _gaps(count: int) -> str:
    return "gap" if count == 1 else "gaps"
