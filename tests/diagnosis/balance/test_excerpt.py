"""Hours of recordings: windows are what they are in the whole, and the worst are among them."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from eps_hil.diagnosis.balance import excerpt as excerpt_module
from eps_hil.diagnosis.balance.excerpt import evenly, excerpt
from eps_hil.diagnosis.balance.problem import Problem, sliding
from eps_hil.diagnosis.data.prepare import THIN, Prepared, prepare
from eps_hil.diagnosis.diagnose import diagnose
from eps_hil.physics.model import Model

pytestmark = pytest.mark.slow


@pytest.fixture
def soon_long(monkeypatch: pytest.MonkeyPatch) -> None:
    """Half a minute is long, and four windows are searched."""
    monkeypatch.setattr(excerpt_module, "LONG_S", 30.0)
    monkeypatch.setattr(excerpt_module, "SEARCHED_S", 48.0)
    monkeypatch.setattr(excerpt_module, "_HALF", 2)


def ready(recordings: Any) -> list[Prepared]:
    return [prepare(name, one) for name, one in recordings.items()]


def test_a_window_is_what_it_is_in_the_whole(
    record: Callable[..., Any], reference_model: Model
) -> None:
    (whole,) = ready(record({}, ("weave",), seconds=24.0))
    barred = np.arange(len(whole.thin_time_s)) % 7 == 0
    whole = whole.changed(barred=barred)
    first = 8000
    window = whole.cut(first, first + 12_000)
    inside = slice(first // THIN, first // THIN + len(window.thin_time_s))
    assert window.barred is not None
    np.testing.assert_array_equal(window.thin_time_s, whole.thin_time_s[inside])
    np.testing.assert_array_equal(window.barred, barred[inside])
    clear = sliding(window, reference_model)
    clear[:50], clear[-50:] = False, False  # filters have an end there
    assert np.mean(clear) > 0.4
    here = window.left_over(reference_model)[clear]
    there = whole.left_over(reference_model)[inside][clear]
    assert np.sqrt(np.mean((here - there) ** 2)) < 0.02 * window.floor_nm(reference_model)


def test_minutes_are_searched_as_a_whole(
    record: Callable[..., Any], reference_model: Model
) -> None:
    problem = Problem(ready(record({}, ("weave", "sweep"))), reference_model)
    assert excerpt(problem) is problem
    assert evenly(problem.recordings) is problem.recordings


@pytest.mark.usefixtures("soon_long")
def test_windows_that_fit_worst_are_among_those_searched(
    record: Callable[..., Any], reference_model: Model, other_rig: Any
) -> None:
    """What shows in two recordings of seven is looked at, wherever even distances fall."""
    odd = {other_rig.STRIB: 0.1, other_rig.STRIB_W: 10.0}
    made = [
        one
        for seed in range(1, 8)
        for one in ready(record(odd if seed in (3, 6) else {}, ("weave",), seed, seconds=13.0))
    ]
    part = excerpt(Problem(made, reference_model, {"motor_torque_delay": 0.0}))
    assert [one.name for one in part.recordings] == [f"weave_{k}" for k in (1, 3, 6, 7)]
    assert part.tied == {"motor_torque_delay": 0.0}
    assert len(evenly(made)) == 4


@pytest.mark.usefixtures("soon_long")
def test_what_an_excerpt_showed_is_fitted_and_judged_on_everything(
    record: Callable[..., Any], reference_model: Model, other_rig: Any
) -> None:
    plant = {other_rig.STRIB: 0.05, other_rig.STRIB_W: 10.0}
    recordings = {**record(plant, seed=1), **record(plant, seed=2), **record(plant, seed=3)}
    done = diagnose(reference_model, recordings, record(plant, ("weave",), 4))
    (finding,) = done.content["findings"]
    assert finding["effect"] == "stribeck"
    assert done.selection.part is not done.problem
    assert len(done.selection.found.residual) == len(done.problem.scale)
    assert len(done.selection.null.residual) == len(done.problem.scale)
    assert any("48 s of the recordings' 135 s" in one for one in done.content["limits"])
    low, high = finding["parameters"]["level_nm"]["ci95"]
    assert low < 0.05 < high
    assert high - low < 0.01
    assert done.selection.gains["stribeck"] == pytest.approx(
        done.selection.without["stribeck"].cost - done.selection.found.cost
    )


@pytest.mark.usefixtures("soon_long")
def test_nothing_is_invented_from_an_excerpt(
    record: Callable[..., Any], reference_model: Model
) -> None:
    """Windows are chosen for what is left in them, which noise must not profit from."""
    recordings = {**record({}, seed=1), **record({}, seed=2), **record({}, seed=3)}
    done = diagnose(reference_model, recordings, record({}, ("weave",), 4))
    assert done.content["verdict"] == "no_mismatch"
