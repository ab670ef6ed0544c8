"""A rig whose friction is a smooth function of speed, against a model that has presliding."""

from collections.abc import Callable
from dataclasses import replace
from types import ModuleType
from typing import Any

import pytest

from eps_hil.diagnosis.accept.proof_of_fit import more_than_noise
from eps_hil.diagnosis.diagnose import diagnose
from eps_hil.physics.model import Model

pytestmark = pytest.mark.slow


def asked(
    record: Callable[..., Any],
    model: Model,
    plant: dict[int, float],
    fitted: tuple[str, ...],
    kept: tuple[str, ...],
) -> dict[str, Any]:
    return diagnose(model, record(plant, fitted), record(plant, kept, seed=2)).content


@pytest.mark.parametrize(
    ("speed_rad_s", "better"),
    [
        (0.2, 0.6),  # σ0 may be anything large, so that its interval reaches the model's
        (0.5, 0.95),  # and rises together with σ1, beside which it is not clear
    ],
)
def test_presliding_that_only_the_model_has_is_found(
    record: Callable[..., Any],
    reference_model: Model,
    other_rig: ModuleType,
    speed_rad_s: float,
    better: float,
) -> None:
    plant = {other_rig.SMOOTH: speed_rad_s}
    content = asked(record, reference_model, plant, ("sweep", "weave", "slow"), ("weave", "slow"))
    (finding,) = content["findings"]
    assert finding["effect"] == "presliding_hysteresis"
    assert "% of the way that the model takes" in finding["summary"]
    stiffness = finding["parameters"]["sigma0_nm_per_rad"]
    assert stiffness["ci95"][0] > reference_model.friction.sigma0_nm_per_rad
    before, after = (content["fit"]["holdout"][name] for name in ("baseline", "augmented"))
    assert after["rack_force_rmse_n"] < better * before["rack_force_rmse_n"]


def test_presliding_that_nothing_explains_is_said(
    record: Callable[..., Any], reference_model: Model, other_rig: ModuleType
) -> None:
    """Slow motion alone: other numbers bend to it, and none is confirmed on the hold-outs."""
    for speed_rad_s, said in ((0.35, True), (0.0, False)):
        plant = {other_rig.SMOOTH: speed_rad_s}
        programme = ("slow", "steps")
        content = asked(record, reference_model, plant, (*programme, "slow"), programme)
        assert content["findings"] == []
        assert any("while the rotor turns round" in one for one in content["limits"]) is said


def test_a_bristle_far_softer_than_the_model_s_is_found(
    record: Callable[..., Any], reference_model: Model
) -> None:
    """Six times: a straight line in σ0 goes past zero, and a fit from there ends elsewhere."""
    true = reference_model.friction
    stiff = replace(
        reference_model, friction=replace(true, sigma0_nm_per_rad=6.0 * true.sigma0_nm_per_rad)
    )
    content = asked(record, stiff, {}, ("sweep", "weave", "slow"), ("weave", "slow"))
    (finding,) = content["findings"]
    assert finding["effect"] == "presliding_hysteresis"
    value = finding["parameters"]["sigma0_nm_per_rad"]["value"]
    assert value == pytest.approx(true.sigma0_nm_per_rad, rel=0.15)


def test_what_slip_elements_leave_is_not_called_noise(
    record: Callable[..., Any], reference_model: Model, other_rig: ModuleType
) -> None:
    """Sliding leaves hardly more than noise, and reversals several times as much."""
    plant = {other_rig.SLIP: 1.0}
    content = asked(record, reference_model, plant, ("sweep", "weave", "slow"), ("weave", "slow"))
    assert content["verdict"] in ("no_mismatch", "explained")
    assert more_than_noise(content["limits"])
