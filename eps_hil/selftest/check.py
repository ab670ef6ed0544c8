"""One line of the self-test: a measured figure against a limit that has a reason.

Measuring and judging are apart: the judges of this package are pure functions of what was
measured, so that a machine with any shortcoming can be put before them in a test.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum


class Verdict(StrEnum):
    """How a figure stands against its limit; ``TOLD`` and ``UNKNOWN`` do not count."""

    GOOD = "good"
    LIMITED = "limited"
    NOT_GOOD = "not good"
    TOLD = "told"
    """A fact that explains other lines and has no limit of its own."""
    UNKNOWN = "unknown"
    """It could not be measured here."""


_WORSE = (Verdict.GOOD, Verdict.LIMITED, Verdict.NOT_GOOD)


@dataclass(frozen=True, slots=True)
class Check:
    """One line. ``value`` is the figure that was judged, in ``unit``; None where there is none.

    ``reason`` says where the limit comes from; ``remedy`` what to change (empty when good).
    """

    id: str
    what: str
    measured: str
    limit: str
    verdict: Verdict
    reason: str = ""
    remedy: str = ""
    value: float | None = None
    unit: str = ""


def graded(value: float, good: float, limited: float) -> Verdict:
    """``GOOD`` up to ``good``, ``LIMITED`` up to ``limited``, else ``NOT_GOOD`` (NaN: not good)."""
    if value <= good:
        return Verdict.GOOD
    return Verdict.LIMITED if value <= limited else Verdict.NOT_GOOD


def graded_least(value: float, good: float, limited: float) -> Verdict:
    """The same where more is better: ``GOOD`` from ``good`` on, ``LIMITED`` from ``limited`` on."""
    return graded(-value, -good, -limited)


def overall(checks: Iterable[Check]) -> Verdict:
    """The worst verdict that counts."""
    counting = [check.verdict for check in checks if check.verdict in _WORSE]
    return max(counting, key=_WORSE.index, default=Verdict.UNKNOWN)


def guarded(id: str, what: str, measure: Callable[[], Sequence[Check]]) -> Sequence[Check]:
    """What ``measure`` found; one ``UNKNOWN`` line where this machine lacks what it asks for.

    Every error is caught, because the machines that need this test most lack the most.
    """
    try:
        return measure()
    except Exception as error:
        said = " ".join(f"{type(error).__name__}: {error}".split())
        return [Check(id, what, "could not be measured", "", Verdict.UNKNOWN, reason=said)]
