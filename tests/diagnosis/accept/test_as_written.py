"""Figures after are said to be of recordings put right, where no model file puts them so."""

from collections.abc import Callable
from typing import Any

from eps_hil.diagnosis.accept.as_written import in_no_file
from eps_hil.diagnosis.accept.proof_of_fit import Holdout, torque_nrmse
from eps_hil.diagnosis.data.prepare import prepare
from eps_hil.physics.model import Model
from eps_hil.series import Series


def holdouts(record: Callable[..., Any], gain: float) -> list[Holdout]:
    """Of a rig whose load cell reads ``gain`` times what it should."""
    ((name, series),) = record({}, ("weave",), seconds=6.0).items()
    force = series["rack_force_n"]
    series = {**series, "rack_force_n": Series(force.t_ns, gain * force.value)}
    return [Holdout(prepare(name, series), series)]


def test_what_the_file_leaves_of_the_recordings_as_read_is_said(
    record: Callable[..., Any], reference_model: Model
) -> None:
    model = reference_model
    right, read = holdouts(record, 1.0), holdouts(record, 1.1)
    after = torque_nrmse(right, model, model)
    (said,) = in_no_file({"augmented": {"torque_nrmse": after}}, read, model, model)
    assert f"leaves torque_nrmse {torque_nrmse(read, model, model):.3g}, not {after:.3g}" in said
    assert torque_nrmse(read, model, model) > 2.0 * after


def test_nothing_is_said_where_the_file_reaches_what_is_reported(
    record: Callable[..., Any], reference_model: Model
) -> None:
    right = holdouts(record, 1.0)
    after = torque_nrmse(right, reference_model, reference_model)
    assert (
        in_no_file({"augmented": {"torque_nrmse": after}}, right, reference_model, reference_model)
        == []
    )
