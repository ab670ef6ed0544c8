"""What a sensor's constant error is drawn from: what it reads with nothing on it."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from eps_hil.diagnosis.direct.zero_reading import SENSORS, held_nm, motor_gain, windows_nm
from eps_hil.diagnosis.given_load import Diagnosis
from eps_hil.report.plots import Line, Plot

_WITH = {"torque_sensor_nm": "the hands off", "motor_torque_nm": "the motor off"}


def figure(diagnosis: Diagnosis, finding: Mapping[str, Any]) -> Plot | None:
    """Every window of all recordings, fitted and kept, and what the written model reads there.

    None where no window is left.
    """
    (signal,) = (one for one, effect in SENSORS.items() if effect == finding["effect"])
    recordings = [*diagnosis.problem.recordings, *(one.prepared for one in diagnosis.judged)]
    with_signal = [one for one in recordings if signal in one.raw]
    model = diagnosis.problem.model
    values = [value for one in with_signal for value in windows_nm(one, signal, model)]
    if not values:
        return None
    low, high = finding["parameters"]["offset_nm"]["ci95"]
    half = 0.5 * (high - low)
    if signal == "motor_torque_nm":
        half /= motor_gain(diagnosis.model)
    read = np.full(len(values), held_nm(signal, diagnosis.model))
    lines = [
        Line("95 % interval", "edge", 1e3 * (read - half)),
        Line("", "edge", 1e3 * (read + half), band_below=True),
        Line(f"2 s of motion with {_WITH[signal]}", "dots", 1e3 * np.array(values)),
        Line("this finding", "after", 1e3 * read),
    ]
    number = np.arange(1.0, len(values) + 1.0)
    name = f"zero-{finding['effect']}"
    return Plot(name, "window, in the recordings' order", "reading, mNm", number, lines, height=260)
