"""Why an estimate is not valid: one set of bits for the estimator, the bus and the files."""

from enum import IntFlag
from functools import lru_cache

# frozen into compiled code: the kernels hold these bits


class Reason(IntFlag):
    """Bits published beside the estimate; 0 means that it is valid.

    The DBC's ``EPSHIL_Estimate`` carries them in this order (a test holds the two together).
    """

    FINE = 0
    NOT_STARTED = 1
    """No complete set of inputs has been seen yet."""
    MOTOR_TORQUE = 2
    """Motor torque is missing or too old."""
    TORQUE_SENSOR = 4
    """Torsion-bar torque, mapped or in the recording, is missing or too old."""
    MOTOR_SPEED = 8
    """Rotor speed (or the angle it is derived from) is missing or too old."""
    RACK_FORCE = 16
    """The known rack force is missing or too old (observer turned around to give friction)."""
    BAD_SAMPLE = 32
    """An input was NaN or infinite: a failed CRC, a counter fault, 'signal not available'."""
    GAP = 64
    """Samples are missing inside the interval that was interpolated."""
    SETTLING = 128
    """Inputs are back (or new); the observer has not settled yet."""
    NO_INPUT = 256
    """The sync frame has stopped; nothing is being estimated."""
    TIME = 512
    """Sample time jumped; the estimator started again."""
    DIVERGED = 1024
    """The estimator's own numbers became impossible; it started again."""
    OTHER_TRANSMITTER = 2048
    """Somebody else sends the estimate's id too; nobody can tell whose a frame is."""
    OUT_OF_RANGE = 4096
    """An effect that was found in recordings is asked beyond the range that they covered; or it
    depends on the rotor's or rack's place, and no angle is measured."""
    STALE = 8192
    """The estimate is older than its look-back and a limit: it, or the service, was held up."""
    FRICTION_UNKNOWN = 16384
    """The bristle's history is unknown (start, gap), and the rotor has not slid since; or what
    effects with memory missed in a hole is not forgotten yet."""
    RANGE = 32768
    """A signal reads what it cannot be (``plausibility`` of the estimator's settings)."""
    RATE = 65536
    """A signal changed faster than it can."""
    FROZEN = 131072
    """A signal repeats one value bit for bit while the rotor moves."""
    INCONSISTENT = 262144
    """The torque cannot have made this motion: the observer's innovation is too large."""
    IMPLAUSIBLE = 524288
    """The estimate itself is beyond what a rack can carry."""


def words(reason: Reason) -> str:
    """The set bits as a person reads them: ``"motor speed, settling"``; ``"fine"`` for none."""
    named = [bit.name for bit in Reason if bit & reason and bit.name]
    return ", ".join(name.lower().replace("_", " ") for name in named) or "fine"


_PUBLISHED = (1 << 13) - 1
_ON_THE_BUS = {
    Reason.STALE: Reason.TIME,
    Reason.FRICTION_UNKNOWN: Reason.SETTLING,
    Reason.RANGE: Reason.BAD_SAMPLE,
    Reason.RATE: Reason.BAD_SAMPLE,
    Reason.FROZEN: Reason.BAD_SAMPLE,
    Reason.INCONSISTENT: Reason.DIVERGED,
    Reason.IMPLAUSIBLE: Reason.DIVERGED,
}


@lru_cache(maxsize=4096)
def reason_of(bits: int) -> Reason:
    """The same as ``Reason(bits)``, which takes as long as a step of the estimator."""
    return Reason(int(bits))  # numpy's where kernels run as Python


def on_the_bus(reason: Reason) -> Reason:
    """The reason in the thirteen bits that ``EPSHIL_Estimate`` has room for."""
    if reason <= _PUBLISHED:
        return reason
    told = reason & Reason(_PUBLISHED)
    for detail, bit in _ON_THE_BUS.items():
        if reason & detail:
            told |= bit
    return told


@lru_cache(maxsize=4096)
def bits_on_the_bus(bits: int) -> int:
    """The same for plain numbers, remembered: it stands between a sync frame and its answer."""
    return int(on_the_bus(Reason(bits)))


def of_inputs(reason: Reason) -> Reason:
    """What a reason says of the inputs alone: an unknown bristle is no fault of theirs."""
    return reason & ~Reason.FRICTION_UNKNOWN
