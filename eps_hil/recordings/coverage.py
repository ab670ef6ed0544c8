"""What a model is driven with where a recorded input has no sample: said, as nobody recorded it."""

from collections.abc import Iterable, Mapping

import numpy as np

from eps_hil.recordings.common_rate import longest_step_ns
from eps_hil.series import Series

_NS = 1_000_000_000


def invented(series: Mapping[str, Series], names: Iterable[str], driver: str) -> list[str]:
    """Notes on those of ``names`` that are bad, missing or over while ``driver`` goes on.

    A signal that is not there at all is another's to tell.
    """
    begin_ns, end_ns = int(series[driver].t_ns[0]), int(series[driver].t_ns[-1])
    notes: list[str] = []
    for name in names:
        one = series.get(name)
        if one is None:
            continue
        good = np.isfinite(one.value)
        t_ns = one.t_ns[good]
        if not len(t_ns):
            notes.append(f"{name} has no good sample: taken as zero")
            continue
        if bad := int(np.count_nonzero(~good)):
            notes.append(f"{name}: {bad} bad samples: drawn straight between the good ones")
        longest_ns = longest_step_ns(one.t_ns)
        lead_ns, tail_ns = int(t_ns[0]) - begin_ns, end_ns - int(t_ns[-1])
        if lead_ns > longest_ns:
            late = f"begins {lead_ns / _NS:.3g} s after {driver}"
            notes.append(f"{name} {late}: until then held at its first value")
        if tail_ns > longest_ns:
            early = f"ends {tail_ns / _NS:.3g} s before {driver}"
            notes.append(f"{name} {early}: from there on held at its last value")
        within = t_ns[(t_ns >= begin_ns) & (t_ns <= end_ns)]
        steps = np.diff(within)
        if (gaps := int(np.count_nonzero(steps > longest_ns))) > 0:
            row = int(np.argmax(steps))
            since_s = (int(within[row]) - begin_ns) / _NS
            notes.append(
                f"{name}: {gaps} gaps, the longest of {steps[row] / _NS:.3g} s at {since_s:.3f} s: "
                "drawn straight"
            )
    return notes
