"""What a newcomer diagnoses first: the log of the demo, our own frames among the rig's."""

from pathlib import Path

import numpy as np
import pytest

from eps_hil.diagnosis.diagnose import diagnose
from eps_hil.physics.chain_parameters import load_chain
from eps_hil.physics.model import Model
from eps_hil.rig.manoeuvre import load_manoeuvre
from eps_hil.rig.offline import simulate_recording
from eps_hil.series import Series

CONFIGS = Path(__file__).parents[2] / "configs"
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def demo(reference_model: Model) -> dict[str, Series]:
    """Five masses, the demo's manoeuvre, what the rig's sensors report."""
    chain = load_chain(CONFIGS / "reference_chain.yaml")
    made = simulate_recording(reference_model, chain, load_manoeuvre("demo"))
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
