"""What an experiment tells: more where the models differ more, nothing where they are one."""

from pathlib import Path

import numpy as np
import pytest

from eps_hil.diagnosis.balance.problem import Problem
from eps_hil.diagnosis.data.prepare import prepare
from eps_hil.investigate import worth
from eps_hil.investigate.experiment import Experiment, Kind
from eps_hil.investigate.foreseen import foresee
from eps_hil.physics.model import load_model
from eps_hil.programme.limits import Limits

MODEL = load_model(Path(__file__).parents[2] / "configs" / "reference_rig.yaml")
LIMITS = Limits()


def test_the_information_of_an_answer() -> None:
    assert worth.information(0.5, 0.0) == 1.0
    assert worth.information(0.5, 0.5) == 0.0
    assert worth.information(0.1, 0.0) == pytest.approx(worth.entropy(0.1))
    told = [worth.information(0.1, error) for error in (0.4, 0.2, 0.1, 0.01)]
    assert told == sorted(told)


def test_models_that_differ_by_nothing_are_a_coin_toss() -> None:
    assert worth.wrong(0.0, 1.0) == 0.5
    assert worth.wrong(worth.CLEAR, 1.0) == pytest.approx(0.0228, abs=1e-4)  # Φ(−2)
    assert worth.wrong(100.0, 4.0) == pytest.approx(worth.wrong(25.0, 1.0))


@pytest.fixture(scope="module")
def sights() -> dict[str, dict[str, float]]:
    """D² of some effects, each of one size, in three experiments."""
    experiments = {
        "slow": Experiment(Kind.PASSES, 2.0),
        "fast": Experiment(Kind.PASSES, 40.0),
        "loaded": Experiment(Kind.PASSES, 10.0, 2000.0),
    }
    found = {}
    for name, one in experiments.items():
        problem = Problem([prepare(name, foresee(MODEL, one, LIMITS, 1.0).series)], MODEL)
        asked = [
            ("stribeck", {"speed_rad_s": 2.0}),
            ("quadratic_drag", {}),
            ("motor_torque_gain", {}),
            ("end_stop", {"position_m": 0.036}),
        ]
        size = np.array([0.01, 1e-6, 0.01, 1e4])
        told = worth.sight(problem, asked, LIMITS).distance * size**2
        found[name] = {effect: float(d) for (effect, _), d in zip(asked, told, strict=True)}
    return found


def test_each_effect_is_seen_where_it_acts(sights: dict[str, dict[str, float]]) -> None:
    slow, fast, loaded = sights["slow"], sights["fast"], sights["loaded"]
    assert slow["stribeck"] > 10.0 * fast["stribeck"]
    assert fast["quadratic_drag"] > 10.0 * slow["quadratic_drag"]
    assert loaded["motor_torque_gain"] > 1000.0 * (1.0 + fast["motor_torque_gain"])
    assert fast["end_stop"] == slow["end_stop"] == 0.0, "nobody drove there"
