"""The effect that holds what was found in recordings: simulator, balance and estimator alike."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eps_hil.errors import InputError
from eps_hil.estimation import batch
from eps_hil.estimation.rack_force import RackForceEstimator
from eps_hil.estimation.setup import Inputs
from eps_hil.estimation.validity import Reason
from eps_hil.physics.balance import Motion, residual_nm
from eps_hil.physics.effects.catalogue import values_of
from eps_hil.physics.effects.effect import STATES, Instant
from eps_hil.physics.effects.empirical import EFFECT, remember, term
from eps_hil.physics.empirical_entry import numbers, read
from eps_hil.physics.model import Model, dump_model, load_model
from eps_hil.physics.simulate import simulate
from eps_hil.series import Series

TIME = np.asarray(np.arange(3000) * 1e-3, dtype=np.float64)
TORQUE = np.asarray(1.5 * np.sin(2 * np.pi * 0.7 * TIME), dtype=np.float64)
LOAD = np.asarray(800.0 * np.sin(2 * np.pi * 0.7 * TIME - 0.3), dtype=np.float64)

FOLD_BACK = {
    "effect": "empirical", "form": "dynamic", "where": "motor", "how": "factor",
    "inputs": ["motor_torque_nm"], "memory": ["heat"], "shapes": ["linear"],
    "size": -0.3, "memory_1": 0.5, "range": {"motor_torque_nm": [-2.0, 2.0]},
}  # fmt: skip
YOKE = {
    "effect": "empirical", "form": "law", "where": "friction", "inputs": ["abs_motor_torque_nm"],
    "shapes": ["linear"], "size": 0.05,
}  # fmt: skip
DRAG = {
    "effect": "empirical", "form": "map", "where": "rotor",
    "inputs": ["motor_speed_rad_s", "rack_position_m"],
    "knots": [[-50.0, 0.0, 50.0], [-0.02, 0.02]],
    "values": [[-0.05, -0.01], [0.0, 0.0], [0.05, 0.01]],
}  # fmt: skip
BUSHING = {
    "effect": "empirical", "form": "dynamic", "where": "rotor", "inputs": ["motor_angle_rad"],
    "memory": ["hysteresis"], "memory_1": 2.0, "shapes": ["linear"], "size": 0.04,
}  # fmt: skip
SCREW = {
    "effect": "empirical", "form": "law", "where": "load", "how": "factor",
    "inputs": ["motor_angle_rad"], "shapes": ["linear"], "size": 0.006,
}  # fmt: skip
ENTRIES = [FOLD_BACK, YOKE, DRAG, BUSHING, SCREW]


def having(model: Model, *entries: dict[str, Any]) -> Model:
    return replace(model, effects=(*model.effects, *entries))


def moved(model: Model) -> Motion:
    """The motion of a model under the torques above, as a balance is given it."""
    run = simulate(model, TIME, TORQUE, np.zeros(len(TIME)), LOAD)
    travel = np.diff(run.angle_rad, prepend=run.angle_rad[0])
    return Motion(
        TIME, TORQUE, np.zeros(len(TIME)), LOAD.copy(),
        run.angle_rad / model.rack_to_rotor_ratio_rad_per_m, run.speed_rad_s, run.angle_rad,
        travel, np.abs(travel), np.gradient(run.speed_rad_s, 1e-3),
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("entry", ENTRIES, ids=["fold_back", "yoke", "drag", "bushing", "screw"])
def test_the_balance_of_what_was_simulated_with_it_is_even(
    entry: dict[str, Any], reference_model: Model
) -> None:
    with_it = having(reference_model, entry)
    motion = moved(with_it)
    away = slice(300, -10)  # the bristle forgets its start, differences have one side at the end
    sliding = np.abs(motion.speed_rad_s[away]) > 3.0
    right = residual_nm(with_it, motion)[0][away][sliding]
    wrong = residual_nm(reference_model, motion)[0][away][sliding]
    assert np.sqrt(np.mean(right**2)) < 0.1 * np.sqrt(np.mean(wrong**2))


@pytest.mark.parametrize("entry", ENTRIES, ids=["fold_back", "yoke", "drag", "bushing", "screw"])
def test_a_model_file_holds_it(
    entry: dict[str, Any], reference_model: Model, tmp_path: Path
) -> None:
    file = tmp_path / "model.yaml"
    file.write_text(dump_model(having(reference_model, entry)), encoding="utf-8")
    again = load_model(file)
    assert values_of(again.effects[-1], again) == values_of(entry, reference_model)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"where": "gearbox"}, "empirical.where is 'gearbox', expected one of rotor"),
        ({"inputs": ["motor_torque"]}, "did you mean 'motor_torque_nm'"),
        ({"size": float("nan")}, "empirical.size is nan, a finite number was expected"),
        ({"memory_1": 0.0}, "empirical.memory_1 is 0.0, expected more than zero"),
        ({"shapes": []}, "empirical needs shapes"),
        ({"width_1": 1.0}, "empirical has no 'width_1'"),
        ({"range": {"motor_torque_nm": [2, -2]}}, "expected [lower, higher]"),
        ({"range": {"rack_force_n": [-2, 2]}}, "is none of its inputs"),
    ],
)
def test_what_is_wrong_with_an_entry_is_said(change: dict[str, Any], said: str) -> None:
    with pytest.raises(ValueError, match="empirical") as error:
        read({**FOLD_BACK, **change})
    assert said in str(error.value)


def test_a_table_has_to_fit_its_knots() -> None:
    with pytest.raises(ValueError, match="do not fit"):
        read({**DRAG, "values": [[0.0, 0.1]]})
    with pytest.raises(ValueError, match="rising"):
        read({**DRAG, "knots": [[0.0, -50.0, 50.0], [-0.02, 0.02]]})


def test_the_file_and_the_entry_are_named(reference_model: Model, tmp_path: Path) -> None:
    file = tmp_path / "model.yaml"
    wrong = having(reference_model, {**YOKE, "form": "guess"})
    file.write_text(dump_model(wrong), encoding="utf-8")
    with pytest.raises(InputError, match=r"model.effects\[0\].*empirical.form is 'guess'"):
        load_model(file)


def at(speed: float = 0.0, torque: float = 0.0, angle: float = 0.0, time_s: float = 0.0) -> Instant:
    return Instant(time_s, speed, angle, angle / 2513.0, 0.0, 0.0, torque, 0.0, 2513.0)


def packed(entry: dict[str, Any]) -> np.ndarray[Any, np.dtype[np.float64]]:
    row = np.zeros(160)
    given = numbers(read(entry))
    row[: len(given)] = given
    return row


def test_beyond_its_range_it_fades_to_nothing() -> None:
    law = {**YOKE, "range": {"abs_motor_torque_nm": [0.0, 1.0]}}
    got = [term(packed(law), np.zeros(STATES), at(torque=t)) for t in (0.5, 1.0, 1.1, 1.3)]
    assert got == pytest.approx([0.025, 0.05, 0.05 * 1.1 * 0.5, 0.0])


def test_heat_relaxes_to_the_mean_square() -> None:
    row, state = packed(FOLD_BACK), np.zeros(STATES)
    for _ in range(500):
        remember(row, state, at(torque=1.2), 1e-3)
    assert state[0] == pytest.approx(1.44 * (1 - np.exp(-1.0)), rel=1e-9)


def test_hysteresis_forgets_over_its_way() -> None:
    row, state = packed(BUSHING), np.zeros(STATES)
    for k in range(2001):
        remember(row, state, at(angle=0.001 * k), 1e-3)
    assert state[0] == pytest.approx(1 - np.exp(-1.0), rel=1e-3)
    remember(row, state, at(angle=-6.0), 1e-3)
    assert state[0] < -0.9


def test_time_since_a_reversal_starts_anew() -> None:
    law = {**YOKE, "inputs": ["since_reversal_s"]}
    row, state = packed(law), np.zeros(STATES)
    for _ in range(100):
        remember(row, state, at(speed=1.0), 1e-3)
    assert term(row, state, at()) == pytest.approx(0.05 * 0.099)
    remember(row, state, at(speed=-1.0), 1e-3)
    assert term(row, state, at()) == 0.0


def recording(model: Model) -> dict[str, Series]:
    run = simulate(model, TIME, TORQUE, np.zeros(len(TIME)), LOAD)
    t_ns = np.round(TIME * 1e9).astype(np.int64)
    return {
        "motor_torque_nm": Series(t_ns, TORQUE),
        "motor_speed_rad_s": Series(t_ns, run.speed_rad_s),
        "motor_angle_rad": Series(t_ns, run.angle_rad),
    }


@pytest.mark.parametrize("entry", ENTRIES, ids=["fold_back", "yoke", "drag", "bushing", "screw"])
def test_the_estimator_takes_it_out(entry: dict[str, Any], reference_model: Model) -> None:
    plain = replace(reference_model, delays_s=type(reference_model.delays_s)())
    with_it = having(plain, entry)
    series = recording(with_it)

    def error(model: Model) -> float:
        found = batch.estimate(series, model)
        good = found.valid & (found.t_ns > 500_000_000)
        true = np.interp(found.t_ns[good] * 1e-9, TIME, LOAD)
        return float(np.sqrt(np.mean((found.rack_force_n[good] - true) ** 2)))

    assert error(with_it) < 0.5 * error(plain)


def test_an_estimate_beyond_the_range_is_not_valid(reference_model: Model) -> None:
    law = {**YOKE, "range": {"abs_motor_torque_nm": [0.0, 1.0]}}
    estimator = RackForceEstimator(having(reference_model, law))
    inside = [estimator.step(Inputs(0.9, 0.0, 5.0)).reason for _ in range(1000)][-1]
    beyond = estimator.step(Inputs(1.5, 0.0, 5.0)).reason
    assert (inside, beyond) == (Reason.FINE, Reason.OUT_OF_RANGE)


def test_every_place_is_a_slot_of_the_simulator() -> None:
    assert EFFECT.slot_of is not None
    assert {
        EFFECT.slot_of({"where": one}) for one in ("rotor", "friction", "motor", "load")
    } <= set(EFFECT.slots)
