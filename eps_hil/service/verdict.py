"""What is wrong with which signal: a code for each, and every reason of the estimate, on the bus.

``EPSHIL_Estimate`` has room for thirteen reasons, and several of them do not say whose fault it is.
This looks at what the estimator read last, signal by signal, beside the path of every frame.
"""

from collections.abc import Sequence
from enum import IntEnum

from eps_hil.estimation.alignment import read_between
from eps_hil.estimation.stream import SIGNALS, StreamEstimator
from eps_hil.estimation.stream_timing import SENSOR
from eps_hil.estimation.validity import Reason

NEEDED = (
    "MotorTorqueVerdict", "TorsionBarTorqueVerdict", "MotorSpeedVerdict", "MotorAngleVerdict",
    "RackForceVerdict", "EstimateReasons",
)  # fmt: skip
"""Signals of ``EPSHIL_Verdict``: one for each of ``SIGNALS``, in that order, then the reasons."""
_LOST, _GAP, _BAD = 1, int(Reason.GAP), int(Reason.BAD_SAMPLE)
_LATE_NS = 70_000_000
"""Samples may wait so long for a sync frame that does not come."""
_MOTION = frozenset(SIGNALS[:4])


class SignalVerdict(IntEnum):
    """The codes, as the DBC labels them."""

    FINE = 0
    MISSING = 1
    """It was there, and its newest sample is too old."""
    NOT_AVAILABLE = 2
    """Damaged (CRC, length, counter), or its sender says that there is no value. After some 20 ms
    of nothing but damaged frames it is ``MISSING``: what is damaged has no instant."""
    OUT_OF_RANGE = 3
    TOO_FAST = 4
    """It changed faster than it can."""
    GAP = 5
    """Samples are missing around the instant that was read; or they come, of a torque, more seldom
    than the configuration says, for so long that the estimate is invalid by it."""
    FROZEN = 6
    INCONSISTENT = 7
    """Torques, speed and angle cannot all be right; which of them is wrong, nobody can tell."""
    NEVER_SEEN = 8
    NOT_USED = 15
    """Not mapped, or not used by this estimator."""


def signal_verdicts(
    estimator: StreamEstimator, reason: Reason, silent_at_ns: int | None = None
) -> Sequence[SignalVerdict]:
    """One for each of ``SIGNALS`` at the instant that was estimated last.

    ``silent_at_ns``: the present, where the sync frame has stopped and no instant is estimated.
    """
    memory, timing = estimator.memory, estimator.timing
    at_ns, slack_ns = int(memory.grid[0]) - timing.step_ns - timing.lookback, 0
    if silent_at_ns is not None:
        at_ns, slack_ns = silent_at_ns - timing.lookback, _LATE_NS
    watch = memory.watch[0]
    found = []
    for i, name in enumerate(SIGNALS):
        if not timing.used[i]:
            found.append(SignalVerdict.NOT_USED)
            continue
        if memory.filled[i] == 0:
            found.append(SignalVerdict.NEVER_SEEN)
            continue
        _, why, apart = read_between(
            memory.stamps, memory.values, memory.filled, i, at_ns + int(timing.delay[i]),
            int(timing.stale[i]) + slack_ns, _LOST,
        )  # fmt: skip
        if i <= SENSOR and apart > timing.missing[i]:
            why |= int(reason & Reason.GAP)
        found.append(_code(int(why), int(watch.refused[i]), bool(watch.frozen[i]), name, reason))
    return found


def verdict_values(
    estimator: StreamEstimator, reason: Reason, silent_at_ns: int | None = None
) -> dict[str, float]:
    """Signals of ``EPSHIL_Verdict``."""
    told = reason if silent_at_ns is None else reason | Reason.NO_INPUT
    codes = signal_verdicts(estimator, reason, silent_at_ns)
    return dict(zip(NEEDED, (*map(int, codes), int(told)), strict=True))


def _code(why: int, refused: int, frozen: bool, name: str, reason: Reason) -> SignalVerdict:
    bad = bool(why & _BAD)
    holds = (
        (bool(why & _LOST), SignalVerdict.MISSING),
        (bad and bool(refused & Reason.RANGE), SignalVerdict.OUT_OF_RANGE),
        (bad and bool(refused & Reason.RATE), SignalVerdict.TOO_FAST),
        (bad, SignalVerdict.NOT_AVAILABLE),
        (bool(why & _GAP), SignalVerdict.GAP),
        (frozen, SignalVerdict.FROZEN),
        (bool(reason & Reason.INCONSISTENT) and name in _MOTION, SignalVerdict.INCONSISTENT),
    )
    return next((code for so, code in holds if so), SignalVerdict.FINE)
