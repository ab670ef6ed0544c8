"""A law saved as a catalogue file: the same torque as the entry that it was made from."""

import importlib.util
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eps_hil.diagnosis.remainder.as_effect import as_effect
from eps_hil.physics import effects
from eps_hil.physics.effects.catalogue import catalogue, values_of
from eps_hil.physics.effects.effect import STATES, WIDTH, Effect, Instant, Slot
from eps_hil.physics.effects.empirical import EFFECT
from eps_hil.physics.empirical_entry import INPUTS, OF_SHAPE, numbers, read, slot_of
from eps_hil.physics.model import Model, dump_model, load_model

ROOT = Path(__file__).parents[3]

_VALUES = {"centre": 0.3, "width": 0.7, "order": 3.0, "phase": 0.4, "memory": 0.5}


def entry(where: str, how: str, *factors: tuple[str, str, str], **more: Any) -> dict[str, Any]:
    found: dict[str, Any] = {
        "effect": "empirical", "form": "law", "where": where, "how": how, "size": 0.37, **more,
    }  # fmt: skip
    names, shapes, memory = (list(column) for column in zip(*factors, strict=True))
    found |= {"inputs": names, "shapes": shapes, "memory": memory}
    for i, (_, shape, kept) in enumerate(factors, 1):
        wanted = [*OF_SHAPE[shape], *(["memory"] if kept != "none" else [])]
        found |= {f"{one}_{i}": _VALUES[one] for one in wanted}
    return found


ENTRIES = [
    *(entry("rotor", "sum", (name, "linear", "none")) for name in INPUTS),
    *(entry("friction", "factor", ("motor_speed_rad_s", shape, "none")) for shape in OF_SHAPE),
    *(
        entry("motor", "sum", ("motor_torque_nm", "linear", memory))
        for memory in ("lag", "heat", "play", "stop", "hysteresis")
    ),
    entry("rotor", "sum", ("rack_force_n", "linear", "none"), ("motor_angle_rad", "sine", "none")),
    entry("friction", "sum", ("abs_motor_torque_nm", "saturating", "lag"),
          ("load_power_sign", "below", "none")),
    entry("torsion_bar", "factor", ("torque_sensor_nm", "step", "none"),
          range={"torque_sensor_nm": [-0.5, 0.5]}),
]  # fmt: skip


def loaded(text: str, folder: Path) -> Effect:
    path = folder / "my_effect.py"
    path.write_text(text, encoding="utf-8")
    spec = importlib.util.spec_from_file_location("my_effect", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    found: Effect = module.EFFECT
    return found


def instants(count: int) -> list[Instant]:
    rng = np.random.default_rng(3)
    rows = rng.normal(0.0, 1.0, (count, 6))
    return [
        Instant(0.01 * k, speed, angle, place, force, 0.0, motor, sensor, 2500.0)
        for k, (speed, angle, place, force, motor, sensor) in enumerate(rows.tolist())
    ]


def in_python(compiled: Any) -> Callable[..., float]:
    """What a compiled function is before it is compiled."""
    plain: Callable[..., float] = compiled.py_func
    return plain


@pytest.mark.parametrize(
    "one", ENTRIES, ids=lambda one: f"{one['inputs']}{one['shapes']}{one['memory']}"
)
def test_the_file_is_the_same_torque(one: dict[str, Any], tmp_path: Path) -> None:
    effect = loaded(as_effect(one, "my_effect"), tmp_path)
    values = read(one)
    assert effect.slot is Slot(slot_of(values))
    assert effect.kernel is not None
    mine, theirs = np.zeros(WIDTH), np.zeros(WIDTH)
    mine[: len(effect.parameters)] = [p.default for p in effect.parameters]
    theirs[: len(numbers(values))] = numbers(values)
    state, other = np.zeros(STATES), np.zeros(STATES)
    kernel, advance = EFFECT.slots[slot_of(values)], EFFECT.advance
    assert advance is not None
    for u in instants(40):
        a = in_python(effect.kernel)(mine, state, u, 1.5)
        assert a == pytest.approx(in_python(kernel)(theirs, other, u, 1.5), rel=1e-9, abs=1e-12)
        if effect.advance is not None:
            in_python(effect.advance)(mine, state, u, 0.01)
        in_python(advance)(theirs, other, u, 0.01)
        assert EFFECT.outside is not None
        beyond = bool(effect.outside and in_python(effect.outside)(mine, u))
        assert beyond == in_python(EFFECT.outside)(theirs, u)
    for p in effect.parameters:
        assert p.default is not None
        assert p.lower <= p.default <= p.upper


def test_the_catalogue_takes_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, reference_model: Model
) -> None:
    """Put into the folder of effects, a model file may hold it, with the numbers found."""
    one = entry("friction", "sum", ("abs_motor_torque_nm", "saturating", "lag"))
    (tmp_path / "my_effect.py").write_text(as_effect(one, "my_effect"), encoding="utf-8")
    monkeypatch.setattr(effects, "__path__", [*effects.__path__, str(tmp_path)])
    catalogue.cache_clear()
    try:
        effect, values = values_of({"effect": "my_effect"}, reference_model)
    finally:
        catalogue.cache_clear()
        sys.modules.pop(f"{effects.__name__}.my_effect", None)
    assert effect.id == "my_effect"
    assert values == {"size": 0.37, "width_1": 0.7, "memory_1": 0.5}
    assert "{size" in effect.wording(values)[0]


def test_a_sign_has_no_centre_to_fit(tmp_path: Path) -> None:
    """It is -1 or 1: a centre between them is the size in other words."""
    one = entry("friction", "sum", ("abs_rack_force_n", "linear", "none"),
                ("load_power_sign", "above", "none"))  # fmt: skip
    text = as_effect({**one, "centre_2": 0.0}, "my_effect")
    assert [p.name for p in loaded(text, tmp_path).parameters] == ["size"]
    assert text.startswith('"""Friction changes with |F| and sign(-F·ω).')


def test_a_map_is_no_law() -> None:
    table = {"effect": "empirical", "form": "curve", "where": "rotor", "how": "sum",
             "inputs": ["motor_speed_rad_s"], "memory": ["none"], "values": [0.0, 1.0]}  # fmt: skip
    with pytest.raises(ValueError, match="no law"):
        as_effect(table, "my_effect")
    with pytest.raises(ValueError, match="name of an effect"):
        as_effect(ENTRIES[0], "my-effect")


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_simulate_and_estimate_use_the_file_as_they_use_the_law(tmp_path: Path) -> None:
    """In a copy of the package, as a user puts it there: the same columns, the same reasons."""
    shutil.copytree(
        ROOT / "eps_hil", tmp_path / "eps_hil", ignore=shutil.ignore_patterns("__pycache__")
    )
    law = entry("friction", "sum", ("abs_motor_torque_nm", "saturating", "lag"),
                ("motor_speed_rad_s", "rational", "none"),
                range={"motor_speed_rad_s": [-25.0, 25.0]}, size=0.05)  # fmt: skip
    saved = tmp_path / "eps_hil" / "physics" / "effects" / "my_effect.py"
    saved.write_text(as_effect(law, "my_effect"), encoding="utf-8")
    model = load_model(ROOT / "configs" / "reference_rig.yaml")
    t = np.arange(8000) * 1e-3
    force = 300.0 * np.sin(1.1 * t)
    columns = {
        "time_s": t,
        "motor_torque_nm": 0.45 * np.sin(2.0 * t) + force / model.rack_to_rotor_ratio_rad_per_m,
        "motor_speed_rad_s": 40.0 * np.sin(2.0 * t),
        "motor_angle_rad": 20.0 * (1.0 - np.cos(2.0 * t)),
        "rack_force_n": force,
    }
    np.savetxt(tmp_path / "r.csv", np.column_stack(list(columns.values())), delimiter=",",
               header=",".join(columns), comments="", fmt="%.9g")  # fmt: skip
    made = {}
    for name, effect in (("law", law), ("file", {"effect": "my_effect"})):
        text = dump_model(replace(model, effects=(effect,)))
        (tmp_path / f"{name}.yaml").write_text(text, encoding="utf-8")
        for words in (
            ["simulate", "--inputs", "r.csv", "--out", f"simulate_{name}.csv"],
            ["estimate", "r.csv", "--out", f"estimate_{name}.csv"],
        ):
            done = subprocess.run(
                [sys.executable, "-m", "eps_hil", *words, "--model", f"{name}.yaml"],
                cwd=tmp_path, capture_output=True, text=True, check=False,
                env={**os.environ, "PYTHONPATH": str(tmp_path)},
            )  # fmt: skip
            assert done.returncode == 0, done.stderr
            table = np.genfromtxt(tmp_path / f"{words[0]}_{name}.csv", delimiter=",", names=True)
            made[words[0], name] = table
    for verb in ("simulate", "estimate"):
        one, other = made[verb, "law"], made[verb, "file"]
        for column in one.dtype.names or ():
            np.testing.assert_allclose(other[column], one[column], rtol=1e-6, atol=1e-6)
    reasons = made["estimate", "file"]["valid"]
    assert 0.2 < np.mean(reasons) < 0.9, "the range that was seen is no reason"
