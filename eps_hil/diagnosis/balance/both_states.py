"""Recordings of two states of one rig in one balance: what they share is fitted once.

Entries act in one of the states only, so each is judged by what tells the states apart. The
model's own numbers and a discrepancy (``discrepancy.py``) are common to both: whatever has no name
and has not changed is in both alike, and cannot stand in for a change, nor a change for it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.balance.problem import Problem
from eps_hil.diagnosis.data.prepare import Prepared
from eps_hil.physics.model import Model

Floats = npt.NDArray[np.float64]

_KEPT = 64
"""Residuals of the known state that are remembered: entries leave them as they are."""


@dataclass(frozen=True, slots=True)
class ModelOfBoth(Model):
    """The model of the state that entries act in; ``known``: of the other one."""

    known: Model | None = None


@dataclass
class BothStates(Problem):
    """A problem whose entries are not in the model of the recordings named ``known``."""

    known: frozenset[str] = frozenset()
    _seen: list[tuple[Prepared, Model, Floats]] = field(
        init=False, repr=False, compare=False, default_factory=list
    )

    def with_entries(
        self, entries: Sequence[Mapping[str, Any]], own: Mapping[str, float] | None = None
    ) -> Model:
        """As of any problem, the known state's model beside it."""
        with_them = super().with_entries(entries, own)
        known = super().with_entries([], own) if entries else with_them
        return ModelOfBoth(**_numbers(with_them), known=known)

    def left(self, one: Prepared, model: Model, noise_of: Model | None = None) -> Floats:
        """Of one recording, under the model of its state."""
        if noise_of is not None:
            return super().left(one, self.state_of(one, model), self.state_of(one, noise_of))
        if not isinstance(model, ModelOfBoth) or model.known is None:
            return super().left(one, model)
        if one.name not in self.known:
            return super().left(one, one_state(model))
        for recording, then, left in self._seen:
            if recording is one and then == model.known:
                return left
        left = super().left(one, model.known)
        self._seen.append((one, model.known, left))
        del self._seen[:-_KEPT]
        return left

    def state_of(self, one: Prepared, model: Model) -> Model:
        """The known state's model for its recordings."""
        if isinstance(model, ModelOfBoth) and model.known is not None and one.name in self.known:
            return model.known
        return one_state(model)

    def weigh(self, model: Model) -> bool:
        """As of any problem; what was remembered goes by what was weighed before."""
        self._seen.clear()
        return super().weigh(model)

    def in_known(self) -> npt.NDArray[np.bool_]:
        """Samples (n,) of the known state."""
        parts = [np.full(len(one.thin_time_s), one.name in self.known) for one in self.recordings]
        return np.concatenate(parts)


def one_state(model: Model) -> Model:
    """The model of the state with the entries, as a file holds it."""
    return Model(**_numbers(model)) if isinstance(model, ModelOfBoth) else model


def _numbers(model: Model) -> dict[str, Any]:
    return {one.name: getattr(model, one.name) for one in fields(Model)}
