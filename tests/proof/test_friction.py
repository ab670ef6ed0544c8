"""Generalised Maxwell-slip friction has the properties that name it."""

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eps_hil.proof.laws import bristle_friction, sliding_level, slip_friction
from eps_hil.proof.truth import Drive, Floats, Hidden, lugre, maxwell_slip

DRIVE = Drive(sigma1=0.0)
LEVEL = 0.1
LENGTH = LEVEL / DRIVE.sigma0
"""T_fs/σ0, the length of presliding."""


def _path(*turns: float) -> Floats:
    """Displacements (rad) through turning points given in presliding lengths, 500 steps each."""
    legs = [
        np.linspace(a, b, max(round(500 * abs(b - a)), 2))[1:] * LENGTH
        for a, b in pairwise((0.0, *turns))
    ]
    return np.concatenate(legs)


def _torques(path: Floats, forth: float = LEVEL, back: float = LEVEL) -> Floats:
    slip = maxwell_slip()
    state = np.zeros(len(slip.level_share))
    moves = np.diff(path, prepend=0.0)
    return np.array([slip_friction(DRIVE, slip, state, move, forth, back, 1.0) for move in moves])


def test_shares_add_up() -> None:
    slip = maxwell_slip()
    assert len(slip.level_share) >= 4
    assert slip.level_share.sum() == pytest.approx(1.0)
    assert (slip.level_share > 0).all()
    assert (slip.stiffness > 0).all()
    assert len(lugre().level_share) == 0


def test_slides_at_its_level_in_each_direction() -> None:
    there = _torques(_path(10.0), forth=0.06, back=0.13)
    back = _torques(_path(10.0, -10.0), forth=0.06, back=0.13)
    assert there[-1] == pytest.approx(0.06)
    assert back[-1] == pytest.approx(-0.13)


def test_returns_to_the_point_where_an_inner_loop_left() -> None:
    """Return-point memory: a closed inner loop leaves no trace."""
    straight = _torques(_path(-10.0, 0.8))[-1]
    with_loop = _torques(_path(-10.0, 0.8, 0.3, 0.8))
    on_with_it = _torques(_path(-10.0, 0.8, 0.3, 0.8, 1.5))[-1]
    assert with_loop[-1] == pytest.approx(straight, rel=1e-6)
    assert on_with_it == pytest.approx(_torques(_path(-10.0, 1.5))[-1], rel=1e-6)


def test_lugre_forgets_that_point() -> None:
    """The bristle drifts where Maxwell-slip closes its loop: that is how the two forms differ."""
    state, values = np.zeros(1), []
    for move in np.diff(_path(-10.0, 0.8, 0.3, 0.8), prepend=0.0):
        values.append(bristle_friction(DRIVE, state, move, LEVEL, 1.0))
    straight = np.zeros(1)
    for move in np.diff(_path(-10.0, 0.8), prepend=0.0):
        reached = bristle_friction(DRIVE, straight, move, LEVEL, 1.0)
    assert abs(values[-1] - reached) > 0.02 * LEVEL


@given(st.floats(0.05, 3.0))
def test_masing_reversal_is_the_virgin_curve_twice_as_large(distance: float) -> None:
    virgin = _torques(_path(0.5 * distance))[-1]
    reversed_ = _torques(_path(10.0, 10.0 - distance))[-1]
    assert LEVEL - reversed_ == pytest.approx(2 * virgin, rel=1e-6)


@given(st.floats(0.05, 3.0), st.floats(0.04, 0.2), st.floats(0.04, 0.2))
@pytest.mark.slow
def test_unequal_levels_have_one_length_both_ways(
    distance: float, forth: float, back: float
) -> None:
    """T − (T + T') exp(−u/ℓ) with ℓ = (T + T')/2σ0 whichever way; LuGre has ℓ = T/σ0."""
    length = 0.5 * (forth + back) / DRIVE.sigma0
    turns = np.linspace(0.0, distance * length, 400)[1:]
    for way, ahead, behind in ((1.0, forth, back), (-1.0, back, forth)):
        path = np.concatenate([np.linspace(0.0, -2.0, 4000) * way, -2.0 * way + turns * way])
        found = way * _torques(path, forth, back)[-1]
        expected = ahead - (ahead + behind) * np.exp(-distance)
        assert found == pytest.approx(expected, abs=0.03 * (ahead + behind))


@given(st.floats(0.05, 3.9))
def test_reversal_from_sliding_follows_the_lugre_curve(distance: float) -> None:
    """Straight between points of 2 T_fs (1 − e^−u): never further off than its chords are."""
    drop = (LEVEL - _torques(_path(10.0, 10.0 - distance))[-1]) / (2 * LEVEL)
    assert drop == pytest.approx(1 - np.exp(-distance), abs=0.04)


@given(st.lists(st.floats(-5.0, 5.0), min_size=2, max_size=6))
def test_never_beyond_its_level_and_never_a_source_of_energy(turns: list[float]) -> None:
    path = _path(*turns)
    torques = _torques(path)
    assert np.abs(torques).max() <= LEVEL * (1 + 1e-12)
    work = float(np.sum(torques * np.diff(path, prepend=0.0)))
    assert work >= -1e-12


@pytest.mark.parametrize(
    ("hidden", "kwargs", "gain"),
    [
        ({"stribeck_nm": 0.04, "stribeck_speed": 5.0}, {"speed": 0.0}, 0.04),
        ({"stribeck_nm": 0.04, "stribeck_speed": 5.0}, {"speed": 5.0}, 0.04 * np.exp(-1)),
        ({"load_gain": 1e-5}, {"load": -1000.0}, 0.01),
        ({"place_nm": 0.05, "place_centre_m": 0.01, "place_width_m": 0.002}, {"place": 0.012},
         0.05 * np.exp(-1)),
        ({"dwell_nm": 0.05}, {"aged": 0.5}, 0.025),
        ({"half_difference_nm": 0.01}, {"side": -1.0}, -0.01),
        ({"coulomb_scale": 1.5}, {}, 0.5 * 0.056),
        ({"warmup": 0.2, "warmup_time_s": 10.0}, {"t": 10.0}, 0.2 * np.exp(-1) * 0.056),
    ],
)  # fmt: skip
def test_hidden_friction_is_what_the_contract_writes(
    hidden: dict[str, float], kwargs: dict[str, Any], gain: float
) -> None:
    at = {"side": 1.0, "speed": 0.0, "load": 0.0, "place": 0.0, "aged": 0.0, "t": 0.0, **kwargs}

    def level(h: Hidden) -> float:
        return sliding_level(
            Drive(), h, at["side"], at["speed"], at["load"], at["place"], at["aged"], at["t"]
        )

    assert level(Hidden(**hidden)) - level(Hidden()) == pytest.approx(gain, rel=1e-9)
