"""The usual step of a signal, also of one that is too long to be looked at whole."""

import numpy as np
import pytest

from eps_hil import series
from eps_hil.series import usual_step_ns


def test_it_is_the_median_of_all_steps_of_a_short_signal() -> None:
    steps = np.random.default_rng(3).integers(900_000, 1_100_000, 10_000)
    t_ns = np.concatenate([[5], 5 + np.cumsum(steps)])
    assert usual_step_ns(t_ns) == np.median(steps)


def test_a_long_signal_is_sampled_over_its_whole_length(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(series, "_STEPS", 1000)
    early, late = np.full(4_000, 1_000_000), np.full(6_001, 2_000_000)
    t_ns = np.concatenate([[0], np.cumsum(np.concatenate([early, late]))])
    assert usual_step_ns(t_ns) == 2_000_000
    assert usual_step_ns(t_ns[:7_000]) == 1_000_000
