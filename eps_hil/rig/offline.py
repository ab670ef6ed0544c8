"""A recording of the simulated rig without a bus: for tests, figures and identification."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from eps_hil.physics.chain_parameters import ChainParameters
from eps_hil.physics.model import Model
from eps_hil.rig.manoeuvre import Manoeuvre
from eps_hil.rig.plant import TRUE_SIGNALS, Plant
from eps_hil.rig.sensors import REPORTED, Sensors, SensorSettings

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class SimulatedRecording:
    """``columns`` as a rig reports them, ``truth`` as it was; all at 1 kHz, shape (n,).

    Row k of ``columns`` was reported at ``time_s[k]`` and speaks of the model file's delay
    earlier; row k of ``truth`` is the physical value at ``time_s[k]``.
    """

    columns: Mapping[str, Floats]
    truth: Mapping[str, Floats]


def simulate_recording(
    model: Model,
    parameters: ChainParameters,
    manoeuvre: Manoeuvre,
    *,
    order: int = 5,
    sensors: SensorSettings | None = None,
    seed: int = 0,
    resolution: Mapping[str, tuple[float, float]] | None = None,
) -> SimulatedRecording:
    """Run one manoeuvre from rest through a chain of ``order`` masses and its sensors.

    ``resolution`` quantises as a DBC would (``eps_hil.rig.frames.resolutions``); the same
    arguments give the same recording bit for bit.
    """
    truth = Plant(model, parameters, order, manoeuvre.table()).run()
    choice = sensors or SensorSettings()
    reported = Sensors(model, choice, seed, resolution).run(truth)
    time_s = np.arange(truth.shape[0]) / 1000.0
    return SimulatedRecording(
        columns={"time_s": time_s} | dict(zip(REPORTED, reported.T.copy(), strict=True)),
        truth={"time_s": time_s} | dict(zip(TRUE_SIGNALS, truth.T.copy(), strict=True)),
    )
