"""The FMU's C against the kernels: the same trajectory, for every effect of the catalogue."""

import ctypes
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eps_hil.errors import InputError
from eps_hil.fmu.export import export_fmu
from eps_hil.fmu.variables import variables_of
from eps_hil.physics.effects.catalogue import catalogue, with_model_effects
from eps_hil.physics.model import Model, load_model
from eps_hil.physics.simulate import rack_position_m, simulate

fmpy = pytest.importorskip("fmpy")

MODEL = load_model(Path(__file__).parents[2] / "configs/reference_rig.yaml")
CURVE = [[-0.05, -0.1], [0.0, 0.02], [0.05, 0.15]]
EFFECTS: list[Mapping[str, Any]] = [
    {"effect": "backlash", "gap_rad": 0.05},
    {"effect": "belt_compliance", "stiffness_nm_per_rad": 60.0, "damping_nm_s_per_rad": 0.02},
    {"effect": "breakaway_dwell", "level_nm": 0.1, "time_s": 0.2},
    {"effect": "cardan_joint", "fraction": 0.1, "phase_rad": 0.4},
    {"effect": "cogging_torque", "amplitude_nm": 0.03, "order": 12.0, "phase_rad": 0.2},
    {"effect": "cogging_torque", "amplitude_nm": 0.02, "order": 24.0, "phase_rad": -0.2},
    {"effect": "coulomb_level", "scale": 1.3},
    {"effect": "end_stop", "position_m": 0.02, "stiffness_n_per_m": 3e5},
    {"effect": "friction_asymmetry", "half_difference_nm": 0.01},
    {"effect": "friction_warmup", "amplitude": 0.4, "time_s": 3.0},
    {"effect": "inertia", "scale": 1.2},
    {"effect": "load_dependent_friction", "gain_nm_per_n": 1e-5},
    {"effect": "motor_torque_delay", "delay_s": 0.006, "lag_share": 0.5},
    {"effect": "motor_torque_gain", "gain": 1.05},
    {"effect": "motor_torque_offset", "offset_nm": 0.02},
    {"effect": "motor_torque_saturation", "curvature_per_nm2": 0.01},
    {"effect": "position_dependent_friction", "level_nm": 0.05, "centre_m": 0.01, "width_m": 0.01},
    {"effect": "position_torque", "curve": CURVE},
    {"effect": "presliding_hysteresis", "sigma0_nm_per_rad": 8.0},
    {"effect": "quadratic_drag", "coefficient_nm_s2_per_rad2": 1e-5},
    {"effect": "rack_ratio", "scale": 0.02, "slope_per_m": 1.0, "bend_per_m2": 30.0},
    {"effect": "screw_ripple", "amplitude_nm": 0.03, "phase_rad": 0.5, "harmonic": 2.0},
    {"effect": "speed_sensor_delay", "delay_s": 0.002},
    {"effect": "stribeck", "level_nm": 0.05, "speed_rad_s": 8.0},
    {"effect": "torque_ripple", "fraction": 0.03, "phase_rad": 0.1},
    {"effect": "torque_sensor_gain", "gain": 1.1},
    {"effect": "torque_sensor_hysteresis", "play_nm": 0.1},
    {"effect": "torque_sensor_offset", "offset_nm": 0.1},
    {"effect": "unmodelled_spring", "stiffness_nm_per_rad": 0.01},
    {"effect": "viscous_friction", "coefficient_nm_s_per_rad": 1e-4},
]
LAW = {
    "effect": "empirical", "form": "law", "where": "motor", "how": "factor", "size": -0.05,
    "inputs": ["motor_torque_nm", "rack_position_m"], "shapes": ["square", "gaussian"],
    "memory": ["heat", "none"], "memory_1": 0.5, "centre_2": 0.0, "width_2": 0.02,
    "range": {"motor_torque_nm": [-9, 9]},
}  # fmt: skip
MAP = {
    "effect": "empirical", "form": "map", "where": "rotor",
    "inputs": ["motor_speed_rad_s", "rack_position_m"],
    "knots": [[-80, 0, 80], [-0.05, 0.05]], "values": [[-0.1, 0], [0, 0.05], [0.1, 0.2]],
}  # fmt: skip


def _inputs(seconds: float = 3.0) -> dict[str, Any]:
    t = np.arange(round(seconds * 1000) + 1) * 1e-3
    return {
        "time_s": t,
        "motor_torque_nm": 0.9 * np.sin(2 * np.pi * 0.8 * t) + 0.2 * np.sin(2 * np.pi * 5.3 * t),
        "torque_sensor_nm": 1.5 * np.sin(2 * np.pi * 0.5 * t + 0.3),
        "rack_force_n": 900.0 * np.sin(2 * np.pi * 0.8 * t - 0.4),
    }


RATES = {
    "motor_torque_nm": "motor_torque_rate_nm_per_s",
    "torque_sensor_nm": "torque_sensor_rate_nm_per_s",
    "rack_force_n": "rack_force_rate_n_per_s",
}


def _run(path: Path, given: dict[str, Any], **more: Any) -> Any:
    slopes = {
        rate: np.append(np.diff(given[name]) / np.diff(given["time_s"]), 0.0)
        for name, rate in RATES.items()
    }
    given = {**given, **slopes}
    names = list(given)
    table = np.array(
        list(zip(*given.values(), strict=True)),
        dtype=[("time" if n == "time_s" else n, float) for n in names],
    )
    options = {"output_interval": 1e-3, "validate": True, **more}
    return fmpy.simulate_fmu(
        str(path),
        input=table,
        start_time=float(given["time_s"][0]),
        stop_time=float(given["time_s"][-1]),
        **options,
    )


def _expected(model: Model, given: dict[str, Any], **start: Any) -> dict[str, Any]:
    worked_in = with_model_effects(model)
    late = max(-worked_in.delays_s.motor_torque, 0.0)
    t = given["time_s"]
    motor = np.interp(t - late, t, given["motor_torque_nm"])
    motion = simulate(
        worked_in, t, motor, given["torque_sensor_nm"], given["rack_force_n"], **start
    )
    return {
        "motor_speed_rad_s": motion.speed_rad_s,
        "motor_angle_rad": motion.angle_rad,
        "rack_position_m": rack_position_m(worked_in, motion.rack_rad),
        "friction_torque_nm": motion.friction_torque_nm,
    }


def _apart(found: Any, expected: dict[str, Any]) -> float:
    """Largest difference relative to the signal's largest value."""
    return max(
        float(np.max(np.abs(found[name] - one)) / np.max(np.abs(one)))
        for name, one in expected.items()
    )


def _joined(entry: Mapping[str, Any]) -> bool:
    return catalogue()[str(entry["effect"])].joint is not None


def test_no_effect_of_the_catalogue_is_forgotten_here() -> None:
    able = {name for name, effect in catalogue().items() if effect.simulated}
    assert {entry["effect"] for entry in EFFECTS} | {"empirical"} == able


@pytest.mark.slow
@pytest.mark.parametrize(
    "effects",
    [
        (),
        tuple(one for one in EFFECTS if not _joined(one)),
        tuple(one for one in EFFECTS if _joined(one)),
        (LAW, MAP),
    ],
    ids=["none", "all", "joint", "empirical"],
)
@pytest.mark.parametrize("fmi", [2, 3])
def test_the_fmu_does_what_simulate_does(effects: Any, fmi: int, tmp_path: Path) -> None:
    model = replace(MODEL, effects=effects)
    path = tmp_path / "out.fmu"
    export_fmu(model, path, fmi=fmi)
    assert fmpy.read_model_description(str(path)).fmiVersion == f"{fmi}.0"
    given = _inputs()
    expected = _expected(model, given)
    assert np.ptp(expected["motor_angle_rad"]) > 5.0
    assert _apart(_run(path, given), expected) < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("entry", EFFECTS, ids=lambda one: str(one["effect"]))
def test_each_effect_alone_changes_the_fmu_as_it_changes_simulate(
    entry: Mapping[str, Any], tmp_path: Path
) -> None:
    model = replace(MODEL, effects=(entry,))
    path = tmp_path / "out.fmu"
    export_fmu(model, path)
    given = _inputs(1.5)
    found = _run(path, given)
    assert _apart(found, _expected(model, given)) < 1e-9
    if entry["effect"] != "speed_sensor_delay":  # which is in what a sensor says, not in the motion
        assert _apart(found, _expected(MODEL, given)) > 1e-4


@pytest.fixture(scope="module")
def stribeck(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("fmu") / "drive 1.fmu"
    effect = {"effect": "stribeck", "level_nm": 0.05, "speed_rad_s": 8.0}
    export_fmu(replace(MODEL, effects=(effect,)), path)
    return path


@pytest.fixture(scope="module")
def third(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """As FMI 3."""
    path = tmp_path_factory.mktemp("fmu") / "drive 3.fmu"
    effect = {"effect": "stribeck", "level_nm": 0.05, "speed_rad_s": 8.0}
    export_fmu(replace(MODEL, effects=(effect,)), path, fmi=3)
    return path


def _slave(path: Path, folder: Path, name: str = "one") -> Any:
    from fmpy.fmi2 import FMU2Slave

    about = fmpy.read_model_description(str(path))
    if not folder.exists():  # a library that is in use must not be written over
        fmpy.extract(str(path), str(folder))
    slave = FMU2Slave(
        guid=about.guid,
        unzipDirectory=str(folder),
        modelIdentifier=about.coSimulation.modelIdentifier,
        instanceName=name,
    )
    slave.instantiate(callbacks=_callbacks())
    slave.vr = {one.name: one.valueReference for one in about.modelVariables}
    return slave


_MADE: list[Any] = []
"""Loggers that are never freed: FMPy calls the one that was made last, whoever's FMU logs."""


def _callbacks() -> Any:
    from fmpy import calloc, fmi2, free
    from fmpy.logging import addLoggerProxy

    made = fmi2.fmi2CallbackFunctions()
    made.logger = fmi2.fmi2CallbackLoggerTYPE(fmi2.printLogMessage)
    made.allocateMemory = fmi2.fmi2CallbackAllocateMemoryTYPE(calloc)
    made.freeMemory = fmi2.fmi2CallbackFreeMemoryTYPE(free)
    addLoggerProxy(ctypes.byref(made))
    _MADE.append(made)
    return made


def _start(slave: Any, **values: float) -> None:
    slave.setupExperiment(startTime=0.0)
    slave.enterInitializationMode()
    slave.setReal([slave.vr[name] for name in values], list(values.values()))
    slave.exitInitializationMode()


def _speed(slave: Any) -> float:
    return float(slave.getReal([slave.vr["motor_speed_rad_s"]])[0])


def _go(slave: Any, first: int, last: int, motor_nm: float = 0.5) -> float:
    for k in range(first, last):
        slave.setReal([slave.vr["motor_torque_nm"]], [motor_nm])
        slave.doStep(currentCommunicationPoint=k * 1e-3, communicationStepSize=1e-3)
    return _speed(slave)


@pytest.mark.parametrize("kind", ["stribeck", "third"])
def test_fmpy_has_no_complaint_and_every_parameter_has_unit_and_words(
    kind: str, request: pytest.FixtureRequest
) -> None:
    from fmpy.validation import validate_fmu

    path = request.getfixturevalue(kind)
    assert validate_fmu(str(path)) == []
    about = fmpy.read_model_description(str(path))
    listed = {one.name: one for one in about.modelVariables}
    level = listed["stribeck.level_nm"]
    assert (level.unit, level.causality, float(level.start)) == ("N.m", "parameter", 0.05)
    assert all(one.unit and one.description for one in about.modelVariables)


def test_the_same_model_makes_the_same_file(stribeck: Path, tmp_path: Path) -> None:
    again = tmp_path / stribeck.name
    effect = {"effect": "stribeck", "level_nm": 0.05, "speed_rad_s": 8.0}
    export_fmu(replace(MODEL, effects=(effect,)), again)
    one, other = (fmpy.read_model_description(str(path)) for path in (stribeck, again))
    assert one.guid == other.guid


def test_other_steps_of_the_master_make_a_difference_of_a_millionth_at_most(
    stribeck: Path,
) -> None:
    given = _inputs(2.0)
    smooth = {**given, "time_s": given["time_s"]}
    effect = {"effect": "stribeck", "level_nm": 0.05, "speed_rad_s": 8.0}
    expected = _expected(replace(MODEL, effects=(effect,)), smooth)
    found = _run(stribeck, smooth, output_interval=0.5e-3)
    assert len(found) == 2 * len(given["time_s"]) - 1
    assert _apart(found[::2], expected) < 1e-6


def test_parameters_and_start_values_are_taken(stribeck: Path) -> None:
    given = _inputs(1.0)
    other = replace(
        MODEL,
        inertia_kg_m2=3e-4,
        friction=replace(MODEL.friction, offset_pos_nm=0.1),
        effects=({"effect": "stribeck", "level_nm": 0.2, "speed_rad_s": 4.0},),
    )
    values = {"inertia_kg_m2": 3e-4, "friction.offset_pos_nm": 0.1, "stribeck.level_nm": 0.2,
              "stribeck.speed_rad_s": 4.0, "start_motor_speed_rad_s": -20.0}  # fmt: skip
    found = _run(stribeck, given, start_values=values)
    assert _apart(found, _expected(other, given, speed_rad_s=-20.0)) < 1e-9


@pytest.mark.parametrize(("step_s", "kept"), [(2e-6, True), (1e-6, False)])
def test_a_late_torque_is_not_forgotten_in_silence(
    step_s: float, kept: bool, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """19 ms of steps of 1 us are more than it keeps: the torque came 3 ms early."""
    late = {"effect": "motor_torque_delay", "delay_s": 0.02, "lag_share": 0.0}
    export_fmu(replace(MODEL, effects=(late,)), tmp_path / "late.fmu")
    slave = _slave(tmp_path / "late.fmu", tmp_path / "a")
    _start(slave)
    torque, speed, said = slave.vr["motor_torque_nm"], [], ""
    for k in range(round(0.022 / step_s)):
        slave.setReal([torque], [1.0 if k * step_s >= 1e-4 else 0.0])
        try:
            slave.doStep(currentCommunicationPoint=k * step_s, communicationStepSize=step_s)
        except fmpy.fmi1.FMICallException as error:
            said = str(error)
            break
        speed.append(_speed(slave))
    moved = np.flatnonzero(np.abs(speed) > 1e-9)
    if kept:
        assert not said
        assert moved[0] * step_s == pytest.approx(0.0191, abs=2 * step_s)
    else:
        assert said
        assert moved.size == 0, "nothing came too early"
        assert "is 0.019 s late and 16384 steps of it are kept: take steps of 1.16" in (
            capfd.readouterr().out
        )


def test_instances_are_apart_and_reset_begins_anew(stribeck: Path, tmp_path: Path) -> None:
    one, other = _slave(stribeck, tmp_path / "a"), _slave(stribeck, tmp_path / "a", "two")
    _start(one)
    _start(other, **{"inertia_kg_m2": 1e-3})
    first = _go(one, 0, 50)
    assert 0.0 < _go(other, 0, 50) < 0.5 * first
    assert _go(one, 50, 60) > first
    one.reset()
    _start(one)
    assert _go(one, 0, 50) == first


def test_a_state_is_kept_restored_and_written_down(stribeck: Path, tmp_path: Path) -> None:
    slave = _slave(stribeck, tmp_path / "a")
    _start(slave)
    _go(slave, 0, 20)
    kept = slave.getFMUState()
    written = slave.serializeFMUstate(kept)
    after = _go(slave, 20, 40)
    slave.setFMUState(kept)
    assert _go(slave, 20, 40) == after
    other = _slave(stribeck, tmp_path / "a", "two")
    _start(other, inertia_kg_m2=1e-3)
    other.setFMUState(other.deSerializeFMUstate(written))
    assert _go(other, 20, 40) == after


def _third(path: Path, folder: Path, **values: float) -> Any:
    from fmpy.simulation import instantiate_fmu

    about = fmpy.read_model_description(str(path))
    if not folder.exists():
        fmpy.extract(str(path), str(folder))
    slave = instantiate_fmu(str(folder), about, "CoSimulation")
    slave.vr = {one.name: one.valueReference for one in about.modelVariables}
    slave.enterInitializationMode(startTime=0.0)
    slave.setFloat64([slave.vr[name] for name in values], list(values.values()))
    slave.exitInitializationMode()
    return slave


def test_fmi_3_keeps_states_tells_its_time_and_refuses_what_is_out_of_bounds(
    third: Path, tmp_path: Path
) -> None:
    def go(slave: Any, first: int, last: int) -> list[float]:
        for k in range(first, last):
            slave.setFloat64([slave.vr["motor_torque_nm"]], [0.5])
            slave.doStep(currentCommunicationPoint=k * 1e-3, communicationStepSize=1e-3)
        return list(slave.getFloat64([slave.vr["motor_speed_rad_s"], slave.vr["time"]]))

    slave = _third(third, tmp_path / "a")
    go(slave, 0, 20)
    kept = slave.getFMUState()
    written = slave.serializeFMUState(kept)
    speed, time_s = after = go(slave, 20, 40)
    assert speed > 0.0
    assert time_s == pytest.approx(0.04)
    slave.setFMUState(kept)
    assert go(slave, 20, 40) == after
    other = _third(third, tmp_path / "a", inertia_kg_m2=1e-3)
    other.setFMUState(other.deserializeFMUState(written))
    assert go(other, 20, 40) == after
    with pytest.raises(fmpy.fmi1.FMICallException):
        slave.setFloat64([slave.vr["motor_speed_rad_s"]], [1.0])
    with pytest.raises(fmpy.fmi1.FMICallException):
        _third(third, tmp_path / "a", inertia_kg_m2=-1.0)


def test_a_number_out_of_its_bounds_is_refused_by_the_fmu(stribeck: Path, tmp_path: Path) -> None:
    slave = _slave(stribeck, tmp_path / "a")
    with pytest.raises(fmpy.fmi1.FMICallException):
        _start(slave, inertia_kg_m2=-1.0)
    slave.reset()
    _start(slave)
    slave.setReal([slave.vr["motor_torque_nm"]], [float("nan")])
    with pytest.raises(fmpy.fmi1.FMICallException):
        slave.doStep(currentCommunicationPoint=0.0, communicationStepSize=1e-3)
    with pytest.raises(fmpy.fmi1.FMICallException):
        slave.setReal([slave.vr["start_motor_speed_rad_s"]], [1.0])


def test_a_kernel_that_c_cannot_carry_is_refused_by_the_effects_name(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    from eps_hil.fmu import source
    from eps_hil.physics.effects import added

    walk: dict[str, Any] = {slot: list(rows) for slot, rows in added.WALK.items()}
    row = next(row for row, kernel in walk["level"] if "stribeck" in kernel.py_func.__module__)
    walk["level"] = [(row, sorted)]
    monkeypatch.setattr(source, "WALK", walk)
    effect = {"effect": "stribeck", "level_nm": 0.05, "speed_rad_s": 8.0}
    with pytest.raises(InputError, match="effect 'stribeck': an FMU cannot carry it"):
        export_fmu(replace(MODEL, effects=(effect,)), tmp_path / "a.fmu")


def test_no_compiler_is_said_before_anything_is_made(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    from eps_hil.fmu import build

    monkeypatch.setattr(build, "_zig", lambda: False)
    monkeypatch.setattr(build, "_compiler", lambda: None)
    with pytest.raises(InputError, match="no C compiler is found"):
        export_fmu(MODEL, tmp_path / "a.fmu")
    assert not list(tmp_path.iterdir())


def test_every_parameter_of_the_model_is_one_of_the_fmu() -> None:
    names = {one.name for one in variables_of(replace(MODEL, effects=tuple(EFFECTS)))}
    assert {"cogging_torque[2].amplitude_nm", "joint.gap_rad", "friction.sigma0_nm_per_rad",
            "position_torque.curve_2_torque_nm", "friction_warmup.time_s"} <= names  # fmt: skip
