"""Whether a rig's database reads the set-points as they are meant, asked before any is sent.

They are written in rad/s of the steering wheel and in N. A database with other units, a narrower
range or other signs would have the rig do something else; every frame is read again by cantools.
"""

from collections.abc import Callable, Mapping
from typing import Any

from eps_hil.bus import units
from eps_hil.bus.frame import Frame
from eps_hil.errors import InputError

Values = Mapping[str, float]
_UNITS = {
    "WheelSpeedSetPoint": ("angular speed", "rad/s"),
    "RackForceSetPoint": ("force", "N"),
}


def check_set_points(
    message: Any, frame: Callable[[Values], Frame], wanted: list[Values], dbc_file: str
) -> None:
    """:class:`InputError` where a unit is another, or frames of ``wanted`` read otherwise.

    ``message``: the rig's command in the database.
    """
    for name, (quantity, unit) in _UNITS.items():
        signal = _signal(message, name, dbc_file)
        if units.known(signal.unit) != (quantity, 1.0):
            raise InputError(
                dbc_file, f"{message.name}.{name}",
                f"is in '{signal.unit or ''}', and set-points are written in {unit}",
                f"let the rig take {unit}, and say so in the database",
            )  # fmt: skip
    for values in wanted:
        read = message.decode(frame(values).data, decode_choices=False)
        for name, value in values.items():
            _check_value(_signal(message, name, dbc_file), value, float(read[name]), dbc_file)


def _signal(message: Any, name: str, dbc_file: str) -> Any:
    for signal in message.signals:
        if signal.name == name:
            return signal
    raise InputError(dbc_file, message.name, f"has no signal {name}", "a rig is led by it: add it")


def _check_value(signal: Any, wanted: float, said: float, dbc_file: str) -> None:
    step = 1e-6 * abs(wanted) if signal.is_float else abs(float(signal.scale))
    if not abs(said - wanted) <= 0.501 * step:
        unit = f" {signal.unit}" if signal.unit else ""
        raise InputError(
            dbc_file, signal.name, f"{wanted:g}{unit} would be sent as {said:g}{unit}",
            "ask for less, or mend its range, width, sign or offset in the database",
        )  # fmt: skip
