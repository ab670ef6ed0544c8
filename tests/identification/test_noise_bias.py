"""What noise does to a fit is taken back, and never out of the physics."""

from dataclasses import replace

import numpy as np
import pytest

from eps_hil.identification.least_squares import Fit
from eps_hil.identification.noise_bias import EXTRA, _taken_back
from eps_hil.identification.state import Parameter, State, get, put
from eps_hil.physics.model import Model


def fits(model: Model, value: float, noisy: float, sigma: float) -> tuple[Fit, Fit]:
    parameter = Parameter("inertia_kg_m2", "kg m²", 1e-4, 0.0)
    state = State(replace(model, inertia_kg_m2=value))
    fit = Fit(state, (parameter,), np.array([[sigma**2]]), (), 5)
    return fit, replace(fit, state=put(state, "inertia_kg_m2", noisy))


def test_a_small_bias_is_taken_back(reference_model: Model) -> None:
    fit, moved = fits(reference_model, 2.0e-4, 1.98e-4, 1e-6)
    found = get(_taken_back(fit, moved).state, "inertia_kg_m2")
    assert found == pytest.approx(2.0e-4 + 0.02e-4 / EXTRA, rel=1e-3)


def test_an_inertia_that_noise_says_little_of_stays_one(reference_model: Model) -> None:
    """A fit of little motion: its deviation is many times its value, and noise tripled it."""
    fit, moved = fits(reference_model, 1.0e-6, 5.0e-6, 1e-4)
    assert 0.0 < get(_taken_back(fit, moved).state, "inertia_kg_m2") < 1.0e-6
