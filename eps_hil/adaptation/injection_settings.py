"""How a torque injection is done: ramp, detection, slide, repetitions, what is refused."""

from dataclasses import dataclass, field
from typing import Annotated

from pydantic import ConfigDict, Field, with_config

from eps_hil.adaptation.gates import GATES, GateSettings, NotNegative, Positive

Share = Annotated[float, Field(gt=0, lt=1)]


@with_config(ConfigDict(extra="forbid"))
@dataclass(frozen=True, slots=True)
class InjectionSettings:
    """Settings of :class:`~eps_hil.adaptation.torque_injection.TorqueInjection` (PAPER fig. 14).

    Torques, speeds and travel at the rotor, torsion-bar torque at the column. The torques stay
    below whatever the torque guard allows, or the guard ends the run.
    """

    ramp_nm_per_s: Positive = 0.1
    """Slow, so that little is to be corrected; 0.126 Nm then take 1.3 s."""
    max_torque_nm: Positive = 0.4
    """The ramp goes no further; no break-away until there is a failed repetition."""
    breakaway_speed_rad_s: Positive = 2.0
    """Speed set-point: faster than this (mean of 5 samples) the rack has broken away."""
    driver_torque_change_nm: Positive = 0.8
    """Hands on: a torsion-bar torque this far from its value at rest ends the ramp as well."""
    slide_rad: NotNegative = 0.6
    """How far the rotor slides at the set-point speed before the torque returns; 0 as in the paper.
    0.6 rad are 0.24 mm at the rack, more than ten presliding lengths."""
    slide_bandwidth_rad_s: Positive = 25.0
    """Bandwidth of the speed control during the slide."""
    slide_timeout_s: Positive = 1.5
    return_nm_per_s: Positive = 2.0
    """How fast the torque goes back to zero after a repetition."""
    abort_nm_per_s: Annotated[float, Field(ge=1, allow_inf_nan=False)] = 5.0
    """How fast it goes to zero when a gate opens: a hand may be in the wheel."""
    gates_hold_s: NotNegative = 0.5
    """All gates must have been met for this long before the first ramp; no shorter than any
    ``filter_s``, or the ramp begins before that low-pass has followed its signal."""
    rest_s: Positive = 0.3
    """Rest before each ramp, with zero torque: the bristle lets go, the torsion bar settles."""
    rest_speed_rad_s: Positive = 0.3
    """Slower than this (smoothed) counts as rest."""
    rest_timeout_s: Positive = 10.0
    repetitions: Annotated[int, Field(ge=1, le=50)] = 5
    """Good repetitions per direction; directions alternate, so the rack stays where it is."""
    failures_allowed: Annotated[int, Field(ge=0, le=50)] = 3
    """Repetitions without a slide before the run is given up."""
    outlier_share: Share = 0.15
    """A repetition further than this share from the median of its direction, and further than
    its scatter explains, is named an outlier and left out."""
    gap_s: Positive = 0.02
    """Samples further apart than this end the run: nothing is ramped on old values."""
    gates: GateSettings = field(default_factory=GateSettings)

    def __post_init__(self) -> None:
        """What one field alone does not show; ValueError by field."""
        for name in GATES:
            filter_s = getattr(self.gates, name).filter_s
            if filter_s > self.gates_hold_s:
                problem = f"gates.{name}.filter_s {filter_s} is longer than gates_hold_s"
                raise ValueError(f"{problem} {self.gates_hold_s}")
