"""Figures after are those of the model file on recordings as they were read."""

from collections.abc import Callable
from typing import Any

from eps_hil.diagnosis.accept.as_written import as_the_file_does, in_no_file
from eps_hil.diagnosis.accept.proof_of_fit import Holdout, measures
from eps_hil.diagnosis.data.prepare import prepare
from eps_hil.physics.model import Model
from eps_hil.series import Series


def holdouts(record: Callable[..., Any], gain: float) -> list[Holdout]:
    """Of a rig whose load cell reads ``gain`` times what it should."""
    ((name, series),) = record({}, ("weave",), seconds=6.0).items()
    force = series["rack_force_n"]
    series = {**series, "rack_force_n": Series(force.t_ns, gain * force.value)}
    return [Holdout(prepare(name, series), series)]


def test_what_the_file_leaves_of_the_recordings_as_read_is_what_is_told(
    record: Callable[..., Any], reference_model: Model
) -> None:
    model = reference_model
    right, read = holdouts(record, 1.0), holdouts(record, 1.1)
    told = {"augmented": measures(right, model, model), "noise_floor": {"torque_nrmse": 0.01}}
    figures = as_the_file_does(told, read, model, model, balance=True)
    assert figures["augmented"] == figures["baseline"] == measures(read, model, model)
    assert figures["put_right"] == told["augmented"]
    left = figures["augmented"]["torque_nrmse"]
    assert left > 2.0 * figures["put_right"]["torque_nrmse"]
    (said,) = in_no_file(figures)
    assert f"leaves torque_nrmse {left:.3g}" in said
    assert f"leaves {figures['put_right']['torque_nrmse']:.3g}" in said


def test_nothing_is_said_where_the_file_reaches_that(
    record: Callable[..., Any], reference_model: Model
) -> None:
    right, model = holdouts(record, 1.0), reference_model
    told = {"augmented": measures(right, model, model), "noise_floor": {"torque_nrmse": 0.01}}
    assert in_no_file(as_the_file_does(told, right, model, model, balance=True)) == []
    joint = as_the_file_does(told, right, model, model, balance=False)
    assert in_no_file(joint) == []
    assert "put_right" not in joint
