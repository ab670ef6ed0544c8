"""Two states of one rig: what they share, and one effect that only one of them has (issue 24)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from eps_hil.proof import cases
from eps_hil.proof.effects import find
from eps_hil.proof.programmes import programme
from eps_hil.proof.sensors import measured
from eps_hil.proof.truth import Floats
from eps_hil.proof.world import World

_KIND = 24
"""Of the seeds of this kind, apart from those of the other kinds."""

State = Mapping[str, Mapping[str, Floats]]


@dataclass(frozen=True, slots=True)
class TwoStates:
    """Recordings by name (canonical columns at 1 kHz) of a state without and with the change.

    ``reached``: the change's effect-to-noise ratio on the training of the state that has it; 0 for
    none.
    """

    without: State
    with_change: State
    reached: float


def two_states(
    seed: int, shared: Sequence[tuple[str, float]], change: tuple[str, float] | None
) -> TwoStates:
    """Both states under programmes and sensor noise of their own.

    ``shared`` and ``change``: ids with their ratio to the sensor noise. Strength and shape of what
    is shared are the same in both states. The change gets its ratio on the recordings that hold
    it: an end stop just within the travel of one programme lies outside that of another.
    """
    rng = np.random.default_rng([seed, _KIND])
    first, second = programme("training", rng), programme("training", rng)
    world, simple = World(False), World(True)
    noise = cases.usual_noise(world, first[:-1], rng)
    hidden = []
    asked = [(*one, first[:-1]) for one in shared]
    asked += [(*change, second[:-1])] if change else []
    for name, ratio, training in asked:
        effect = find(name)
        ground = world if effect.placed else simple
        base = cases.measure(ground, training, noise)
        hidden.append(cases.hide(ground, base, effect, ratio, training, rng, raw=effect.free))
    states = []
    for program, effects in ((first, hidden[: len(shared)]), (second, hidden)):
        changed = world
        for one in effects:
            changed = one.effect.apply(changed, one.strength, one.shape)
        noisy = [
            measured(cases.noiseless(changed, one), changed.instruments, rng) for one in program
        ]
        states.append(dict(zip(("train_1", "train_2", "holdout"), noisy, strict=True)))
    reached = hidden[-1].ratio if change else 0.0
    return TwoStates(states[0], states[1], reached)
