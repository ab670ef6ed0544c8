"""A belt that gives: the oscillator behind it, and the torque balance that is right again."""

from typing import Any

import numpy as np
import pytest

from eps_hil.diagnosis.balance.problem import Problem
from eps_hil.diagnosis.data.prepare import Prepared, prepare
from eps_hil.diagnosis.direct.belt import Belt, belt_of, noise_nm2, slack_rad_s2, with_belt
from eps_hil.physics.model import Model
from eps_hil.proof import manoeuvres, sensors
from eps_hil.proof.world import World
from eps_hil.series import Series

STIFFNESS, SHARE = 8.0, 0.4


def series(columns: dict[str, Any]) -> dict[str, Series]:
    n = len(next(iter(columns.values())))
    t_ns = np.arange(n, dtype=np.int64) * 1_000_000
    return {name: Series(t_ns, np.asarray(value)) for name, value in columns.items()}


@pytest.mark.parametrize("hertz", [5.0, 20.0, 35.0])
@pytest.mark.parametrize("damping", [2e-3, 2e-2])
def test_the_slack_is_the_oscillators(reference_model: Model, hertz: float, damping: float) -> None:
    """Against its transfer function −share s² / (s² + c/J₂ s + k/J₂) of a sine's acceleration."""
    late = reference_model.delays_s.of("motor_speed_rad_s")
    t = np.arange(12_000) * 1e-3
    omega = 2 * np.pi * hertz
    zeros = np.zeros(len(t))
    one = prepare("sine", series({
        "motor_torque_nm": zeros, "torque_sensor_nm": zeros, "rack_force_n": zeros,
        "motor_speed_rad_s": 20.0 * np.sin(omega * (t - late)),
    }))  # fmt: skip
    found = slack_rad_s2(one, reference_model, Belt(STIFFNESS, damping, SHARE))
    behind = SHARE * reference_model.inertia_kg_m2
    s = 1j * omega
    transfer = -SHARE * s**2 / (s**2 + damping / behind * s + STIFFNESS / behind)
    expected = np.imag(transfer * s * 20.0 * np.exp(s * (t - late)))
    settled = slice(6000, 11_000)
    error = np.sqrt(np.mean((found - expected)[settled] ** 2) / np.mean(expected[settled] ** 2))
    assert error < 0.03


def test_a_constant_load_bends_the_belt_and_moves_nothing(reference_model: Model) -> None:
    flat = np.ones(5000)
    one = prepare("rest", series({
        "motor_torque_nm": flat, "torque_sensor_nm": 2.0 * flat, "rack_force_n": 500.0 * flat,
        "motor_speed_rad_s": 0.0 * flat,
    }))  # fmt: skip
    assert np.max(np.abs(slack_rad_s2(one, reference_model, Belt(2.0, 5e-3)))) < 1e-6


def test_without_a_load_nothing_is_known_of_the_belt(reference_model: Model) -> None:
    flat = np.ones(5000)
    one = prepare("x", series({"motor_torque_nm": flat, "motor_speed_rad_s": flat}))
    assert with_belt(one, reference_model, Belt(2.0, 5e-3)) is one


@pytest.mark.parametrize("damping", [1e-3, 5e-3])
def test_the_noise_that_a_belt_passes_is_known(reference_model: Model, damping: float) -> None:
    """A lightly damped one passes several times as much: no reason to take it for a damped one."""
    rng = np.random.default_rng(3)
    n, slow = 60_000, np.sin(np.arange(60_000) * 2e-3)
    one = prepare("noise", series({
        "motor_torque_nm": 0.1 * slow, "torque_sensor_nm": 1e-2 * rng.standard_normal(n),
        "rack_force_n": 200.0 * slow + 4.0 * rng.standard_normal(n),
        "motor_speed_rad_s": 20.0 + slow + 0.2 * rng.standard_normal(n),
    }))  # fmt: skip
    quiet = prepare("quiet", {
        name: Series(np.arange(n, dtype=np.int64) * 1_000_000, values)
        for name, values in {
            "motor_torque_nm": 0.1 * slow, "torque_sensor_nm": 0.0 * slow,
            "rack_force_n": 200.0 * slow, "motor_speed_rad_s": 20.0 + slow,
        }.items()
    })  # fmt: skip
    belt = Belt(5.0, damping)

    def balance(given: Prepared) -> Any:
        return with_belt(given, reference_model, belt).residual(reference_model)[0]

    expected = noise_nm2(one, reference_model, belt)
    assert np.var(balance(one) - balance(quiet)) == pytest.approx(expected, rel=0.1)
    assert expected > (1.7 if damping == 1e-3 else 1.1) * sum(one.noise_parts_nm2(reference_model))


def test_a_damping_is_told_with_its_interval_or_said_not_to_show() -> None:
    seen = {"effect": "belt_compliance", "summary": "It gives.", "parameters": {"k": {}}}
    known = Belt(5.0, 2e-3, damping_ci95=(1e-3, 4e-3)).told(seen)
    assert known["parameters"]["damping_nm_s_per_rad"]["ci95"] == [1e-3, 4e-3]
    assert known["summary"] == "It gives."
    open_ = Belt(5.0, 7.3e-3).told(seen)
    assert list(open_["parameters"]) == ["k"]
    assert "do not determine its damping: 0.0073 Nm s/rad" in open_["summary"]


def recorded(**joint: Any) -> list[Prepared]:
    """A truth plant of other code, in two pieces."""
    rng = np.random.default_rng(4)
    world = World(simple=True, **joint)
    made = []
    for name, program in zip(("a", "b"), manoeuvres.training(rng), strict=True):
        clean = sensors.reported(world.run(program), world.instruments)
        columns = sensors.measured(clean, world.instruments, rng)
        del columns["time_s"]
        made.append(prepare(name, series(columns)))
    return made


@pytest.mark.slow
def test_the_balance_of_a_soft_belt_is_as_good_as_the_sensors(reference_model: Model) -> None:
    """It resonates with what is behind it at 28 Hz, in the middle of what the balance sees."""
    made = recorded(belt_nm_per_rad=2.0, belt_damping=6e-3)
    belt = belt_of(made, reference_model, 2.0)
    assert belt is not None
    assert belt.damping_ci95 is not None
    assert belt.damping_ci95[0] < 6e-3 < belt.damping_ci95[1] < 9e-3
    assert belt.damping_nm_s_per_rad == pytest.approx(6e-3, rel=0.15)
    assert belt.share == pytest.approx(0.33, abs=0.03)
    before = Problem(made, reference_model)
    after = Problem([with_belt(one, reference_model, belt) for one in made], reference_model)

    def energy(problem: Problem) -> float:
        return float(np.mean(problem.residual(reference_model)[problem.sliding] ** 2))

    assert energy(before) > 2.0
    assert energy(after) < 1.1


@pytest.mark.slow
def test_a_stiff_belt_is_left_alone(reference_model: Model) -> None:
    assert belt_of(recorded(belt_nm_per_rad=50.0, belt_damping=6e-3), reference_model, 50.0) is None
