"""What a safety reviewer got to be wrong and called valid, on recordings of the simulated rig."""

import numpy as np
import pytest

from eps_hil.estimation.validity import Reason

from .recorded import recorded

TORQUE, SENSOR, SPEED = "motor_torque_nm", "torque_sensor_nm", "motor_speed_rad_s"


@pytest.mark.parametrize("seed", [0, 3])
def test_a_load_that_friction_alone_holds_is_not_taken_for_none(seed: int) -> None:
    """Hands and motor off at rest: eq. 4a bounds the friction by T_1m, 0, where it was known."""
    rig = recorded("dwell", seed)
    trace = rig.estimate()
    off = np.abs(trace.rack_force_n - rig.load_n(trace))[trace.valid]
    assert np.mean(trace.valid) > 0.95
    assert np.sqrt(np.mean(off**2)) < 25.0
    assert np.mean(off > 100.0) < 0.003


@pytest.mark.parametrize("name", [TORQUE, SENSOR])
@pytest.mark.parametrize("since", [0, 1, 5, 20, 40])
def test_a_torque_that_stands_still_since_before_anybody_looked(name: str, since: int) -> None:
    """Or since some samples after: nothing had been learnt of it that it could be judged by."""
    rig = recorded("demo")
    reference_n = rig.estimate().rack_force_n
    stuck = rig.signals[name].copy()
    stuck[since:20_000] = {TORQUE: 0.2, SENSOR: 1.0}[name] if since == 0 else stuck[since]
    trace = rig.estimate(**{name: stuck})
    assert rig.longest_wrong_s(trace, reference_n) < 0.02
    early = rig.time_s[: len(trace.t_ns)] < 19.0
    assert np.mean(trace.valid[: early.sum()]) < 0.05
    assert np.mean(trace.valid[-15_000:]) > 0.9
    assert np.any(trace.reason & int(Reason.FROZEN))


def test_a_motor_that_is_off_is_none() -> None:
    rig = recorded("demo")
    trace = rig.estimate(**{TORQUE: np.zeros(len(rig.t_ns))})
    assert not np.any(trace.reason & int(Reason.FROZEN))


@pytest.mark.parametrize(("speed_rad_s", "for_s"), [(5.0, 1.5), (10.0, 1.5), (20.0, 5.0)])
@pytest.mark.parametrize("after_s", [0.3, 1.0, 3.0])
def test_noise_that_is_over_hides_no_jump_of_the_torque(
    speed_rad_s: float, for_s: float, after_s: float
) -> None:
    """It was believed for seconds after its end."""
    rig = recorded("demo")
    reference_n = rig.estimate().rack_force_n
    noisy = (rig.time_s > 4.0) & (rig.time_s < 4.0 + for_s)
    begin_s = 4.0 + for_s + after_s
    jump = (rig.time_s > begin_s) & (rig.time_s < begin_s + 0.4)
    turns = np.where(np.arange(len(rig.t_ns)) % 2, 1.0, -1.0)
    trace = rig.estimate(
        **{
            SPEED: rig.signals[SPEED] + speed_rad_s * turns * noisy,
            TORQUE: rig.signals[TORQUE] + 0.4 * jump,
        }
    )
    there = trace.t_ns > rig.t_ns[0] + round((4.0 + for_s) * 1e9)
    reference_n[~there] = trace.rack_force_n[~there]
    assert rig.longest_wrong_s(trace, reference_n) < 0.02
