"""Effects of the rig's model file: as ``simulate`` has them, in every chain, and on the bus."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from eps_hil.compiled import direct
from eps_hil.errors import InputError
from eps_hil.physics.chain import (
    HAND_TORQUE,
    INPUTS,
    LOAD_FORCE,
    Chain,
    ChainState,
    build_chain,
    rest_state,
    stored_energy_j,
)
from eps_hil.physics.chain_parameters import ChainParameters
from eps_hil.physics.chain_reading import read_out
from eps_hil.physics.chain_step import advance
from eps_hil.physics.effects import effect as effect_of
from eps_hil.physics.effects.catalogue import catalogue
from eps_hil.physics.effects.effect import Slot
from eps_hil.physics.model import Model, load_model
from eps_hil.physics.simulate import simulate
from eps_hil.rig import reported
from eps_hil.rig.config import load_rig_setup
from eps_hil.rig.manoeuvre import load_manoeuvre
from eps_hil.rig.offline import simulate_recording
from eps_hil.rig.process import Rig, RigSimulation
from eps_hil.rig.sensors import Sensors, SensorSettings

Floats = NDArray[np.float64]

EXAMPLES: dict[str, dict[str, Any]] = {
    "stribeck": {"level_nm": 0.05, "speed_rad_s": 12.0},
    "viscous_friction": {"coefficient_nm_s_per_rad": 2e-3},
    "quadratic_drag": {"coefficient_nm_s2_per_rad2": 2e-5},
    "load_dependent_friction": {"gain_nm_per_n": 1e-4},
    "friction_asymmetry": {"half_difference_nm": 0.02},
    "presliding_hysteresis": {"sigma0_nm_per_rad": 1.5},
    "position_dependent_friction": {"level_nm": 0.1, "centre_m": 0.001, "width_m": 0.001},
    "breakaway_dwell": {"level_nm": 0.06, "time_s": 0.05},
    "friction_warmup": {"amplitude": 0.5, "time_s": 1.0},
    "screw_ripple": {"amplitude_nm": 0.05, "phase_rad": 0.4},
    "cogging_torque": {"amplitude_nm": 0.04, "order": 6.0, "phase_rad": 0.2},
    "torque_ripple": {"fraction": 0.1, "phase_rad": 0.1},
    "cardan_joint": {"fraction": 0.2, "phase_rad": 0.3},
    "motor_torque_saturation": {"curvature_per_nm2": 0.3},
    "motor_torque_delay": {"delay_s": 0.004, "lag_share": 1.0},
    "speed_sensor_delay": {"delay_s": 0.003},
    "motor_torque_offset": {"offset_nm": 0.05},
    "torque_sensor_offset": {"offset_nm": 0.8},
    "torque_sensor_gain": {"gain": 1.5},
    "motor_torque_gain": {"gain": 1.15},
    "coulomb_level": {"scale": 1.6},
    "inertia": {"scale": 1.5},
    "rack_ratio": {"scale": 0.1, "slope_per_m": 5.0, "bend_per_m2": 100.0},
    "end_stop": {"position_m": 0.001, "stiffness_n_per_m": 3e5},
    "unmodelled_spring": {"stiffness_nm_per_rad": 0.01},
    "position_torque": {"curve": [[-0.002, -0.1], [0.0, 0.05], [0.002, 0.1]]},
    "torque_sensor_hysteresis": {"play_nm": 0.8},
    "backlash": {"gap_rad": 0.1},
    "belt_compliance": {"stiffness_nm_per_rad": 15.0, "damping_nm_s_per_rad": 0.01},
    "empirical": {
        "form": "law", "where": "rotor", "inputs": ["motor_speed_rad_s"], "shapes": ["linear"],
        "size": 2e-3,
    },
}  # fmt: skip
JOINTS = {"backlash", "belt_compliance"}
REPORTED_ONLY = {"clock_drift", "dropped_frames"}
MS = 600
TIME = np.arange(MS + 1) * 1e-3
PUSH = np.clip(np.abs(TIME - 0.3) / 0.02 - 4.0, 0.0, 1.0)
"""A rest of 0.16 s in the middle, for what grows while nothing moves."""
COMMAND = PUSH * (0.5 * np.sin(2 * np.pi * 2.0 * TIME) + 0.2 * np.sin(2 * np.pi * 5.0 * TIME))
ROWS = np.zeros((MS + 1, INPUTS))
ROWS[:, LOAD_FORCE] = PUSH * 400.0 * np.sin(2 * np.pi * 1.1 * TIME)
ROWS[:, HAND_TORQUE] = PUSH * 2.0 * np.sin(2 * np.pi * 1.6 * TIME)


SPRING = {"effect": "unmodelled_spring", "stiffness_nm_per_rad": 0.08}
"""Holds the rig in the middle."""


def with_effect(model: Model, name: str, **values: Any) -> Model:
    return replace(model, effects=({"effect": name, **(values or EXAMPLES[name])},))


def sprung(model: Model) -> Model:
    friction = replace(model.friction, viscous_pos_nm_s_per_rad=1e-3, viscous_neg_nm_s_per_rad=1e-3)
    return replace(model, friction=friction, effects=(*model.effects, SPRING))


def prompt(chain: ChainParameters) -> ChainParameters:
    return replace(chain, motor_dead_time_s=0.0, motor_time_constant_s=0.0, end_stop=None)


def run(chain: Chain, command: Floats = COMMAND) -> tuple[ChainState, dict[str, Floats]]:
    """One millisecond a row; the readings at the instants of ``TIME`` but the last."""
    state, scratch, lines = rest_state(chain), np.zeros((2, INPUTS)), []
    read = direct(read_out, chain, state, ROWS[0], ROWS[0])
    step = direct(advance, chain, state, 0.0, ROWS[0], ROWS[0], 20, scratch)
    for k in range(MS):
        rate = (ROWS[k + 1] - ROWS[k]) * 1e3
        lines.append(read(chain, state, ROWS[k], rate))
        step(chain, state, float(command[k]), ROWS[k], ROWS[k + 1], 20, scratch)
    names = lines[0]._fields
    return state, {name: np.array([getattr(one, name) for one in lines]) for name in names}


def test_every_effect_has_an_example_here() -> None:
    assert set(EXAMPLES) | REPORTED_ONLY | {"unknown"} >= set(catalogue())


@pytest.mark.parametrize("name", sorted(set(EXAMPLES) - {"torque_sensor_hysteresis"}))
def test_one_mass_moves_as_simulate_says(model: Model, chain: ChainParameters, name: str) -> None:
    """Same inputs, same motion: the rig's truth against the simulator's, and not the plain one."""
    truth, model = sprung(with_effect(model, name)), sprung(model)
    rig = build_chain(truth, prompt(chain).without_steering_wheel(), 1)
    _, told = run(rig)
    # The rig's command is held for a millisecond, a recording's torque is straight lines.
    time = np.sort(np.concatenate([TIME[:-1], TIME[1:] - 1e-9]))
    held = np.repeat(COMMAND[:-1], 2)
    sensor, force = (np.interp(time, TIME, ROWS[:, k]) for k in (HAND_TORQUE, LOAD_FORCE))
    values = EXAMPLES[name]
    if name == "torque_sensor_offset":
        sensor = sensor + values["offset_nm"]
    if name == "torque_sensor_gain":
        sensor = sensor * values["gain"]
    motion = simulate(truth, time, held, sensor, force)
    wanted = motion.speed_rad_s[::2]
    off = np.sqrt(np.mean((told["motor_speed_rad_s"] - wanted) ** 2))
    close = 0.02 if name in JOINTS else 1e-3
    assert off < close * np.std(wanted)
    assert np.abs(told["motor_angle_rad"] - motion.angle_rad[::2]).max() < close * np.ptp(
        motion.angle_rad
    )
    plain = simulate(model, time, held, np.interp(time, TIME, ROWS[:, HAND_TORQUE]), force)
    moved = np.sqrt(np.mean((plain.speed_rad_s[::2] - told["motor_speed_rad_s"]) ** 2))
    instruments = {"torque_sensor_offset", "torque_sensor_gain", "speed_sensor_delay"}
    assert (moved > 2 * off) != (name in instruments)


@pytest.mark.parametrize(
    "order", [*(pytest.param(n, marks=pytest.mark.slow) for n in (1, 2, 3, 4)), 5]
)
def test_work_is_stored_lost_or_taken_by_the_effect(
    model: Model, chain: ChainParameters, order: int
) -> None:
    """Closes only if the midpoint equation was solved with the torque that was booked."""
    _, plain = run(build_chain(sprung(model), chain, order))
    for name in EXAMPLES:
        state, told = run(built := build_chain(sprung(with_effect(model, name)), chain, order))
        motor, load, hand, joints, friction, stop = state.energy_j
        put_in = motor + load + hand - joints - friction - stop - float(state.effects_j[0])
        assert abs(put_in - stored_energy_j(built, state)) < 1e-6 * friction, name
        changed = np.std(told["motor_speed_rad_s"] - plain["motor_speed_rad_s"])
        instrument = name in {"speed_sensor_delay", "torque_sensor_hysteresis"}
        instrument |= name in {"torque_sensor_offset", "torque_sensor_gain"}
        assert (changed > 1e-3 * np.std(plain["motor_speed_rad_s"])) != instrument, name


@pytest.mark.parametrize("order", [1, 2, 5])
def test_a_spring_holds_half_k_phi_squared(
    model: Model, chain: ChainParameters, order: int
) -> None:
    truth = with_effect(model, "unmodelled_spring", stiffness_nm_per_rad=0.05)
    state, told = run(built := build_chain(truth, chain, order))
    angle = state.angle_rad[built.group[1]]
    assert np.ptp(told["motor_angle_rad"]) > 1.0
    assert state.effects_j[0] == pytest.approx(0.5 * 0.05 * angle**2, rel=1e-3, abs=1e-5)


@pytest.mark.parametrize("order", [2, 4, 5])
def test_play_lies_between_rotor_and_rack(model: Model, chain: ChainParameters, order: int) -> None:
    _, told = run(build_chain(with_effect(model, "backlash", gap_rad=0.6), chain, order))
    apart = told["motor_angle_rad"] - 2513.0 * told["rack_position_m"]
    assert 0.28 < np.abs(apart).max() < 0.45
    assert np.mean(np.abs(apart) > 0.28) > 0.5


def test_a_varying_ratio_shows_between_rotor_and_rack(model: Model, chain: ChainParameters) -> None:
    truth = with_effect(model, "rack_ratio", scale=0.0, slope_per_m=8.0)
    for order in (1, 5):
        _, told = run(build_chain(truth, prompt(chain), order))
        x, angle = told["rack_position_m"], told["motor_angle_rad"]
        assert np.ptp(x) > 0.003
        off = np.abs(angle - 2513.0 * x * (1.0 + 8.0 * x)).max()
        assert off < 0.02 * np.ptp(angle), order


QUIET = SensorSettings(noise=False, quantise=False)


def recording(model: Model, chain: ChainParameters, *, order: int = 2) -> Any:
    return simulate_recording(model, chain, load_manoeuvre("steps"), order=order, sensors=QUIET)


def test_what_is_reported_and_what_is_true_part(model: Model, chain: ChainParameters) -> None:
    """A motor that gives more than it says: told on the bus is what it says."""
    got = recording(with_effect(model, "motor_torque_gain", gain=1.2), chain)
    told, true = got.columns["motor_torque_nm"][1:], got.truth["motor_torque_nm"][:-1]
    assert np.abs(true).max() > 0.1
    assert np.allclose(true, 1.2 * told, atol=1e-12)


def test_play_of_the_torque_sensor_is_in_its_reading(model: Model, chain: ChainParameters) -> None:
    got = recording(with_effect(model, "torque_sensor_hysteresis", play_nm=0.3), chain)
    told, true = got.columns["torque_sensor_nm"], got.truth["torque_sensor_nm"]
    at, wanted = 0.0, []
    for value in true:
        at = min(max(at, value - 0.3), value + 0.3)
        wanted.append(at)
    assert np.ptp(true) > 0.7
    assert np.allclose(told, wanted, atol=1e-12)


def test_offset_and_gain_of_the_sensor(model: Model, chain: ChainParameters) -> None:
    both = ({"effect": "torque_sensor_gain", "gain": 1.4},
            {"effect": "torque_sensor_offset", "offset_nm": 0.5})  # fmt: skip
    got = recording(replace(model, effects=both), chain)
    assert np.allclose(got.columns["torque_sensor_nm"], 1.4 * got.truth["torque_sensor_nm"] + 0.5)


@pytest.mark.parametrize(("dead_s", "late_ms"), [(0.003, 2), (0.0005, 0), (-0.002, 0)])
def test_the_shaft_follows_what_the_motor_reports(
    model: Model, chain: ChainParameters, dead_s: float, late_ms: int
) -> None:
    """The file says 1 ms late; with 3 ms more the report is 2 ms ahead of the shaft."""
    got = recording(with_effect(model, "motor_torque_delay", delay_s=dead_s), chain)
    told, true = got.columns["motor_torque_nm"], got.truth["motor_torque_nm"]
    if late_ms:
        assert np.allclose(told[:-late_ms], true[late_ms:], atol=1e-9)
    else:
        lag = 0.001 - dead_s
        time = got.columns["time_s"]
        assert np.allclose(told[10:], np.interp(time - lag, time, true)[10:], atol=1e-9)


def test_a_clock_that_drifts_reports_ever_later(model: Model) -> None:
    ramp = np.zeros((3000, 14))
    ramp[:, 2] = np.arange(3000) * 1e-3  # speed
    told = Sensors(model, QUIET, 0, drifts_ppm={"motor_speed_rad_s": 2000.0}).run(ramp)[:, 2]
    t = ramp[:, 2]
    assert np.allclose(told[500:], (t - 0.004 - 2e-3 * t)[500:], atol=1e-9)


def config(tmp_path: Path, base: Path, *effects: Mapping[str, Any]) -> Path:
    model_file = tmp_path / "hidden.yaml"
    base_model = load_model(Path(__file__).parents[2] / "configs" / "reference_rig.yaml")
    replace(base_model, effects=tuple(effects)).save(model_file)
    text = base.read_text().replace("rig: {", f"rig: {{model: {model_file}, ")
    made = tmp_path / "hidden_rig.yaml"
    made.write_text(text)
    return made


def test_the_rig_on_a_bus_has_the_effect(tmp_path: Path, config_file: Path) -> None:
    offset = {"effect": "torque_sensor_offset", "offset_nm": 1.0}
    plain = RigSimulation(load_rig_setup(config_file))
    other = RigSimulation(load_rig_setup(config(tmp_path, config_file, offset)))
    one, two = ([frame.data for frame in rig.step(0)] for rig in (plain, other))
    assert one != two
    said: list[str] = []
    Rig(load_rig_setup(config(tmp_path, config_file, offset)), said.append).run(duration_s=0.001)
    assert any("effects: torque_sensor_offset" in line for line in said)


@pytest.mark.slow
def test_frames_are_lost_as_often_as_told(tmp_path: Path, config_file: Path) -> None:
    lossy = {"effect": "dropped_frames", "count": 300, "signal": "motor_speed_rad_s"}
    plain = RigSimulation(load_rig_setup(config_file))
    other = RigSimulation(load_rig_setup(config(tmp_path, config_file, lossy)))
    sent: list[dict[int, int]] = [{}, {}]
    for counts, rig in zip(sent, (plain, other), strict=True):
        for _ in range(rig.rows):
            for frame in rig.step(0):
                counts[frame.can_id] = counts.get(frame.can_id, 0) + 1
    missing = {key: sent[0][key] - sent[1][key] for key in sent[0] if sent[0][key] != sent[1][key]}
    assert list(missing.values()) == [300]


@pytest.mark.parametrize(
    ("entry", "said"),
    [
        ({"effect": "speed_sensor_delay", "delay_s": -0.01}, "speed_sensor_delay"),
        ({"effect": "inertia", "scale": 0.2}, "inertia"),
        ({"effect": "clock_drift", "ppm": -10.0}, "clock_drift"),
        ({"effect": "clock_drift", "ppm": 10.0, "signal": "speed"}, "'speed' is no signal"),
        ({"effect": "dropped_frames", "count": 10**8}, "dropped_frames"),
    ],
)  # fmt: skip
def test_what_cannot_act_is_refused_by_name(
    tmp_path: Path, config_file: Path, entry: Mapping[str, Any], said: str
) -> None:
    with pytest.raises(InputError) as refused:
        RigSimulation(load_rig_setup(config(tmp_path, config_file, entry)))
    assert said in str(refused.value)
    assert "\n" not in str(refused.value)


def test_an_instrument_without_a_way_to_report_is_refused(
    model: Model, chain: ChainParameters, monkeypatch: pytest.MonkeyPatch
) -> None:
    known = dict(catalogue())
    mute = replace(known["torque_sensor_gain"], told=None)
    monkeypatch.setattr(
        "eps_hil.physics.chain.values_of", lambda entry, _model: (mute, {"gain": 1.2})
    )
    with pytest.raises(InputError, match="torque_sensor_gain"):
        reported.split("m.yaml", with_effect(model, "torque_sensor_gain"), chain, 5)
    assert mute.slot is Slot.SENSOR
    assert mute.kind is effect_of.Kind.INSTRUMENT


def test_only_a_rig_takes_what_only_a_rig_has(tmp_path: Path, model: Model) -> None:
    path = tmp_path / "m.yaml"
    replace(model, effects=({"effect": "clock_drift", "ppm": 50.0},)).save(path)
    assert load_model(path, rig=True).effects
    with pytest.raises(InputError, match="only the model of 'eps-hil rig'"):
        load_model(path)
