"""Rotor and rack apart without a name: a curve of next to nothing is none."""

from dataclasses import replace

import numpy as np
import pytest

from eps_hil.diagnosis.direct import separation
from eps_hil.diagnosis.direct.separation import Separation


@pytest.mark.parametrize("share", [0.0007, 0.04])
def test_a_curve_of_next_to_nothing_does_not_stand_for_the_clear_one(
    monkeypatch: pytest.MonkeyPatch, share: float
) -> None:
    """Without any name it leaves hardly less, which is no reason to tell it."""
    clear = Separation("rack_force_n", ((0.0, 1e-3, 0.0), (1.0, 2e-3, 0.0)), 0.3, 1000.0)
    drawn = iter([clear, replace(clear, share=share)])
    monkeypatch.setattr(separation, "_best", lambda *_all: next(drawn))
    monkeypatch.setattr(separation, "solved", lambda *_all: ({}, np.full(1000, 2.0)))
    assert separation.separation([], [], []) is clear
