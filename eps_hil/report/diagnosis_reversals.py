"""What a bristle's stiffness is drawn from: the torque left about full reversals."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from eps_hil.diagnosis.balance.fit import BRISTLE
from eps_hil.diagnosis.data.prepare import STEP_S, THIN, Floats, Prepared
from eps_hil.diagnosis.direct.reversals import FEWEST_KEPT, HALF_WINDOW_S, about_reversals
from eps_hil.diagnosis.given_load import Diagnosis
from eps_hil.physics.effects.catalogue import with_model_effects
from eps_hil.physics.model import Model
from eps_hil.report.plots import Line, Plot

_STEP_S = THIN * STEP_S
"""Between drawn means: every reversal has one sample in each."""
_FEWEST = 5
"""Samples that a drawn mean needs."""


def figure(diagnosis: Diagnosis) -> Plot | None:
    """Mean over the full reversals of all recordings with and without the stiffness found.

    In the form, LuGre's or Masing's, that leaves less with the finding. None where they are few.
    """
    model = diagnosis.model
    others = tuple(one for one in model.effects if one["effect"] != BRISTLE)
    without = with_model_effects(replace(model, effects=others))
    recordings = [*diagnosis.problem.recordings, *(one.prepared for one in diagnosis.judged)]
    after, masing = _better(recordings, with_model_effects(model))
    before = about_reversals(recordings, without, masing)
    if before[2] < FEWEST_KEPT:
        return None
    return _drawn(before, after, _noise(recordings, without, before[2]))


Turns = tuple[Floats, Floats, int]


def _better(recordings: Sequence[Prepared], model: Model) -> tuple[Turns, bool]:
    both = [(about_reversals(recordings, model, masing), masing) for masing in (False, True)]
    return min(both, key=lambda one: float(np.sum(one[0][1] ** 2)))


def _noise(recordings: Sequence[Prepared], model: Model, count: int) -> float:
    """Of a mean over so many reversals, Nm."""
    floor = np.sqrt(np.mean([one.floor_nm(model) ** 2 for one in recordings]))
    return float(floor / np.sqrt(count))


def _drawn(before: Turns, after: Turns, noise_nm: float) -> Plot:
    edges = np.arange(-HALF_WINDOW_S, HALF_WINDOW_S + _STEP_S, _STEP_S)
    centre = 0.5 * (edges[1:] + edges[:-1])

    def mean(turns: Turns) -> Floats:
        seconds, torque_nm, _ = turns
        place = np.digitize(seconds, edges) - 1
        rows = [torque_nm[place == k] for k in range(len(centre))]
        return np.array([1e3 * np.mean(row) if len(row) >= _FEWEST else np.nan for row in rows])

    half = np.full(len(centre), 2e3 * noise_nm)
    lines = [
        Line("sensor noise, ±2σ", "edge", -half),
        Line("", "edge", half, band_below=True),
        Line(f"baseline model, mean of {before[2]} reversals", "before", mean(before)),
        Line("with this finding", "after", mean(after)),
    ]
    x_label = "time since the rotor turned round in ms"
    return Plot("reversals", x_label, "torque residual, mNm", 1e3 * centre, lines, height=260)
