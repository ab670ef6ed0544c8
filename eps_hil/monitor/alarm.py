"""When rig and model part: a limit that has to be exceeded for a time, with hysteresis."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

from eps_hil.physics.effects.catalogue import with_model_effects
from eps_hil.physics.model import Model

MOVING_SHARE, RESTING_SHARE, BALANCE_SHARE = 0.35, 1.0, 0.2
"""Of the model's mean friction level. In motion friction is compensated, so a third of it wrong
is a wrong model; at rest the bristle may hold any torque up to the level; the torque balance is
judged where the rotor slides, and there it is the best known of the three."""
_LEAST_N = 25.0
"""No limit below what an estimate is good for on a rig (some 20 N rms)."""
CLEAR_SHARE = 0.7
"""An alarm ends below so much of its limit."""


@dataclass(frozen=True, slots=True)
class Limits:
    """Rms in N at the rack, over the window, beyond which rig and model part."""

    moving_n: float
    resting_n: float
    balance_n: float
    after_s: float = 6.0
    """How long a limit has to be exceeded, and how long it has to be kept for the all-clear."""

    def of(self, name: str) -> float:
        """The limit of one residual."""
        found = {"moving": self.moving_n, "at rest": self.resting_n}
        return found.get(name, self.balance_n)


def friction_at_rack_n(model: Model) -> float:
    """Mean of the friction levels k0+ and k0− of a model, effects worked in, in N at the rack."""
    worked_in = with_model_effects(model)
    friction = worked_in.friction
    mean_nm = 0.5 * (friction.offset_pos_nm + friction.offset_neg_nm)
    return mean_nm * worked_in.rack_to_rotor_ratio_rad_per_m


def limits_of(
    model: Model,
    moving_n: float | None = None,
    resting_n: float | None = None,
    balance_n: float | None = None,
    after_s: float = 6.0,
) -> Limits:
    """Given limits, and for those that are None a share of the model's own friction."""
    friction_n = friction_at_rack_n(model)
    given = (moving_n, resting_n, balance_n)
    shares = (MOVING_SHARE, RESTING_SHARE, BALANCE_SHARE)
    chosen = [
        max(share * friction_n, _LEAST_N) if limit is None else limit
        for limit, share in zip(given, shares, strict=True)
    ]
    return Limits(chosen[0], chosen[1], chosen[2], after_s)


class Alarm:
    """Of one residual. Where there is no figure (nothing moves, nothing valid) it stays as it is.

    ``since_ns``: when the limit was first exceeded (or, while the alarm is on, first kept), None
    where it is not.
    """

    def __init__(self, limit_n: float, after_s: float) -> None:
        self.limit_n, self._after_ns = limit_n, round(after_s * 1e9)
        self.on = False
        self.since_ns: int | None = None

    def update(self, now_ns: int, rms_n: float | None) -> bool:
        """Take the newest figure; True when the alarm has just gone on or off."""
        if rms_n is None or math.isnan(rms_n):
            self.since_ns = None  # a time that was not watched does not count
            return False
        other = rms_n < CLEAR_SHARE * self.limit_n if self.on else rms_n > self.limit_n
        if not other:
            self.since_ns = None
            return False
        if self.since_ns is None or now_ns < self.since_ns:  # the clock was set back
            self.since_ns = now_ns
        if now_ns - self.since_ns < self._after_ns:
            return False
        self.on, self.since_ns = not self.on, None
        return True


class Alarms:
    """One for each residual that there is."""

    def __init__(self, limits: Limits) -> None:
        self.limits = limits
        names = ("moving", "at rest", "torque balance")
        self._alarms = {name: Alarm(limits.of(name), limits.after_s) for name in names}

    def update(self, now_ns: int, rms_n: Mapping[str, float | None]) -> list[tuple[str, bool]]:
        """(name, on) of those that changed."""
        return [
            (name, alarm.on)
            for name, alarm in self._alarms.items()
            if alarm.update(now_ns, rms_n.get(name))
        ]

    @property
    def on(self) -> tuple[str, ...]:
        """Names of the alarms that are on."""
        return tuple(name for name, alarm in self._alarms.items() if alarm.on)

    @property
    def pending(self) -> tuple[str, ...]:
        """Names of those beyond their limit, not for long enough yet."""
        return tuple(n for n, a in self._alarms.items() if not a.on and a.since_ns is not None)
