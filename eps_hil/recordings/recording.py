"""A recording in memory: canonical signals, each on its own time base, whatever the file was."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from eps_hil.series import Arrivals, Pace, Series


@dataclass(frozen=True, slots=True)
class Recording:
    """Canonical signals of one file; ``notes`` says what the reader had to leave out or mend.

    Of a CAN log: ``arrivals``, when the frames came that the estimator steps on, and ``pace``, what
    the mapping says of its timing.
    """

    name: str
    series: Mapping[str, Series]
    notes: tuple[str, ...] = ()
    arrivals: Arrivals | None = field(default=None, compare=False, repr=False)
    pace: Pace | None = field(default=None, compare=False, repr=False)
