"""Where recorded signals have no sample: gaps, and what a model is driven with instead."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from eps_hil.recordings.common_rate import longest_step_ns
from eps_hil.series import Series

_NS = 1_000_000_000


@dataclass(frozen=True, slots=True)
class Gaps:
    """Of one signal: how many stretches without a good sample, and the longest of them (s).

    ``at_s``: where that begins, from the recording's first sample on.
    """

    count: int
    longest_s: float
    at_s: float

    def __str__(self) -> str:
        many = "1 gap of" if self.count == 1 else f"{self.count} gaps, the longest of"
        return f"{many} {self.longest_s:.3g} s at {self.at_s:.3f} s"


def gaps(series: Mapping[str, Series], names: Iterable[str]) -> dict[str, Gaps]:
    """Those of ``names`` that have any: more than 0.1 s and three of the signal's own steps."""
    begin_ns = min(int(one.t_ns[0]) for one in series.values())
    found = {}
    for name in names:
        if (one := series.get(name)) is None:
            continue
        good = np.isfinite(one.value)
        t_ns = one.t_ns if good.all() else one.t_ns[good]
        steps = np.diff(t_ns)
        if count := int(np.count_nonzero(steps > longest_step_ns(one.t_ns))):
            row = int(np.argmax(steps))
            at_s = (int(t_ns[row]) - begin_ns) / _NS
            found[name] = Gaps(count, float(steps[row]) / _NS, at_s)
    return found


def in_words(found: Mapping[str, Gaps]) -> list[str]:
    """A sentence for each signal's gaps; one for all that have the same."""
    alike: dict[str, list[str]] = {}
    for name, one in found.items():
        alike.setdefault(str(one), []).append(name)
    return [f"{', '.join(names)}: {said}" for said, names in alike.items()]


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
