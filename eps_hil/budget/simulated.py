"""A rig without sensor errors for the budget: the manoeuvre's truth, late by the model's delays."""

from collections.abc import Mapping

from eps_hil.budget.budget import World
from eps_hil.budget.sources import SIGNALS, Samples
from eps_hil.estimation.settings import EstimatorSettings
from eps_hil.physics.chain_parameters import ChainParameters
from eps_hil.physics.model import Model
from eps_hil.rig.manoeuvre import Manoeuvre
from eps_hil.rig.offline import simulate_recording
from eps_hil.rig.sensors import SensorSettings


def simulated_world(
    model: Model,
    settings: EstimatorSettings,
    chain: ChainParameters,
    manoeuvre: Manoeuvre,
    *,
    order: int = 5,
    angle: bool = True,
    periods_s: Mapping[str, float] | None = None,
) -> World:
    """Run ``manoeuvre`` once on a rig that obeys ``model`` to the letter, without noise or steps.

    ``angle``: whether the rotor angle is recorded beside the speed.
    """
    made = simulate_recording(
        model, chain, manoeuvre, order=order, sensors=SensorSettings(noise=False, quantise=False)
    )
    names = [n for n in SIGNALS if angle or n != "motor_angle_rad"]
    return World(
        model,
        settings,
        Samples(made.columns["time_s"], {name: made.columns[name] for name in names}),
        made.truth["rack_force_n"],
        made.truth["motor_speed_rad_s"],
        dict(periods_s or {}),
    )
