"""A recording in memory: canonical signals, each on its own time base, whatever the file was."""

from collections.abc import Mapping
from dataclasses import dataclass

from eps_hil.series import Series


@dataclass(frozen=True, slots=True)
class Recording:
    """Canonical signals of one file; ``notes`` says what the reader had to leave out or mend."""

    name: str
    series: Mapping[str, Series]
    notes: tuple[str, ...] = ()
