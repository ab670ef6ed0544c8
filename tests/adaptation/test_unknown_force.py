"""A rack force told from a change of friction, by the last levels and by the way before sliding."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eps_hil.adaptation.slide import Slide, SlideLevel
from eps_hil.adaptation.unknown_force import NOT_SEEN, force_that_explains_n, shift_of
from eps_hil.estimation.levels import FrictionLevels
from eps_hil.physics.model import Model

SlideLevelOf = Callable[[Slide, Model, bool, float], SlideLevel | None]
OWN = FrictionLevels(0.056, 0.1258)
RATIO, SIGMA0 = 2513.0, 4.5
levels_of_gears = st.builds(FrictionLevels, st.floats(0.03, 0.2), st.floats(0.03, 0.2))


@given(true=levels_of_gears, force_n=st.floats(-50.0, 50.0))
def test_lengths_of_eq_2a_give_the_force_back(true: FrictionLevels, force_n: float) -> None:
    """λ = k0/σ0 of the friction alone; the torques hold the force too."""
    shift = force_n / RATIO
    found = FrictionLevels(true.positive_nm + shift, true.negative_nm - shift)
    forth, back = ([level / SIGMA0] * 3 for level in true)
    seen = shift_of(found, forth, back, SIGMA0)
    assert seen.torque_nm == pytest.approx(shift, abs=1e-9)
    assert seen.std_nm == pytest.approx(0.0, abs=1e-9)


def test_another_form_of_presliding_says_nothing() -> None:
    forth, back = ([level / SIGMA0] * 3 for level in OWN)
    assert shift_of(OWN, forth, back, 1.1 * SIGMA0) == NOT_SEEN, (
        "a stiffness that is not the model's"
    )
    assert shift_of(OWN, [0.009, 0.0125, 0.016], back, SIGMA0) == NOT_SEEN, "no bristle"
    assert shift_of(OWN, [math.nan] * 3, back, SIGMA0) == NOT_SEEN
    assert not NOT_SEEN.matters(0.1)


@pytest.mark.parametrize("positive", [True, False])
def test_the_length_is_read_off_a_ramp(
    slide_level_of: SlideLevelOf, reference_model: Model, positive: bool
) -> None:
    """The bristle under a torque ramp, by its closed form: s = −λ ln(1 − (T − σ1/σ0 r)/T_∞)."""
    f = reference_model.friction
    level, shift, rate = 0.09, 0.016, 0.1
    most = level + (shift if positive else -shift)
    time = np.arange(0.0, 0.98 * most / rate, 1e-3)
    torque = rate * time + f.sigma1_nm_s_per_rad / f.sigma0_nm_per_rad * rate
    way = -level / f.sigma0_nm_per_rad * np.log1p(-rate * time / most)
    slide_s = np.arange(1, 400) * 1e-3
    torque = np.concatenate([torque, np.full(len(slide_s), most + f.viscous_pos_nm_s_per_rad * 2)])
    speed = np.concatenate([np.gradient(way, 1e-3), np.full(len(slide_s), 2.0)])
    way = np.concatenate([way, way[-1] + 2.0 * slide_s])
    slide = Slide(1e-3, torque, speed, way, np.zeros(len(way)))
    found = slide_level_of(slide, reference_model, positive, most)
    assert found is not None
    assert found.bent_rad == pytest.approx(level / f.sigma0_nm_per_rad, rel=0.03)


@given(before=levels_of_gears, force_n=st.floats(-200.0, 200.0), warm=st.floats(0.7, 1.3))
def test_a_force_moves_the_levels_apart_and_warmth_does_not(
    before: FrictionLevels, force_n: float, warm: float
) -> None:
    shift = force_n / RATIO
    pushed = FrictionLevels(before.positive_nm + shift, before.negative_nm - shift)
    told = force_that_explains_n(before, pushed, RATIO)
    if abs(shift) > 0.0401 * sum(before):
        assert told == pytest.approx(force_n)
    elif abs(shift) < 0.0399 * sum(before):
        assert told == 0.0
    ratio = max(before) / min(before)
    if ratio < 2.9:  # else even a common share moves them rather apart than alike
        warmer = FrictionLevels(*(level * warm for level in before))
        assert force_that_explains_n(before, warmer, RATIO) == 0.0
