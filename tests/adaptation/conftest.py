"""A rig in closed loop with an injection, millisecond by millisecond, without a bus."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from eps_hil.adaptation.gates import InjectionInputs
from eps_hil.adaptation.slide import Slide, SlideLevel, slide_level
from eps_hil.adaptation.torque_injection import InjectionCommand, TorqueInjection
from eps_hil.physics.chain_parameters import load_chain
from eps_hil.physics.model import Model
from eps_hil.rig.manoeuvre import Driver, Manoeuvre, Segment
from eps_hil.rig.plant import TRUE_SIGNALS, Plant
from eps_hil.rig.sensors import REPORTED, Sensors, SensorSettings

CONFIGS = Path(__file__).parents[2] / "configs"

HANDS_OFF = Segment()
HANDS_ON = Segment(driver=Driver(stiffness_nm_per_rad=60.0, damping_nm_s_per_rad=2.0))

Change = Callable[[int, InjectionInputs], InjectionInputs]


@dataclass
class Run:
    """One closed loop: the injection after it, all commands, and what really happened."""

    injection: TorqueInjection
    commands: list[InjectionCommand]
    truth: np.ndarray[tuple[int, ...], np.dtype[np.float64]]

    def column(self, name: str) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
        return self.truth[:, TRUE_SIGNALS.index(name)]


class Bench:
    """Five masses, steering wheel and sensors; the override takes the ECU's place."""

    def __init__(self, model: Model) -> None:
        self.model = model
        self._chain = load_chain(CONFIGS / "reference_chain.yaml")

    def run(
        self,
        injection: TorqueInjection,
        segment: Segment = HANDS_OFF,
        *,
        seconds: float = 60.0,
        seed: int = 0,
        change: Change = lambda _k, inputs: inputs,
    ) -> Run:
        """Until the injection is over, or ``seconds``; ``change`` spoils what it is told."""
        manoeuvre = Manoeuvre("bench", (replace(segment, duration_s=seconds),))
        plant = Plant(self.model, self._chain, 5, manoeuvre.table())
        sensors = Sensors(self.model, SensorSettings(), seed)
        truth, reported = np.zeros(len(TRUE_SIGNALS)), np.zeros(len(REPORTED))
        commands: list[InjectionCommand] = []
        rows = []
        names = [name for name in InjectionInputs._fields if name != "rack_force_n"]
        for k in range(round(seconds * 1000)):
            active = bool(commands) and commands[-1].active
            plant.step(truth, commands[-1].torque_nm if active else None)
            sensors.step(truth, reported)
            values = dict(zip(REPORTED, reported.tolist(), strict=True))
            inputs = change(k, InjectionInputs(**{name: values[name] for name in names}))
            commands.append(injection.step(k * 1_000_000, inputs))
            rows.append(truth.copy())
            if injection.phase.over:
                break
        return Run(injection, commands, np.array(rows))


def with_levels(model: Model, positive: float, negative: float) -> Model:
    """The model with both friction offsets scaled."""
    friction = replace(
        model.friction,
        offset_pos_nm=model.friction.offset_pos_nm * positive,
        offset_neg_nm=model.friction.offset_neg_nm * negative,
    )
    return replace(model, friction=friction)


@pytest.fixture(scope="session")
def bench() -> Callable[..., Bench]:
    return Bench


@pytest.fixture(scope="session")
def scaled_levels() -> Callable[[Model, float, float], Model]:
    return with_levels


@pytest.fixture(scope="session")
def hands() -> dict[str, Segment]:
    return {"off": HANDS_OFF, "on": HANDS_ON}


SlideLevelOf = Callable[[Slide, Model, bool, float], SlideLevel | None]


def _level(slide: Slide, model: Model, positive: bool, guess_nm: float) -> SlideLevel | None:
    pieces = slide_level(slide, model, positive=positive, guess_nm=guess_nm)
    while True:
        try:
            next(pieces)
        except StopIteration as end:
            return end.value


@pytest.fixture(scope="session")
def slide_level_of() -> SlideLevelOf:
    """The level of a slide, all pieces of the sum at once."""
    return _level
