"""What a newcomer diagnoses first: the log of the demo, our own frames among the rig's."""

from pathlib import Path

import numpy as np
import pytest

from eps_hil.diagnosis.diagnose import diagnose
from eps_hil.physics.chain_parameters import load_chain
from eps_hil.physics.model import Model, load_model
from eps_hil.rig.manoeuvre import load_manoeuvre
from eps_hil.rig.offline import simulate_recording
from eps_hil.series import Series

CONFIGS = Path(__file__).parents[2] / "configs"
pytestmark = pytest.mark.slow


_CHAIN = load_chain(CONFIGS / "reference_chain.yaml")
_MODEL = load_model(CONFIGS / "reference_rig.yaml")
JOINTS_NM_PER_RAD = 1.0 / (
    _MODEL.belt_ratio**2 / _CHAIN.belt_stiffness_nm_per_rad
    + _MODEL.rack_to_rotor_ratio_rad_per_m**2 / _CHAIN.ball_gear_stiffness_n_per_m
)
"""Belt and ball gear of the demo's rig, one behind the other, at the rotor: 9.05."""


@pytest.fixture(scope="module")
def demo(reference_model: Model) -> dict[str, Series]:
    """Five masses, the demo's manoeuvre, what the rig's sensors report."""
    made = simulate_recording(reference_model, _CHAIN, load_manoeuvre("demo"))
    columns = {name: values[:24_000] for name, values in made.columns.items()}
    t_ns = np.round(columns.pop("time_s") * 1e9).astype(np.int64)
    return {name: Series(t_ns, values) for name, values in columns.items()}


def test_what_the_service_published_changes_nothing(
    demo: dict[str, Series], reference_model: Model
) -> None:
    """Its frames began a minute before the rig's, once a second, and say "not available"."""
    motor = demo["motor_torque_nm"].t_ns
    t_ns = np.concatenate([motor[0] - np.arange(60, 0, -1) * 1_000_000_000, motor])
    value = np.concatenate([np.full(60, np.nan), np.sin(motor * 1e-9)])
    ours = {"rack_force_estimate_n": Series(t_ns, value), "friction_torque_nm": Series(t_ns, value)}
    alone = diagnose(reference_model, {"bus.log": demo}, {}).content
    beside = diagnose(reference_model, {"bus.log": {**demo, **ours}}, {}).content
    assert beside == alone
    named = [finding["effect"] for finding in beside["findings"]]
    assert "dropped_frames" not in named
    assert named[0] == "belt_compliance"  # which the plant of five masses has, and the model not
    stiffness = beside["findings"][0]["parameters"]["stiffness_nm_per_rad"]
    low, high = stiffness["ci95"]
    assert low < JOINTS_NM_PER_RAD < high
    # its road wheels on the tie rods are one mass more than two with a joint
    assert named[1:] in ([], ["unknown"])
    assert any("road wheels" in one for one in beside["limits"]) == ("unknown" in named)
