"""Where torque balance and free run disagree, a diagnosis says so."""

import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from eps_hil.diagnosis.accept.free_run import (
    disagreement,
    free_run,
    free_run_noise,
    speed_fit_percent,
    worse_free_run,
)
from eps_hil.diagnosis.accept.proof_of_fit import Holdout
from eps_hil.diagnosis.data.prepare import prepare
from eps_hil.physics.model import Model


def told(balance: float, angle: float | None) -> dict[str, Any]:
    return {"torque_nrmse": balance, "free_run": {"speed_rmse_rad_s": 1.0, "angle_rmse_rad": angle}}


def test_a_free_run_that_ends_further_off_is_said_with_the_reason() -> None:
    (said,) = worse_free_run({"baseline": told(0.3, 8.0), "augmented": told(0.1, 12.0)})
    assert "angle 12 rad off, 8 rad without" in said
    assert "speed" not in said.partition("(")[2].partition(")")[0]
    assert "adds up" in said


def test_nothing_is_said_where_they_agree_or_there_is_none() -> None:
    assert worse_free_run({"baseline": told(0.3, 8.0), "augmented": told(0.1, 8.1)}) == []
    assert worse_free_run({"baseline": told(0.3, None), "augmented": told(0.1, None)}) == []
    assert worse_free_run({"baseline": told(0.3, 8.0), "augmented": told(0.3, 8.0)}) == []


def test_what_the_sensors_noise_makes_of_a_free_run_is_no_disagreement() -> None:
    figures = {"baseline": told(0.3, 8.0), "augmented": told(0.1, 12.0)}
    assert worse_free_run(figures, {"angle_rmse_rad": 1.9}) != []
    assert worse_free_run(figures, {"angle_rmse_rad": 2.1}) == []


@pytest.fixture(scope="module")
def holdout(record: Callable[..., Any]) -> Holdout:
    ((name, series),) = record({}, ("weave",), seconds=12.0).items()
    return Holdout(prepare(name, series), series)


@pytest.fixture(scope="module")
def noise(holdout: Holdout, reference_model: Model) -> dict[str, float]:
    return free_run_noise([holdout], reference_model)


def test_noise_adds_up_in_a_free_run(
    holdout: Holdout, reference_model: Model, noise: dict[str, float]
) -> None:
    assert noise["angle_rmse_rad"] > 0.0
    loud = {name: 3.0 * size for name, size in holdout.prepared.noise.items()}
    louder = replace(holdout, prepared=holdout.prepared.changed(noise=loud))
    assert free_run_noise([louder], reference_model)["angle_rmse_rad"] == pytest.approx(
        3.0 * noise["angle_rmse_rad"], rel=0.2
    )


def test_the_finding_that_a_worse_free_run_comes_with_is_said(
    holdout: Holdout, reference_model: Model
) -> None:
    """A constant beside a ripple: the ripple is nothing in the run, the constant all of it."""
    ripple = {"effect": "cogging_torque", "order": 6.0, "amplitude_nm": 1e-4, "phase_rad": 0.0}
    constant = {"effect": "motor_torque_offset", "offset_nm": 0.05}
    written = replace(reference_model, effects=(ripple, constant))
    before, after = (
        {"torque_nrmse": balance, "free_run": free_run([holdout], one)}
        for balance, one in ((1.0, reference_model), (0.5, written))
    )
    figures = {"baseline": before, "augmented": after}
    (said,) = disagreement(figures, [holdout], reference_model, written)
    assert "comes with motor_torque_offset" in said
    told_nm = re.search(r"is ([\d.]+) mNm with the findings", said)
    assert told_nm
    assert float(told_nm[1]) == pytest.approx(50.0, rel=0.1)
    assert disagreement({**figures, "augmented": before}, [holdout], reference_model, written) == []


def test_a_worse_free_run_within_the_noise_is_told_as_that(
    holdout: Holdout, reference_model: Model, noise: dict[str, float]
) -> None:
    near = noise["angle_rmse_rad"]
    figures = {"baseline": told(0.3, near), "augmented": told(0.1, 2.5 * near)}
    (said,) = disagreement(figures, [holdout], reference_model, reference_model)
    assert "by no more than the sensors' noise makes" in said
    assert f"{noise['speed_rmse_rad_s']:.2g} rad/s, {near:.2g} rad." in said


def fits(balance: float, percent: float | None) -> dict[str, Any]:
    return {**told(balance, 1.0), "speed_fit_percent": percent}


def test_half_seconds_that_fit_worse_are_said() -> None:
    (said,) = worse_free_run({"baseline": fits(0.3, 60.0), "augmented": fits(0.1, 53.0)})
    assert "speed fit 53 %, 60 % without" in said
    assert "break away" in said


@pytest.mark.parametrize(
    ("before", "after", "balance"),
    [(60.0, 58.5, 0.1), (99.7, 99.0, 0.1), (60.0, 53.0, 0.4), (None, 53.0, 0.1), (60.0, None, 0.1)],
)
def test_half_seconds_that_fit_as_well_are_not(
    before: float | None, after: float | None, balance: float
) -> None:
    figures = {"baseline": fits(0.3, before), "augmented": fits(balance, after)}
    assert worse_free_run(figures) == []


def test_where_half_seconds_became_worse_and_by_what_is_said(
    holdout: Holdout, reference_model: Model
) -> None:
    """A level that holds a rotor which the rig lets go, beside a ripple that does nothing."""
    ripple = {"effect": "cogging_torque", "order": 6.0, "amplitude_nm": 1e-4, "phase_rad": 0.0}
    stuck = {"effect": "stribeck", "level_nm": 0.3, "speed_rad_s": 4.0}
    written = replace(reference_model, effects=(ripple, stuck))
    before, after = (
        {**told(balance, 1.0), "speed_fit_percent": speed_fit_percent([holdout], one)}
        for balance, one in ((1.0, reference_model), (0.5, written))
    )
    figures = {"baseline": before, "augmented": after}
    (said,) = disagreement(figures, [holdout], reference_model, written)
    assert "comes to rest or turns round" in said
    assert "comes with stribeck" in said
    assert disagreement({**figures, "augmented": before}, [holdout], reference_model, written) == []
