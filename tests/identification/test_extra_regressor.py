"""What is asked beside the fit: is a torque's scale off, is the motor's delay a lag?"""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from eps_hil.identification.identify import identify
from eps_hil.physics.model import Model
from eps_hil.proof import manoeuvres, sensors
from eps_hil.proof.truth import Drive, Floats
from eps_hil.proof.world import Instruments, World
from eps_hil.series import Series

pytestmark = pytest.mark.slow

Recordings = dict[str, dict[str, Series]]


def recorded(program: Floats, drive: Drive, seed: int = 4) -> dict[str, Series]:
    """A rig of the model's form in ``program``, with noise, delays as in the model file."""
    rng = np.random.default_rng(seed)
    truth = World(simple=True, drive=drive).run(program)
    columns = sensors.measured(sensors.reported(truth, Instruments()), Instruments(), rng)
    t_ns = np.round(columns["time_s"] * 1e9).astype(np.int64)
    return {key: Series(t_ns, value) for key, value in columns.items() if key != "time_s"}


def programme_pass(preloads: list[float]) -> Floats:
    """Constant speeds both ways; the motor carries exactly the preload, the driver the rest."""
    parts = []
    for preload in preloads:
        seconds = 6.0
        t = np.arange(round(seconds * 1000)) * 1e-3
        speed = manoeuvres.smoothed(np.where(t < 0.5 * seconds, 1.0, -1.0), 0.12)
        wheel = np.cumsum(manoeuvres.faded(speed)) * 1e-3
        load = manoeuvres.faded(np.full(len(t), preload), 0.6)
        parts.append(
            manoeuvres.segment(
                seconds,
                force_n=load,
                feed_nm=load / Drive().rack_rad_per_m,
                wheel_target_rad=wheel,
                wheel_nm_per_rad=400.0,
                wheel_nm_s_per_rad=12.0,
            )
        )
    return np.concatenate(parts)


def scale_findings(recordings: Recordings, model: Model) -> list[str]:
    return [one.signal for one in identify(recordings, model).findings if one.kind == "scale"]


def test_a_motor_that_carries_the_preload_is_not_said_to_have_a_wrong_scale(
    reference_model: Model, true: Any
) -> None:
    """Its torque is the rack force but for noise, and noise alone would set its scale."""
    one = recorded(programme_pass([0.0, 1000.0, 2000.0, 3000.0] * 4), true)
    found = identify({"programme": one}, reference_model)
    assert [finding for finding in found.findings if finding.kind == "scale"] == []
    alike = " ".join(unknown.what for unknown in found.cannot_tell)
    assert "scale of the motor torque and kr+ minus kr-" in alike


def test_a_wrong_scale_of_the_motor_is_named(
    record: Callable[..., Recordings], reference_model: Model
) -> None:
    one = record({"constant_speed": 40.0})
    assert scale_findings(one, reference_model) == []
    torque = one["constant_speed"]["motor_torque_nm"]
    one["constant_speed"]["motor_torque_nm"] = Series(torque.t_ns, torque.value / 1.1)
    assert "motor_torque_nm" in scale_findings(one, reference_model)


@pytest.mark.parametrize("lag_s", [0.0, 0.003])
def test_a_lag_is_told_from_a_dead_time_where_it_shows(
    record: Callable[..., Recordings], reference_model: Model, true: Any, lag_s: float
) -> None:
    """The shaft's torque follows the reported one, T + τ dT/dt, through a lag of τ.

    What the lag takes off a fast torque is no inertia: 1 % of it here.
    """
    recordings = record({"multisine": 30.0, "constant_speed": 20.0})
    for series in recordings.values():
        torque = series["motor_torque_nm"]
        smooth = manoeuvres.smoothed(torque.value, 0.011)
        earlier = torque.value + lag_s * np.gradient(smooth, 1e-3)
        series["motor_torque_nm"] = Series(torque.t_ns, earlier)
    found = identify(recordings, reference_model)
    alike = [unknown.what for unknown in found.cannot_tell]
    inertia = found.parameters["inertia_kg_m2"]
    assert inertia.ci95 is not None
    assert inertia.ci95[0] < true.inertia_kg_m2 < inertia.ci95[1]
    assert inertia.value == pytest.approx(true.inertia_kg_m2, rel=2e-3)
    skew = found.skews_s["motor_speed_minus_motor_torque"].value
    assert skew == pytest.approx(0.0045 + lag_s, abs=0.2e-3)
    if lag_s == 0.0:
        assert found.motor_lag is None
        assert any("dead time and lag" in what for what in alike)
    else:
        assert found.motor_lag is not None
        assert found.motor_lag.ci95 is not None
        assert found.motor_lag.ci95[0] <= 1.05 * lag_s
        assert found.motor_lag.value == pytest.approx(lag_s, rel=0.1)
        assert not any("dead time and lag" in what for what in alike)


@pytest.mark.parametrize("held", [1, 4])
def test_what_happens_between_two_commands_is_not_called_a_lag(
    record: Callable[..., Recordings], reference_model: Model, held: int
) -> None:
    """A dead time, and commands held for some ms: a lag of h/√12, as far as any torque shows."""
    recordings = record({"multisine": 60.0, "constant_speed": 20.0})
    for series in recordings.values():
        torque = series["motor_torque_nm"]
        smooth = manoeuvres.smoothed(torque.value, 0.011)
        bend = np.gradient(np.gradient(smooth, 1e-3), 1e-3)
        squared = max((held * 1e-3) ** 2, 4e-6) / 12.0
        value = (torque.value - 0.5 * squared * bend)[::held].repeat(held)[: len(torque.value)]
        series["motor_torque_nm"] = Series(torque.t_ns, value)
    found = identify(recordings, reference_model)
    assert found.motor_lag is None
    assert any("dead time and lag" in unknown.what for unknown in found.cannot_tell)
