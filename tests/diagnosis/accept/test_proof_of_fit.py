"""What hold-outs say: nothing where their data are bad.

And what they keep, in a sentence where an all-clear would keep quiet about it.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from eps_hil.diagnosis.accept.proof_of_fit import (
    Holdout,
    beside_a_gap,
    measures,
    noise_floor,
    still_left,
    worse_force,
)
from eps_hil.diagnosis.data.prepare import prepare
from eps_hil.diagnosis.data.quality import look_at
from eps_hil.physics.model import Model
from eps_hil.series import Series


@pytest.mark.parametrize(("after", "said"), [(0.010, False), (0.0129, False), (0.0175, True)])
def test_clearly_more_than_noise_is_said(after: float, said: bool) -> None:
    told = {
        "augmented": {"torque_nrmse": after},
        "noise_floor": {"torque_nrmse": 0.010},
        "baseline": {"torque_nrmse": 0.2},
    }
    sentences = still_left(told)
    assert bool(sentences) is said
    if said:
        assert "1.8 times" in sentences[0]


def test_bad_data_of_a_holdout_count_for_nothing(
    record: Callable[..., Any], reference_model: Model
) -> None:
    (series,) = record({}, ("weave",), seconds=12.0).values()
    whole = Holdout(prepare("r", series), series)
    series = dict(series)
    for name, first in (("rack_force_n", 3000), ("motor_speed_rad_s", 6000)):
        values = series[name].value.copy()
        values[first : first + 1500] = np.nan
        series[name] = Series(series[name].t_ns, values)
    used = Holdout(prepare("r", series), series)
    left_out = Holdout(used.prepared, series, look_at("r", series))
    expected, bridged, told = (
        measures([one], reference_model, reference_model) for one in (whole, used, left_out)
    )
    assert bridged["torque_nrmse"] > 2 * expected["torque_nrmse"]
    assert told["torque_nrmse"] == pytest.approx(expected["torque_nrmse"], rel=0.2)
    assert bridged["rack_force_rmse_n"] > 2 * expected["rack_force_rmse_n"]
    assert told["rack_force_rmse_n"] == pytest.approx(expected["rack_force_rmse_n"], rel=0.3)
    assert bridged["speed_fit_percent"] < expected["speed_fit_percent"] - 5
    assert told["speed_fit_percent"] == pytest.approx(expected["speed_fit_percent"], abs=3)
    floor = noise_floor([left_out], reference_model)["torque_nrmse"]
    assert floor == pytest.approx(noise_floor([whole], reference_model)["torque_nrmse"], rel=0.2)


def test_beside_an_open_gap_the_torque_is_not_judged_and_that_is_said(
    record: Callable[..., Any], reference_model: Model
) -> None:
    """Half of the recording: the balance of the rest is what it was, whatever happens there."""
    (series,) = record({}, ("weave",), seconds=12.0).values()
    whole = prepare("r", series)
    half = np.arange(len(whole.thin_time_s)) > 0.5 * len(whole.thin_time_s)
    torque = whole.raw["motor_torque_nm"].copy()
    torque[int(0.52 * len(torque)) :] += 0.5
    knocked = whole.changed(raw={**whole.raw, "motor_torque_nm": torque})
    told, loose = (
        measures([Holdout(one, series)], reference_model, reference_model)["torque_nrmse"]
        for one in (knocked.changed(barred=half), knocked)
    )
    expected = measures([Holdout(whole, series)], reference_model, reference_model)
    assert told == pytest.approx(expected["torque_nrmse"], rel=0.2)
    assert loose > 10 * told
    assert beside_a_gap([Holdout(whole, series)], reference_model) == []
    (said,) = beside_a_gap([Holdout(knocked.changed(barred=half), series)], reference_model)
    assert 40 <= float(said.split(" %")[0]) <= 60


def test_a_worse_estimate_of_the_rack_force_is_said() -> None:
    before = {"rack_force_rmse_n": 20.0}
    assert worse_force({"baseline": before, "augmented": {"rack_force_rmse_n": 20.2}}) == []
    assert worse_force({"baseline": {}, "augmented": {}}) == []
    (said,) = worse_force({"baseline": before, "augmented": {"rack_force_rmse_n": 24.0}})
    assert "24 N off" in said
    assert "20 N without" in said
