"""The advised test really separates: judged by a diagnosis' own fit, not by the advice."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eps_hil.diagnosis.attribute.select import select
from eps_hil.diagnosis.balance.problem import Problem
from eps_hil.diagnosis.data.prepare import Prepared, prepare
from eps_hil.diagnosis.verdict.advise import Advice, advise
from eps_hil.physics.balance import residual_nm
from eps_hil.physics.effects.catalogue import catalogue
from eps_hil.physics.model import Model
from eps_hil.rig.manoeuvre import load_manoeuvre
from eps_hil.rig.menu import contents, menu, write
from eps_hil.series import Series

pytestmark = pytest.mark.slow
STRIBECK = {"effect": "stribeck", "level_nm": 0.03, "speed_rad_s": 8.0}
RIVAL = "breakaway_dwell"
TESTS = ("hold_series", "slow_reversals", "fast_load")


@pytest.fixture(scope="module")
def tests(reference_model: Model) -> Mapping[str, Mapping[str, Series]]:
    return menu(reference_model, names=TESTS)


def with_effect(one: Prepared, model: Model, entry: Mapping[str, Any]) -> Prepared:
    """The same motion on a rig that has the effect: its motor gives that much more torque."""
    plain = Problem([one], model)
    changed = plain.with_entries([entry])
    motion = one.motion(model)
    more = residual_nm(model, motion)[0] - residual_nm(changed, motion)[0]
    late = model.delays_s.motor_torque
    torque = one.raw["motor_torque_nm"] + np.interp(one.time_s - late, one.time_s, more)
    return one.changed(raw={**one.raw, "motor_torque_nm": torque})


def test_running_the_advised_test_settles_it(
    tests: Mapping[str, Mapping[str, Series]], reference_model: Model
) -> None:
    """On the best test's recording the true name beats its rival as clearly as was promised."""
    advice = advise(reference_model, STRIBECK, [RIVAL], tests)
    assert advice[0].separation_per_min > 3 * advice[-1].separation_per_min
    assert advice[0].minutes < 1.5
    recording = with_effect(prepare("run", tests[advice[0].manoeuvre]), reference_model, STRIBECK)
    costs = {}
    for name in ("stribeck", RIVAL):
        problem = Problem([recording], reference_model)
        everything_else = set(catalogue()) - {name}
        costs[name] = select(problem, None, everything_else).found.cost
    assert costs[RIVAL] - costs["stribeck"] > 60.0


CONSTANTS = ("motor_torque_offset", "torque_sensor_offset", "friction_asymmetry")
FREE = ("weave", "slow_reversals", "fast_load", "motor_off")
"""A driver and assist; a driver alone; the motor alone; neither."""


@pytest.fixture(scope="module")
def free(reference_model: Model) -> Mapping[str, Mapping[str, Series]]:
    return menu(reference_model, names=FREE)


def of_one(name: str) -> Mapping[str, Any]:
    parameter = "half_difference_nm" if name == "friction_asymmetry" else "offset_nm"
    return {"effect": name, parameter: 0.1 if name == "torque_sensor_offset" else 0.006}


@pytest.mark.parametrize("name", CONSTANTS)
def test_constants_are_told_apart_where_sensors_have_nothing_on_them(
    free: Mapping[str, Mapping[str, Series]], reference_model: Model, name: str
) -> None:
    rivals = [one for one in CONSTANTS if one != name]
    advice = {one.manoeuvre: one for one in advise(reference_model, of_one(name), rivals, free)}
    assert advice["motor_off"].minutes < 1.0
    assert advice["weave"].minutes > 60.0  # hand and motor at work: nothing to read


@pytest.mark.parametrize(
    ("name", "rival", "manoeuvre"),
    [
        ("motor_torque_offset", "friction_asymmetry", "slow_reversals"),
        ("torque_sensor_offset", "motor_torque_offset", "fast_load"),
    ],
)
def test_what_was_read_already_is_not_advised_again(
    free: Mapping[str, Mapping[str, Series]],
    reference_model: Model,
    name: str,
    rival: str,
    manoeuvre: str,
) -> None:
    """A motor torque that is a command reads none with the motor off, whatever it is."""
    one = {manoeuvre: free[manoeuvre]}
    (fresh,) = advise(reference_model, of_one(name), [rival], one)
    (known,) = advise(reference_model, of_one(name), [rival], one, CONSTANTS)
    assert fresh.minutes < 1.5
    assert known.minutes > 60.0


@pytest.mark.parametrize("name", sorted(contents()))
def test_every_test_of_the_menu_is_a_file_that_the_rig_loads(name: str, tmp_path: Path) -> None:
    path = tmp_path / "next.yaml"
    write(name, "tells a from b", path)
    assert path.read_text(encoding="utf-8").startswith("# tells a from b\n")
    assert load_manoeuvre(path).duration_s > 5.0


def test_a_test_is_run_whole() -> None:
    assert Advice("x", 1e6, 20.0).minutes == pytest.approx(1.0 / 3.0)
    assert Advice("x", 20.0, 20.0).minutes == pytest.approx(3.0)


def test_never_separated_is_infinite() -> None:
    assert Advice("x", 0.0, 10.0).minutes == np.inf
    assert Advice("x", 0.0, 10.0).content()["minutes"] is None
