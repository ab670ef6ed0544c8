"""Which friction levels the running estimator uses, who gave them, and what became of each offer.

Pure: no I/O, no clock. An offer (of the operator, or of a method that learns on line) is taken,
kept as a suggestion, or refused; each is an event for journal, bus and person. What is taken counts
from a grid point of sample time on, which the event names: given again in a replay, it reproduces
what was published bit for bit.
"""

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from eps_hil.adaptation.unknown_force import force_that_explains_n
from eps_hil.estimation.levels import FrictionLevels, LevelChange
from eps_hil.estimation.stream import StreamEstimator
from eps_hil.service.adaptation_config import AdaptationConfig
from eps_hil.service.online_methods import Known, OnlineMethod, Suggestion

_SOURCES = ("model", "operator", "reversals", "error_injection")
OPERATOR = "operator"
_FATES = {"suggested": 0, "agrees": 0, "learning": 0, "taken": 1, "refused": 2}


@dataclass(frozen=True, slots=True)
class LevelEvent:
    """What became of one offer; torques in Nm at the rotor.

    ``fate``: taken, suggested (not applied), agrees (with what is in use), learning (nothing sure
    yet) or refused. ``t_ns``: taken from this grid point on, else when it was offered, both in
    sample time. ``before``: what was being gone over to until then.
    """

    t_ns: int
    fate: str
    source: str
    levels: FrictionLevels
    before: FrictionLevels
    why: str = ""
    suggestion: Suggestion | None = None

    def as_json(self) -> dict[str, Any]:
        """One line of the journal."""
        line: dict[str, Any] = {"t_ns": self.t_ns, "levels": self.fate, "source": self.source}
        if self.why:
            line["why"] = self.why
        line |= _named(self.levels)
        line["before"] = _named(self.before)
        found = self.suggestion
        if found is not None:
            line |= {
                "known": found.known.name.lower(),
                "sum_std_nm": _number(found.sum_std_nm),
                "asymmetry_std_nm": _number(found.asymmetry_std_nm),
                "seen": found.seen,
            }
        return line

    def __str__(self) -> str:
        forth, back = self.levels
        why = f": {self.why}" if self.why else ""
        return f"{self.source} k0+ {forth:.4f}, k0- {back:.4f} Nm {self.fate}{why}"


def _named(levels: FrictionLevels) -> dict[str, float]:
    return {"offset_pos_nm": levels.positive_nm, "offset_neg_nm": levels.negative_nm}


def _number(value: float) -> float | None:
    return None if math.isnan(value) else value


class FrictionLevelKeeper:
    """One for each service; ``method`` None: only the operator gives levels."""

    def __init__(
        self, estimator: StreamEstimator, config: AdaptationConfig, method: OnlineMethod | None
    ) -> None:
        self.method, self.changes = method, 0
        self.last: Suggestion | None = None
        self.fate = "learning"
        """What became of the last suggestion."""
        self.source = _SOURCES[0]
        self._estimator, self._config = estimator, config
        self._accepted = self._goal = estimator.friction_levels
        self._later: deque[LevelChange] = deque()
        self._events: list[LevelEvent] = []

    def take_events(self) -> list[LevelEvent]:
        """What happened since the last call."""
        taken, self._events = self._events, []
        return taken

    def operator(self, levels: FrictionLevels, t_ns: int | None = None) -> None:
        """Levels that a person gave; taken from the next grid point on.

        ``t_ns``: of the journal, for a replay: taken at the point at which they were. Refused where
        they are impossible, or beyond the sanity band: who means it restarts.
        """
        if t_ns is not None and t_ns > self._grid_ns:
            self._later.append(LevelChange(t_ns, *levels))
            return
        why = self._outside(levels, self._accepted)
        if why:
            self._note("refused", OPERATOR, levels, None, f"{why}; restart to take them anyway")
            return
        if self._take(OPERATOR, levels, None).fate == "taken":
            self._accepted = levels
            if self.method is not None:
                self.method.restart(levels)

    def advance(self, t_ns: int) -> None:
        """A sync frame, after the estimator stepped on it."""
        found = None if self.method is None else self.method.advance(t_ns)
        if found is not None:
            self.last = found
            self.fate = self._judge(found).fate
        while self._later and self._later[0].t_ns <= self._grid_ns:
            self.operator(self._later.popleft().levels)

    @property
    def _grid_ns(self) -> int:
        """The grid point that the estimator takes next."""
        return int(self._estimator.memory.grid[0])

    def _judge(self, found: Suggestion) -> LevelEvent:
        config, levels = self._config, found.levels
        if found.known is Known.NOTHING:
            return self._note("learning", found.method, levels, found.t_ns, "", found)
        why = self._outside(levels, self._accepted)
        if why:
            return self._note("refused", found.method, levels, found.t_ns, why, found)
        total, own = sum(levels), sum(self._goal)
        moved = max(abs(a - b) for a, b in zip(levels, self._goal, strict=True))
        off = abs(total - own) if found.known is Known.SUM else moved
        if off <= config.least_change * own:
            return self._note("agrees", found.method, levels, found.t_ns, "", found)
        if config.apply == "never":
            why = "adaptation.apply is never"
        elif config.apply == "both_known" and found.known is Known.SUM:
            why = "only the sum of both is known"
        why = why or self._explained(found)
        if why:
            return self._note("suggested", found.method, levels, found.t_ns, why, found)
        return self._take(found.method, levels, found)

    def _explained(self, found: Suggestion) -> str:
        """Error injection takes the rack force as zero; whether one explains what it found."""
        if found.method != "error_injection":
            return ""
        ratio = self._estimator.constants.ratio
        force_n = force_that_explains_n(self._accepted, found.levels, ratio)
        return f"a rack force of about {force_n:.0f} N would explain it too" if force_n else ""

    def _outside(self, levels: FrictionLevels, accepted: FrictionLevels) -> str:
        band = self._config.sanity_band
        if not all(math.isfinite(level) and level >= 0.0 for level in levels):
            return "no friction levels"
        if all(abs(n - a) <= band * a for n, a in zip(levels, accepted, strict=True)):
            return ""
        return f"more than {band:.0%} from the accepted {accepted[0]:.4f}, {accepted[1]:.4f} Nm"

    def _take(self, source: str, levels: FrictionLevels, found: Suggestion | None) -> LevelEvent:
        try:
            change = self._estimator.set_friction_levels(levels)
        except ValueError as error:
            return self._note("refused", source, levels, None, str(error), found)
        event = self._note("taken", source, levels, change.t_ns, "", found)
        self._goal, self.source = levels, source
        self.changes += 1
        return event

    def _note(
        self,
        fate: str,
        source: str,
        levels: FrictionLevels,
        t_ns: int | None,
        why: str,
        found: Suggestion | None = None,
    ) -> LevelEvent:
        at = self._grid_ns if t_ns is None else t_ns
        event = LevelEvent(at, fate, source, levels, self._goal, why, found)
        self._events.append(event)
        return event

    def level_values(self) -> Mapping[str, float]:
        """Signals of ``EPSHIL_FrictionLevels``: what is in use at this moment."""
        now = self._estimator.friction_levels
        return {
            "LevelPositive": now.positive_nm,
            "LevelNegative": now.negative_nm,
            "LevelSource": _SOURCES.index(self.source),
            "LevelChanges": self.changes,
        }

    def suggestion_values(self) -> Mapping[str, float]:
        """Signals of ``EPSHIL_FrictionSuggestion``; no values where nothing was found yet."""
        found = self.last
        if found is None:
            return {"SuggestionKnown": Known.NOTHING, "SuggestionFate": 0}
        return {
            "SuggestedPositive": found.levels.positive_nm,
            "SuggestedNegative": found.levels.negative_nm,
            "SumDeviation": found.sum_std_nm,
            "AsymmetryDeviation": found.asymmetry_std_nm,
            "SuggestionKnown": int(found.known),
            "SuggestionFate": _FATES[self.fate],
        }
