"""The catalogue: its ids are the contract's, and an effect written once works everywhere."""

import dataclasses
import math
import subprocess
import sys
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eps_hil.estimation.batch import estimate
from eps_hil.physics import effects
from eps_hil.physics import simulate as simulate_module
from eps_hil.physics.effects import added
from eps_hil.physics.effects.catalogue import catalogue, values_of, with_model_effects
from eps_hil.physics.effects.effect import Instant, Slot
from eps_hil.physics.forward import forward
from eps_hil.physics.model import Model
from eps_hil.physics.simulate import simulate
from eps_hil.series import Series

CONTRACT_8 = {
    "stribeck", "viscous_friction", "quadratic_drag", "load_dependent_friction",
    "friction_asymmetry", "presliding_hysteresis", "position_dependent_friction",
    "breakaway_dwell", "friction_warmup", "screw_ripple", "cogging_torque", "torque_ripple",
    "cardan_joint", "motor_torque_saturation", "motor_torque_delay", "speed_sensor_delay",
    "motor_torque_offset", "torque_sensor_offset", "torque_sensor_gain",
    "torque_sensor_hysteresis", "motor_torque_gain", "coulomb_level", "inertia", "rack_ratio",
    "backlash", "belt_compliance", "end_stop", "unmodelled_spring", "position_torque",
    "clock_drift", "dropped_frames", "empirical",
}  # fmt: skip

EXAMPLES: Mapping[str, Mapping[str, Any]] = {
    "stribeck": {"level_nm": 0.08, "speed_rad_s": 15.0},
    "viscous_friction": {"coefficient_nm_s_per_rad": 2e-3},
    "quadratic_drag": {"coefficient_nm_s2_per_rad2": 3e-5},
    "load_dependent_friction": {"gain_nm_per_n": 5e-5},
    "friction_asymmetry": {"half_difference_nm": 0.03},
    "presliding_hysteresis": {"sigma0_nm_per_rad": 0.2},
    "position_dependent_friction": {"level_nm": 0.1, "centre_m": 0.001, "width_m": 0.003},
    "breakaway_dwell": {"level_nm": 0.1, "time_s": 0.05, "release_rad": 10.0},
    "friction_warmup": {"amplitude": 0.8, "time_s": 5.0},
    "screw_ripple": {"amplitude_nm": 0.05, "phase_rad": 0.7},
    "cogging_torque": {"amplitude_nm": 0.05, "order": 3.0, "phase_rad": 0.2},
    "torque_ripple": {"fraction": 0.2, "phase_rad": 0.1, "pole_pairs": 1},
    "cardan_joint": {"fraction": 0.3, "phase_rad": 0.5},
    "motor_torque_saturation": {"curvature_per_nm2": 0.5},
    "motor_torque_delay": {"delay_s": 0.01},
    "speed_sensor_delay": {"delay_s": 0.008},
    "motor_torque_offset": {"offset_nm": 0.05},
    "torque_sensor_offset": {"offset_nm": 0.8},
    "torque_sensor_gain": {"gain": 1.5},
    "motor_torque_gain": {"gain": 1.15},
    "coulomb_level": {"scale": 1.6},
    "inertia": {"scale": 1.5},
    "rack_ratio": {"scale": 0.2},
    "end_stop": {"position_m": 0.004, "stiffness_n_per_m": 3e5},
    "unmodelled_spring": {"stiffness_nm_per_rad": 0.01, "middle_rad": 0.5},
    "position_torque": {"curve": [[-0.01, -0.1], [0.0, 0.05], [0.01, 0.1]]},
    "torque_sensor_hysteresis": {"play_nm": 0.8},
    "backlash": {"gap_rad": 0.1},
    "belt_compliance": {"stiffness_nm_per_rad": 15.0, "damping_nm_s_per_rad": 0.01},
    "empirical": {
        "form": "law", "where": "rotor", "inputs": ["motor_speed_rad_s"], "shapes": ["linear"],
        "size": 2e-3,
    },
}  # fmt: skip
JOINTS = {name for name in EXAMPLES if catalogue()[name].slot is Slot.JOINT}
"""Effects of the joint behind the rotor: tests/physics/test_two_masses.py."""


def model_with(model: Model, *entries: Mapping[str, Any]) -> Model:
    """The reference rig on a spring (so that it stays in the middle), with effects added."""
    base = dataclasses.replace(
        model.friction, viscous_pos_nm_s_per_rad=1e-3, viscous_neg_nm_s_per_rad=1e-3
    )
    return dataclasses.replace(model, friction=base, effects=tuple(entries))


def inputs(pauses: bool = False) -> dict[str, Series]:
    """Eight seconds of movement; with ``pauses`` the rig rests for half a second at times."""
    t = np.linspace(0.0, 8.0, 8001)
    push = np.clip(4.0 * np.sin(math.pi * t) + 2.0, 0.0, 1.0) if pauses else np.ones(len(t))
    t_ns = np.round(t * 1e9).astype(np.int64)
    columns = {
        "motor_torque_nm": 0.5 * np.sin(2 * math.pi * 1.0 * t)
        + 0.25 * np.sin(2 * math.pi * 2.7 * t),
        "torque_sensor_nm": 2.0 * np.sin(2 * math.pi * 0.6 * t + 1.0),
        "rack_force_n": 350.0 * np.sin(2 * math.pi * 0.45 * t),
    }
    return {name: Series(t_ns, push * column) for name, column in columns.items()}


SLOTS = {
    Slot.LEVEL: added.level_nm,
    Slot.LEVEL_FACTOR: added.level_nm,
    Slot.TORQUE: added.torque_nm,
    Slot.MOTOR: added.motor_nm,
    Slot.SENSOR: added.sensor_nm,
}
RATIO = 2513.0
"""i_APA (rad/m) of the instants here."""
SPRING = {"effect": "unmodelled_spring", "stiffness_nm_per_rad": 0.03}


def recorded(model: Model) -> dict[str, Series]:
    """A recording of ``model`` as its sensors would report it."""
    rests = any(entry["effect"] == "breakaway_dwell" for entry in model.effects)
    result = forward(model, inputs(rests))
    return {
        name: Series(result.t_ns, result.columns[name])
        for name in (
            "motor_torque_nm", "torque_sensor_nm", "motor_speed_rad_s", "motor_angle_rad",
            "rack_force_n",
        )
    }  # fmt: skip


def rms_error(series: Mapping[str, Series], model: Model) -> float:
    """Rack-force error in N while moving, the estimate made with ``model``."""
    ins = {name: one for name, one in series.items() if name != "rack_force_n"}
    trace = estimate(ins, model)
    time_s = trace.t_ns * 1e-9
    force, speed = (
        np.interp(time_s, series[name].t_ns * 1e-9, series[name].value)
        for name in ("rack_force_n", "motor_speed_rad_s")
    )
    rows = trace.valid & (np.abs(speed) > 2) & (time_s > 0.5)
    return float(np.sqrt(np.mean((trace.rack_force_n[rows] - force[rows]) ** 2)))


def test_ids_are_the_contracts() -> None:
    assert set(catalogue()) == CONTRACT_8


def test_a_file_is_known_by_its_name() -> None:
    folder = Path(next(iter(effects.__path__)))
    files = {file.stem for file in folder.glob("*.py")}
    assert files - {"__init__", "effect", "catalogue", "added"} == set(catalogue())


def test_every_simulated_effect_has_an_example_here() -> None:
    assert set(EXAMPLES) == {e.id for e in catalogue().values() if e.simulated}


@pytest.mark.parametrize("name", sorted(CONTRACT_8))
def test_every_entry_says_what_it_has_to(name: str) -> None:
    effect = catalogue()[name]
    assert effect.equation
    assert effect.sentence.endswith(".")
    filled = {p.name: 0.5 * (p.lower + p.upper) for p in effect.parameters}
    assert "{" not in effect.sentence.format(**filled)
    assert set(effect.twins) <= CONTRACT_8
    for parameter in effect.parameters:
        assert parameter.lower < parameter.upper
        assert parameter.meaning


@pytest.mark.parametrize("name", sorted(set(EXAMPLES) - JOINTS))
def test_simulated_with_it_estimated_with_it(reference_model: Model, name: str) -> None:
    """The simulator and the estimator agree on every effect; the model without it is worse."""
    entry = {"effect": name, **EXAMPLES[name]}
    plain = [] if name == "unmodelled_spring" else [SPRING]
    spring = {"effect": name, "stiffness_nm_per_rad": 0.045}
    truth = model_with(reference_model, *plain, spring if not plain else entry)
    lacking = model_with(reference_model, *(plain or [SPRING]))
    recording = recorded(truth)
    with_it, without = rms_error(recording, truth), rms_error(recording, lacking)
    assert with_it < 25, f"{name}: {with_it:.1f} N with the effect"
    assert without > 1.5 * with_it, f"{name}: {without:.1f} N without, {with_it:.1f} N with"


@pytest.mark.parametrize(
    "name", sorted(n for n in set(EXAMPLES) - JOINTS if catalogue()[n].slot is not Slot.MODEL)
)
def test_a_kernel_does_its_equation(reference_model: Model, name: str) -> None:
    """Each slot's fused function against CONTRACT 8 written out again in plain Python."""
    effect = catalogue()[name]
    model = dataclasses.replace(reference_model, effects=({"effect": name, **EXAMPLES[name]},))
    table = added.added(model)
    phi, w, t, force = 7.3, -12.0, 1.7, 400.0
    x, psi = phi / 2513.0, phi * 125.7 / 2513.0
    u = Instant(t, w, phi, x, force, psi, 0.6, 0.0, RATIO)
    curve = [(-0.01, -0.1), (0.0, 0.05), (0.01, 0.1)]
    written_out = {
        "stribeck": lambda v: v + 0.08 * math.exp(-((w / 15) ** 2)),
        "viscous_friction": lambda v: v + 2e-3 * w,
        "quadratic_drag": lambda v: v + 3e-5 * w * abs(w),
        "position_dependent_friction": lambda v: v + 0.1 * math.exp(-(((x - 0.001) / 0.003) ** 2)),
        "breakaway_dwell": lambda v: v,
        "friction_warmup": lambda v: v * (1 + 0.8 * math.exp(-t / 5)),
        "screw_ripple": lambda v: v + 0.05 * math.sin(phi / 2.8 + 0.7),
        "cogging_torque": lambda v: v + 0.05 * math.sin(3 * phi + 0.2),
        "torque_ripple": lambda v: v * (1 + 0.2 * math.sin(6 * phi + 0.1)),
        "cardan_joint": lambda v: v * (1 + 0.3 * math.cos(2 * psi + 0.5)),
        "motor_torque_saturation": lambda v: v / (1 + 0.5 * v * v),
        "motor_torque_offset": lambda v: v + 0.05,
        "motor_torque_gain": lambda v: v * 1.15,
        "torque_sensor_offset": lambda v: v - 0.8,
        "torque_sensor_gain": lambda v: v / 1.5,
        "unmodelled_spring": lambda v: v + 0.01 * (phi - 0.5),
        "position_torque": lambda v: v + np.interp(x, [k[0] for k in curve], [k[1] for k in curve]),
        "end_stop": lambda v: v,
        "empirical": lambda v: v + 2e-3 * w,
        "torque_sensor_hysteresis": lambda v: v,
    }
    got = SLOTS[effect.slot](table, u, 0.3)
    assert got == pytest.approx(written_out[name](0.3), rel=1e-12)


def test_a_sensor_is_undone_from_what_it_reports_to_what_acts(reference_model: Model) -> None:
    """reported = gain · true + offset, whatever the order in the file; the joint comes behind."""
    entries = [{"effect": name, **EXAMPLES[name]} for name in reversed(sorted(EXAMPLES))]
    motor = ("motor_torque_gain", "motor_torque_offset", "motor_torque_saturation")
    sensor = ("torque_sensor_offset", "torque_sensor_gain", "cardan_joint")
    u = Instant(1.7, -12.0, 7.3, 0.003, 400.0, 0.4, 0.6, 0.0, RATIO)
    model = model_with(reference_model, *(e for e in entries if e["effect"] in motor + sensor))
    table = added.added(model)
    acts = (2.3 - 0.8) / 1.5 * (1 + 0.3 * math.cos(2 * 0.4 + 0.5))
    assert added.sensor_nm(table, u, 2.3) == pytest.approx(acts, rel=1e-12)
    shaft = 1.15 * 0.9 + 0.05
    assert added.motor_nm(table, u, 0.9) == pytest.approx(shaft / (1 + 0.5 * shaft**2), rel=1e-12)


@pytest.mark.parametrize("name", sorted(EXAMPLES))
def test_slots_that_are_left_out_would_have_done_nothing(
    reference_model: Model, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    t = np.linspace(0.0, 0.3, 301)
    given = t, 0.6 * np.sin(12 * t), 2.0 * np.sin(9 * t), 300.0 * np.sin(12 * t)
    model = model_with(reference_model, {"effect": name, **EXAMPLES[name]})
    short = simulate(model, *given)
    drive = simulate_module.drive_of(model)
    assert not all(drive.use)
    whole = drive._replace(use=added.InUse(*(True for _ in drive.use)))
    monkeypatch.setattr(simulate_module, "drive_of", lambda _model: whole)
    for one, other in zip(
        dataclasses.astuple(short), dataclasses.astuple(simulate(model, *given)), strict=True
    ):
        np.testing.assert_array_equal(one, other)


def test_end_stop_pushes_back_on_both_sides(reference_model: Model) -> None:
    entry = {"effect": "end_stop", "position_m": 0.004, "stiffness_n_per_m": 1e6}
    table = added.added(dataclasses.replace(reference_model, effects=(entry,)))
    for side in (1, -1):
        x = side * 0.005
        u = Instant(0.0, 0.0, x * 2513.0, x, 0.0, 0.0, 0.0, 0.0, RATIO)
        assert added.torque_nm(table, u, 0.0) == pytest.approx(side * 1e6 * 0.001 / 2513.0)


@pytest.mark.slow
def test_dwell_grows_at_rest_and_is_lost_by_sliding(reference_model: Model) -> None:
    entry = {"effect": "breakaway_dwell", "level_nm": 0.1, "time_s": 1.0, "release_rad": 0.5}
    table = added.added(dataclasses.replace(reference_model, effects=(entry,)))
    rest, slide = (
        Instant(0, 0, 0, 0, 0, 0, 0, 0.0, RATIO),
        Instant(0, 10.0, 0, 0, 0, 0, 0, 0.0, RATIO),
    )
    for _ in range(2000):
        added.advance(table, rest, 1e-3)
    assert added.level_nm(table, rest, 0.0) == pytest.approx(0.1 * (1 - math.exp(-2.0)), rel=1e-3)
    for _ in range(100):  # 1 rad at 10 rad/s: two release lengths
        added.advance(table, slide, 1e-3)
    left = 0.1 * (1 - math.exp(-2.0)) * math.exp(-2.0)
    assert added.level_nm(table, slide, 0.0) == pytest.approx(left, rel=1e-2)


@pytest.mark.parametrize("play", [0.2, 0.8])
def test_sensor_play_is_taken_back_past_its_gap(reference_model: Model, play: float) -> None:
    """A reading made with play from a known torque comes back to it while it moves on one way."""
    entry = {"effect": "torque_sensor_hysteresis", "play_nm": play}
    table = added.added(dataclasses.replace(reference_model, effects=(entry,)))
    t = np.arange(0.0, 8.0, 1e-3)
    true, reading, error = 3.0 * np.sin(2 * math.pi * 0.3 * t), 0.0, []
    for now in true:
        reading = min(max(reading, now - play), now + play)
        u = Instant(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, reading, RATIO)
        added.advance(table, u, 1e-3)
        error.append(added.sensor_nm(table, u, reading) - now)
    settled = np.abs(np.array(error))[1000:]
    assert np.median(settled) < 0.01 * play
    assert np.max(settled) < 2.1 * play  # inside the gap nothing is known


@pytest.mark.parametrize(
    ("entry", "said"),
    [
        ({"effect": "stribeck", "level_nm": 0.1, "speed_rad_s": 0.0}, "more than 0 rad/s"),
        ({"effect": "stribeck", "level_nm": "high", "speed_rad_s": 3}, "a number was expected"),
        ({"effect": "stribeck", "level_nm": math.nan, "speed_rad_s": 3}, "level_nm is nan"),
        ({"effect": "stribeck", "level": 0.1, "speed_rad_s": 3}, "no parameter 'level'"),
        ({"effect": "unknown"}, "no effect"),
        ({"effect": "clock_drift", "ppm": 100.0}, "acts on what a rig reports"),
        ({"effect": "position_torque", "curve": [[0, 1]]}, "2 to 32 knots"),
        ({"effect": "position_torque", "curve": [[1, 1], [0, 2]]}, "rising"),
        ({"effect": "position_torque", "curve": "steep"}, "pairs"),
    ],
)
def test_wrong_entries_are_named(reference_model: Model, entry: Any, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        values_of(entry, reference_model)


def test_terms_of_one_effect_follow_on_one_another(reference_model: Model) -> None:
    first = {"effect": "cogging_torque", "amplitude_nm": 0.02, "order": 4.0, "phase_rad": 0.1}
    second = {**first, "order": 12.0, "amplitude_nm": 0.01}
    table = added.added(dataclasses.replace(reference_model, effects=(first, second)))
    u = Instant(0.0, 1.0, 0.7, 0.0, 0.0, 0.0, 0.0, 0.0, RATIO)
    both = 0.02 * math.sin(4 * 0.7 + 0.1) + 0.01 * math.sin(12 * 0.7 + 0.1)
    assert added.torque_nm(table, u, 0.0) == pytest.approx(both)


def test_too_many_terms_of_one_effect_are_refused(reference_model: Model) -> None:
    entry = {"effect": "motor_torque_offset", "offset_nm": 0.1}
    with pytest.raises(ValueError, match="more than 4 times"):
        added.added(dataclasses.replace(reference_model, effects=(entry,) * 5))


@pytest.mark.slow
def test_each_term_remembers_for_itself(reference_model: Model) -> None:
    entry = {"effect": "breakaway_dwell", "level_nm": 0.1, "time_s": 1.0, "release_rad": 0.5}
    slow = {**entry, "time_s": 10.0}
    table = added.added(dataclasses.replace(reference_model, effects=(entry, slow)))
    rest = Instant(0, 0, 0, 0, 0, 0, 0, 0.0, RATIO)
    for _ in range(1000):
        added.advance(table, rest, 1e-3)
    grown = 0.1 * (1 - math.exp(-1.0)) + 0.1 * (1 - math.exp(-0.1))
    assert added.level_nm(table, rest, 0.0) == pytest.approx(grown, rel=1e-3)


def test_model_effects_are_worked_in_once(reference_model: Model) -> None:
    entry = {"effect": "inertia", "scale": 2.0}
    once = with_model_effects(dataclasses.replace(reference_model, effects=(entry,)))
    assert once.inertia_kg_m2 == 2 * reference_model.inertia_kg_m2
    assert with_model_effects(once) == once


def test_no_effects_change_nothing(reference_model: Model) -> None:
    zero = {"effect": "motor_torque_offset", "offset_nm": 0.0}
    t = np.linspace(0.0, 1.0, 1001)
    plain = simulate(reference_model, t, 0.3 * np.sin(9 * t), 0 * t, 0 * t)
    same = simulate(
        dataclasses.replace(reference_model, effects=(zero,)), t, 0.3 * np.sin(9 * t), 0 * t, 0 * t
    )
    assert np.array_equal(plain.speed_rad_s, same.speed_rad_s)


def test_the_reference_page_is_in_step() -> None:
    script = Path(__file__).parents[2] / "scripts" / "effects_reference.py"
    done = subprocess.run([sys.executable, str(script), "--check"], check=False)
    assert done.returncode == 0, "run scripts/effects_reference.py"


def test_a_negative_amplitude_has_words_of_its_own() -> None:
    effect = catalogue()["stribeck"]
    for level, word in ((0.03, "higher"), (-0.03, "lower")):
        sentence, values = effect.wording({"level_nm": level, "speed_rad_s": 5.0})
        assert f"0.03 Nm {word}" in sentence.format(**values)


def test_no_sentence_gives_a_size_a_sign() -> None:
    """What is less is said to be less: where an amplitude may be negative there are words for it.

    A ratio says its sign with its number.
    """
    signless = {"rack_ratio", "cogging_torque", "torque_ripple", "screw_ripple", "cardan_joint"}
    for name, effect in catalogue().items():
        amplitude = effect.probe.amplitude if effect.probe else None
        own = next((p for p in effect.parameters if p.name == amplitude), None)
        if own is None or not own.lower < 0.0 or name in signless or "{" not in effect.sentence:
            continue
        filled = {p.name: 0.5 * p.upper for p in effect.parameters}
        sentence, values = effect.wording({**filled, own.name: 0.5 * own.lower})
        assert sentence == effect.sentence_negative, name
        assert sentence.endswith(".")
        assert sentence != effect.sentence
        assert values[own.name] == -0.5 * own.lower
        assert "{" not in sentence.format(**values)


@pytest.mark.parametrize(
    ("name", "order"), [("cogging_torque", 3.0), ("torque_ripple", 6.0), ("screw_ripple", 1 / 2.8)]
)
def test_a_ripple_too_fast_for_the_samples_is_none(
    reference_model: Model, name: str, order: float
) -> None:
    """At 1 kHz the rotor would be in the same phase at every sample: a constant, that is not."""
    model = dataclasses.replace(reference_model, effects=({"effect": name, **EXAMPLES[name]},))
    table = added.added(model)
    slot = added.motor_nm if name == "torque_ripple" else added.torque_nm

    def at(passing_hz: float) -> float:
        speed = 2 * math.pi * passing_hz / order
        return float(slot(table, Instant(1.0, speed, 7.3, 0.003, 0.0, 0.36, 0.6, 0.0, RATIO), 0.3))

    assert at(1000.0) == at(-1000.0) == at(500.0) == 0.3
    assert at(0.0) == at(390.0) != 0.3
    assert at(450.0) - 0.3 == pytest.approx(0.5 * (at(0.0) - 0.3))


@pytest.mark.parametrize("name", sorted(n for n in EXAMPLES if catalogue()[n].kernel is not None))
def test_what_goes_with_time_says_so(reference_model: Model, name: str) -> None:
    """``over_time`` is what the kernel does: all else the same, minutes later."""
    effect = catalogue()[name]
    table = added.added(model_with(reference_model, {"effect": name, **EXAMPLES[name]}))
    then, later = (
        SLOTS[effect.slot](table, Instant(t, 5.0, 7.3, 0.003, 400.0, 0.4, 0.6, 0.5, RATIO), 0.3)
        for t in (1.0, 200.0)
    )
    assert bool(then != later) is effect.over_time


def test_whole_turns_of_a_phase_say_nothing(reference_model: Model) -> None:
    for turns in (-1, 1, 2):
        entry = {"effect": "screw_ripple", "amplitude_nm": 0.01, "phase_rad": 0.5}
        other = {**entry, "phase_rad": 0.5 + 2.0 * math.pi * turns}
        (_, one), (_, same) = (values_of(each, reference_model) for each in (entry, other))
        assert same["phase_rad"] == pytest.approx(one["phase_rad"], abs=1e-12)
    with pytest.raises(ValueError, match="phase_rad is inf"):
        values_of({**entry, "phase_rad": math.inf}, reference_model)


def test_effects_are_worked_into_each_model_by_itself(reference_model: Model) -> None:
    """Many threads, many models at once: each gets its own, and again what it got before."""
    models = [
        dataclasses.replace(
            reference_model, effects=({"effect": "coulomb_level", "scale": 1.0 + 0.01 * k},)
        )
        for k in range(40)
    ]
    level = reference_model.friction.offset_pos_nm
    with ThreadPoolExecutor(4) as pool:
        for _ in range(5):
            for k, one in enumerate(pool.map(with_model_effects, models)):
                assert one.effects == ()
                assert one.friction.offset_pos_nm == pytest.approx(level * (1.0 + 0.01 * k))
                assert with_model_effects(one) == one
