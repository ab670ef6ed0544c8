"""A hold-out that only repeats what was fitted confirms the programme as well as physics."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from eps_hil.diagnosis.data.prepare import prepare
from eps_hil.diagnosis.data.repeated import repeated


def test_the_same_programme_again_and_another_one(record: Callable[..., Any]) -> None:
    made = record({}, ("sweep", "weave"), seconds=12.0)
    sweep, weave = (prepare(name, one) for name, one in made.items())
    rng = np.random.default_rng(1)
    speed = sweep.raw["motor_speed_rad_s"]
    later = np.concatenate([np.zeros(300), speed])[: len(speed)]
    noisy = later + rng.normal(0.0, 0.02 * np.std(speed), len(speed))
    again = replace(sweep, raw={**sweep.raw, "motor_speed_rad_s": noisy}, _shifted={})
    assert repeated([sweep, weave], [again])
    assert not repeated([sweep], [weave])
    assert not repeated([sweep], [again, weave])
