"""Reversal adaptation and error injection beside the running estimator: samples in, levels out.

Both see what the decoder yields and nothing else, and step on sample time, so a replay finds the
same at the same instants. What a stretch of driving costs to evaluate is spread over many
milliseconds (``adaptation/reversal.py``, sliced).
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from enum import IntEnum
from typing import NamedTuple, Protocol

from eps_hil.adaptation.error_injection import ErrorInjection, ErrorInjectionSettings
from eps_hil.adaptation.gates import InjectionInputs
from eps_hil.adaptation.reversal import ReversalAdaptation, ReversalState
from eps_hil.estimation.aligned_rows import AlignedRows
from eps_hil.estimation.levels import FrictionLevels
from eps_hil.estimation.settings import EstimatorSettings
from eps_hil.estimation.setup import STEP_NS
from eps_hil.physics.model import Model
from eps_hil.service.adaptation_config import AdaptationConfig
from eps_hil.service.latest import LatestValues

_SLICE_EVERY = 4
"""One slice of an evaluation in so many milliseconds: a late loop catches up in between."""
_LOOK_NS = 1_000_000_000


class Known(IntEnum):
    """What was seen of the levels."""

    NOTHING = 0
    SUM = 1
    BOTH = 2


class Suggestion(NamedTuple):
    """Levels that a method found by ``t_ns`` of sample time, and how sure it is.

    ``sum_std_nm``, ``asymmetry_std_nm``: standard deviations of k0+ ± k0− (NaN: the method has
    none); ``seen``: reversals, or seconds of sliding in the direction that has less.
    """

    t_ns: int
    method: str
    levels: FrictionLevels
    sum_std_nm: float
    asymmetry_std_nm: float
    known: Known
    seen: float


class OnlineMethod(Protocol):
    """What the service needs of either."""

    def take(self, signal: str, t_ns: int, value: float) -> None:
        """A decoded sample."""

    def advance(self, t_ns: int) -> Suggestion | None:
        """A sync frame; a suggestion where there is a new one."""

    def restart(self, levels: FrictionLevels) -> None:
        """Begin anew from levels that somebody else has found."""

    def warm_up(self) -> None:
        """Compile all machine code, on a twin."""


def with_levels(model: Model, levels: FrictionLevels) -> Model:
    """The model with other k0±."""
    friction = replace(
        model.friction, offset_pos_nm=levels.positive_nm, offset_neg_nm=levels.negative_nm
    )
    return replace(model, friction=friction)


class OnlineReversals:
    """:class:`ReversalAdaptation` on the estimator's grid; ``ValueError`` for missing signals."""

    def __init__(
        self,
        config: AdaptationConfig,
        model: Model,
        settings: EstimatorSettings,
        periods_s: Mapping[str, float],
    ) -> None:
        self._settings, self._model = config.reversals, model
        self._periods_s, self._estimator_settings = periods_s, settings
        self._rows = AlignedRows(model, settings, periods_s)
        self._to_rotor, self._sensor = model.sensor_to_rotor, "torque_sensor_nm" in periods_s
        self._turn = 0
        self.restart(FrictionLevels(model.friction.offset_pos_nm, model.friction.offset_neg_nm))

    def restart(self, levels: FrictionLevels) -> None:
        """See :class:`OnlineMethod`."""
        model = with_levels(self._model, levels)
        self._adaptation = ReversalAdaptation(self._settings, model, sliced=True)

    def take(self, signal: str, t_ns: int, value: float) -> None:
        """See :class:`OnlineMethod`."""
        self._rows.push(signal, t_ns, value)

    def advance(self, t_ns: int) -> Suggestion | None:
        """See :class:`OnlineMethod`."""
        adaptation, found = self._adaptation, None
        for at_ns, (motor, sensor, speed, angle, force) in self._rows.rows(
            self._rows.advance(t_ns)
        ):
            torque = motor + self._to_rotor * (sensor if self._sensor else 0.0)
            adaptation.take(at_ns, torque, speed, angle, force)
            self._turn = (self._turn + 1) % _SLICE_EVERY
            state = adaptation.work() if self._turn == 0 else None
            found = found if state is None else _suggested(state, t_ns)
        return found

    def warm_up(self) -> None:
        """See :class:`OnlineMethod`."""
        rows = AlignedRows(self._model, self._estimator_settings, self._periods_s)
        rows.push("motor_torque_nm", 0, 0.0)
        rows.advance(0)
        shortest = replace(self._settings, stretch_s=1.0)
        twin = ReversalAdaptation(shortest, self._model, sliced=True)
        for k in range(round(1e3 * (shortest.stretch_s + shortest.lead_s))):
            twin.take(k * STEP_NS, 0.1, 10.0, 0.01 * k, 0.0)
        while twin.work() is None:
            pass


def _suggested(state: ReversalState, t_ns: int) -> Suggestion:
    known = Known.NOTHING
    if state.confident:
        known = Known.BOTH if state.asymmetry_known else Known.SUM
    return Suggestion(
        t_ns, "reversals", state.levels, state.sum_std_nm, state.asymmetry_std_nm, known, state.used
    )


class OnlineErrorInjection:
    """:class:`ErrorInjection` at every sync frame; a suggestion once a second."""

    def __init__(
        self, config: AdaptationConfig, model: Model, periods_s: Mapping[str, float]
    ) -> None:
        self._config, self._model = config, model
        self._latest = LatestValues(periods_s)
        self._due_ns: int | None = None
        self.restart(FrictionLevels(model.friction.offset_pos_nm, model.friction.offset_neg_nm))

    def restart(self, levels: FrictionLevels) -> None:
        """See :class:`OnlineMethod`."""
        model = with_levels(self._model, levels)
        self._injection = ErrorInjection(self._config.error_injection, model)

    def take(self, signal: str, t_ns: int, value: float) -> None:
        """See :class:`OnlineMethod`."""
        self._latest.take(signal, t_ns, value)

    def advance(self, t_ns: int) -> Suggestion | None:
        """See :class:`OnlineMethod`."""
        state = self._injection.step(t_ns, newest(self._latest.at(t_ns)))
        if self._due_ns is None or abs(t_ns - self._due_ns) > 2 * _LOOK_NS:
            self._due_ns = t_ns + _LOOK_NS
        if t_ns < self._due_ns:
            return None
        self._due_ns += _LOOK_NS
        seen = min(state.time_pos_s, state.time_neg_s)
        enough = seen >= self._config.error_sliding_s and not state.at_limit
        known = Known.BOTH if enough else Known.NOTHING
        nan = math.nan
        return Suggestion(t_ns, "error_injection", state.levels, nan, nan, known, seen)

    def warm_up(self) -> None:
        """See :class:`OnlineMethod`."""
        warm_up_error_injection(self._config.error_injection, self._model)


def warm_up_error_injection(settings: ErrorInjectionSettings, model: Model) -> None:
    """Compile what :class:`ErrorInjection` calls."""
    twin = ErrorInjection(settings, model)
    for k in range(20):
        twin.step(k * STEP_NS, InjectionInputs(0.1, 10.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))


def newest(values: Mapping[str, float]) -> InjectionInputs:
    """The newest values in the order of the adaptation; NaN for what is not there."""
    return InjectionInputs(*(values.get(name, math.nan) for name in InjectionInputs._fields))
