"""Where rig and model part, as the page is given it."""

import numpy as np
import pytest

from eps_hil.dashboard.mismatch import CELLS, nice, overview
from eps_hil.dashboard.store import Store
from eps_hil.dashboard.traces import BALANCE, CELL, ERROR, SPEED

T0_NS = 1_790_000_000_000_000_000


def driven(what: str, step_ms: int) -> Store:
    """20 s: speed from -40 to 40 rad/s and back, 100 N either way; 30 N too much above 20 rad/s."""
    store = Store(60.0)
    k = np.arange(0, 20_000, dtype=np.int64)
    speed = 38.0 * np.sin(2 * np.pi * 0.5 * k * 1e-3)
    force = np.where(k < 10_000, 90.0, -90.0)
    t_ns = T0_NS + k * 1_000_000
    left = np.where(speed > 20.0, 30.0, 3.0)
    left[np.abs(speed) < 2.0] = np.nan
    residual = t_ns[::step_ms], left[::step_ms]
    store.append({SPEED: (t_ns, speed), CELL: (t_ns, force), what: residual})
    return store


@pytest.mark.parametrize(("what", "step_ms"), [(BALANCE, 8), (ERROR, 1)])
def test_the_map_shows_at_which_speed_and_load(what: str, step_ms: int) -> None:
    found = overview(driven(what, step_ms), limit_n=10.0)
    assert found is not None
    assert found["map"]["x"] == [-40.0, 40.0]
    assert found["map"]["y"] == [-100.0, 100.0]
    assert found["map"]["top_n"] == 30.0
    middle = {
        (column, row): value for column, row, value, _ in found["map"]["now"] if column != CELLS / 2
    }
    assert {row for _, row in middle} == {0, 15}, "90 N either way"
    for (column, _), value in middle.items():
        begins = -40.0 + 80.0 * column / CELLS
        assert value == (30.0 if begins >= 20.0 else 3.0)
    assert found["what"] == ("torque balance" if what == BALANCE else "estimate less load cell")


def test_the_strip_shows_when_and_its_axis_is_all_that_is_kept() -> None:
    found = overview(driven(BALANCE, 8), limit_n=10.0)
    assert found is not None
    assert found["kept"] == [pytest.approx(T0_NS * 1e-9), pytest.approx(T0_NS * 1e-9 + 19.999)]
    assert found["strip"]["window_s"] == 0.5
    when = {t - T0_NS * 1e-9: value for t, value in found["strip"]["now"]}
    assert len(when) == 40
    assert when[0.0] > 20.0, "turns positive in the first second"
    assert when[1.0] == 3.0


def test_noise_alone_does_not_fill_the_scale() -> None:
    found = overview(driven(BALANCE, 8), limit_n=300.0)
    assert found is not None
    assert found["map"]["top_n"] == 300.0


def test_nothing_is_shown_of_nothing() -> None:
    store = Store(60.0)
    assert overview(store, 10.0) is None
    t_ns = T0_NS + np.arange(100, dtype=np.int64) * 1_000_000
    store.append({BALANCE: (t_ns, np.full(100, np.nan))})
    assert overview(store, 10.0) is None
    store.append({ERROR: (t_ns, np.ones(100))})
    found = overview(store, 10.0)
    assert found is not None
    assert found["map"] is None, "without speed and load there is no map"


def test_axes_are_round() -> None:
    assert [nice(v) for v in (0.0, 0.83, 1.0, 38.0, 751.0, 801.0)] == [1, 1, 1, 40, 800, 1000]
