"""Another name in the place of one that was found."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from eps_hil.diagnosis.attribute.exchange import _in_place_of
from eps_hil.diagnosis.diagnose import diagnose
from eps_hil.physics.effects.catalogue import catalogue
from eps_hil.physics.model import Model
from eps_hil.proof.cases import make
from eps_hil.proof.plans import Plan
from eps_hil.series import Series


def scored(*gains: tuple[str, float]) -> list[Any]:
    return [
        SimpleNamespace(candidate=SimpleNamespace(effect=catalogue()[name]), gain=gain)
        for name, gain in gains
    ]


@pytest.mark.parametrize(
    ("gone", "tried"),
    [
        ("position_torque", ["stribeck", "unmodelled_spring", "end_stop"]),
        ("stribeck", []),
        ("inertia", ["stribeck"]),
    ],
)
def test_what_a_curve_holds_is_tried_whatever_it_seems_to_gain(gone: str, tried: list[str]) -> None:
    of = scored(
        ("position_torque", 120.0), ("stribeck", 100.0), ("unmodelled_spring", 50.0),
        ("end_stop", 25.0), ("end_stop", 20.0),
    )  # fmt: skip
    found = list(_in_place_of(gone, of, 80.0))
    assert [one.candidate.effect.id for one in found] == tried
    assert all(one.gain != 20.0 for one in found)


@pytest.mark.slow
def test_a_stop_that_is_hardly_touched_is_no_curve(reference_model: Model) -> None:
    """A millimetre of it lies between two places that are tried: a curve took its place, which is
    flat beyond, and hold-outs that go farther were 13 times their noise off."""
    effects = ("torque_sensor_offset", "friction_warmup", "end_stop")
    case = make(Plan("triples", 504, tuple((one, 1.5) for one in effects)))
    recordings = {
        name: {
            key: Series(np.round(columns["time_s"] * 1e9).astype(np.int64), values)
            for key, values in columns.items()
            if key != "time_s"
        }
        for name, columns in case.recordings.items()
    }
    kept = {"holdout": recordings.pop("holdout")}
    content = diagnose(reference_model, recordings, kept).content
    assert {one["effect"] for one in content["findings"]} == set(effects)
    holdout = content["fit"]["holdout"]
    floor = holdout["noise_floor"]["torque_nrmse"]
    assert holdout["augmented"]["torque_nrmse"] < 1.1 * floor
