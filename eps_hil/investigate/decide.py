"""What comes next: an experiment, or the end and why."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from eps_hil.investigate.experiment import Experiment
from eps_hil.investigate.possible import Choice, Possible, explained_in_part

_UNNAMED_ROUNDS = 3
"""So often is what has no name looked at from elsewhere before it is left at that."""


class Stop(StrEnum):
    """Why an investigation ends."""

    SETTLED = "settled"
    BUDGET = "budget"
    NOTHING_MORE = "nothing_more"


@dataclass(frozen=True)
class Decision:
    """``choices``: the next experiment first, then what else there was; or ``stop``."""

    choices: Sequence[Choice]
    stop: Stop | None
    why: str


def decide(
    possible: Possible,
    before: Sequence[Mapping[str, Any]],
    done: Sequence[Experiment],
    left_s: float,
) -> Decision:
    """``before``: contents of the rounds so far; ``left_s`` of the budget."""
    steady = _steady(possible, before)
    ended = _ended(possible, before) if steady else None
    if ended is not None:
        return ended
    choices = possible.choices(done, fresh=False)
    why = "tells most a minute of what is open"
    if not choices and steady and not (possible.rivals or possible.in_part):
        return Decision((), Stop.NOTHING_MORE, "no experiment within the limits tells more")
    if not choices or possible.in_part or (possible.found is None and done):
        choices = possible.choices(done, fresh=True)
        why = "looks again from elsewhere: " + _reason(possible)
    fitting = [one for one in choices if 60.0 * one.minutes <= left_s]
    if fitting:
        return Decision(fitting, None, why)
    if choices:
        return Decision((), Stop.BUDGET, "the rest of the budget is shorter than an experiment")
    return Decision((), Stop.NOTHING_MORE, "every experiment within the limits has been run")


def _ended(possible: Possible, before: Sequence[Mapping[str, Any]]) -> Decision | None:
    """The end where names and verdict stand, None where something is open."""
    if possible.in_part and _in_part_for(before) >= _UNNAMED_ROUNDS:
        why = "what was found does not explain all, and other motions do not change that"
        if possible.unnamed:
            why = "the residual has no name, and other motions do not give it one"
        return Decision((), Stop.NOTHING_MORE, why)
    if not possible.answered:
        return None
    if possible.same:
        pairs = ", ".join(f"{one.entry['effect']} and {one.rival}" for one in possible.same)
        why = f"no experiment within the limits tells apart: {pairs}"
        return Decision((), Stop.NOTHING_MORE, why)
    return Decision((), Stop.SETTLED, "nothing is open, and the last experiment changed nothing")


def _steady(possible: Possible, before: Sequence[Mapping[str, Any]]) -> bool:
    """Whether the last experiment left names and verdict as they were."""
    if possible.found is None or not before or before[-1]["verdict"] is None:
        return False
    last = before[-1]
    names = sorted(one["effect"] for one in last["findings"])
    same = last["verdict"] == possible.found.content["verdict"]
    return same and tuple(names) == possible.names


def _in_part_for(before: Sequence[Mapping[str, Any]]) -> int:
    """Rounds in succession, up to the last, in which not all was explained."""
    count = 0
    for one in reversed(before):
        if not explained_in_part(one):
            break
        count += 1
    return count


def _reason(possible: Possible) -> str:
    """Why it looks again."""
    if possible.unnamed:
        return "part of the residual has no name"
    if possible.in_part:
        return "the hold-outs do not bear out what was found"
    return "the names have to stand"
