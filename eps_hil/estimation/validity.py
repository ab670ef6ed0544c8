"""Why an estimate is not valid: one set of bits for the estimator, the bus and the files."""

from enum import IntFlag


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
    """Torsion-bar torque, once there, is missing or too old."""
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


def words(reason: Reason) -> str:
    """The set bits as a person reads them: ``"motor speed, settling"``; ``"fine"`` for none."""
    named = [bit.name for bit in Reason if bit & reason and bit.name]
    return ", ".join(name.lower().replace("_", " ") for name in named) or "fine"
