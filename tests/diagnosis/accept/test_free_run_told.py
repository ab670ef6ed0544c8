"""Where torque balance and free run disagree, a diagnosis says so."""

from typing import Any

from eps_hil.diagnosis.accept.free_run import worse_free_run


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
