"""The ``adaptation:`` block: whether, and how, the running service adapts its friction levels."""

from dataclasses import dataclass, field
from typing import Annotated, Literal

from pydantic import ConfigDict, Field, with_config

from eps_hil.adaptation.error_injection import ErrorInjectionSettings
from eps_hil.adaptation.reversal import ReversalSettings
from eps_hil.bus.config import NAME

Method = Literal["none", "reversals", "error_injection"]
Apply = Literal["never", "both_known", "sum_known"]

SANITY_BAND = 0.5
"""Share of the last accepted level beyond which new levels are refused."""


@with_config(ConfigDict(extra="forbid"))
@dataclass(frozen=True, slots=True)
class AdaptationConfig:
    """Without this block nothing adapts and nothing about levels is published.

    ``method``: what learns while the service runs. ``apply``: ``never`` (the default) only
    publishes and records what was found; ``both_known`` takes levels over where k0+ and k0− were
    each seen; ``sum_known`` also where only their sum was (their difference is then a guess).
    ``sanity_band``: about the last accepted calibration, which is the model file's, or what the
    operator gave. ``least_change``: of the sum, as a share, that is worth taking over.
    ``error_sliding_s``: sliding time each way before error injection is believed.
    """

    method: Method = "none"
    apply: Apply = "never"
    sanity_band: Annotated[float, Field(gt=0, le=1)] = SANITY_BAND
    least_change: Annotated[float, Field(ge=0, le=1)] = 0.02
    error_sliding_s: Annotated[float, Field(gt=0, le=600)] = 5.0
    message: NAME | None = "EPSHIL_FrictionLevels"
    suggestion_message: NAME | None = "EPSHIL_FrictionSuggestion"
    period_s: Annotated[float, Field(gt=0, le=60)] = 0.1
    reversals: ReversalSettings = field(default_factory=ReversalSettings)
    error_injection: ErrorInjectionSettings = field(default_factory=ErrorInjectionSettings)
