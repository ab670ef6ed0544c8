"""A calibration written into a model file: new levels, old ones kept, and where they came from.

Comments and everything else in the file stay as they are; the history is a top-level block
``calibrations`` at its end, newest last. The sanity band is about the last accepted levels.

What is measured is the friction as it is, with all that the model's effects make of k0+ and k0−
(``coulomb_level``, ``friction_asymmetry``): the file gets the levels of which they make that.
"""

import re
from collections.abc import Collection
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import yaml

from eps_hil import yaml_file
from eps_hil.adaptation.unknown_force import NOT_SEEN, Shift, force_that_explains_n
from eps_hil.errors import EpsHilError, InputError
from eps_hil.estimation.levels import FrictionLevels
from eps_hil.physics.effects.catalogue import catalogue, with_model_effects
from eps_hil.physics.effects.effect import Slot
from eps_hil.physics.model import Model, load_model

_BLOCK = "calibrations"
_SIDES = ("offset_pos_nm", "offset_neg_nm")
_STEP_NM = 1e-3


@dataclass(frozen=True, slots=True)
class Levels:
    """k0+ and k0− (Nm at the rotor), with 95 % intervals where there are any."""

    offset_pos_nm: float
    offset_neg_nm: float
    pos_ci95_nm: tuple[float, float] | None = None
    neg_ci95_nm: tuple[float, float] | None = None


def widened(levels: Levels, torque_nm: float) -> Levels:
    """Intervals that also hold the levels as they are if ``torque_nm`` was a rack force's."""

    def wide(
        level_nm: float, ci95_nm: tuple[float, float] | None, other_nm: float
    ) -> tuple[float, float]:
        low, high = ci95_nm or (level_nm, level_nm)
        return min(low, low + other_nm), max(high, high + other_nm)

    return replace(
        levels,
        pos_ci95_nm=wide(levels.offset_pos_nm, levels.pos_ci95_nm, -torque_nm),
        neg_ci95_nm=wide(levels.offset_neg_nm, levels.neg_ci95_nm, torque_nm),
    )


def effects_in(model: Model, slots: Collection[Slot]) -> tuple[str, ...]:
    """Ids of the model's effects that act in one of the ``slots``."""
    found: dict[str, None] = {}
    for values in model.effects:
        effect = catalogue()[str(values["effect"])]
        if (effect.slot if effect.slot_of is None else effect.slot_of(values)) in slots:
            found[effect.id] = None
    return tuple(found)


def levels_in_use(model: Model) -> Levels:
    """k0+ and k0− with the model's effects worked in, as the estimator takes them."""
    friction = with_model_effects(model).friction
    return Levels(friction.offset_pos_nm, friction.offset_neg_nm)


def _without_block(text: str) -> str:
    """A model file's text without its history; what stands after that stays."""
    root = yaml.compose(text, Loader=yaml.SafeLoader)
    for key, value in root.value if isinstance(root, yaml.MappingNode) else ():
        if key.value == _BLOCK:
            begin, end = key.start_mark.index, value.end_mark.index
            lines = text[begin:end].splitlines(keepends=True)
            while len(lines) > 1 and lines[-1].strip()[:1] in ("", "#"):
                end -= len(lines.pop())  # a comment of what comes next
            return text[:begin] + text[end:]
    return text


class CalibratedModel:
    """A model file with its history of calibrations.

    ``present``: the levels that the file has; ``in_use``: those that its effects make of them.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        content = yaml_file.read(path)
        self._text = path.read_text(encoding="utf-8")
        friction = content["model"]["friction"]
        pos_nm, neg_nm = (float(friction[side]) for side in _SIDES)
        self.present = Levels(pos_nm, neg_nm)
        self._model = load_model(path)
        self.in_use = levels_in_use(self._model)
        self.history: list[dict[str, Any]] = list(content.get(_BLOCK) or [])

    def check(self, levels: Levels, band: float, *, insist: bool = False) -> bool:
        """Whether the levels lie in the band; :class:`EpsHilError` if not and not insisted."""
        within = True
        for side in _SIDES:
            last, new = getattr(self.in_use, side), getattr(levels, side)
            within &= abs(new - last) <= band * last
        if not within and not insist:
            raise EpsHilError(
                f"refused: k0+ {levels.offset_pos_nm:.4f}, k0- {levels.offset_neg_nm:.4f} Nm lie "
                f"more than {band:.0%} from the last accepted {self.in_use.offset_pos_nm:.4f}, "
                f"{self.in_use.offset_neg_nm:.4f} Nm; look at the rig, then repeat, or insist "
                "with --accept-outside-band"
            )
        return within

    def unknown_force_n(self, levels: Levels, ratio: float, shift: Shift = NOT_SEEN) -> float:
        """Rack force that would explain levels that moved apart since the last calibration; or 0.

        ``ratio``: i_APA; ``shift``: what presliding saw of a force. Where it saw that there was
        none, the levels moved by themselves.
        """
        before = FrictionLevels(self.in_use.offset_pos_nm, self.in_use.offset_neg_nm)
        after = FrictionLevels(levels.offset_pos_nm, levels.offset_neg_nm)
        force_n = force_that_explains_n(before, after, ratio)
        none = abs(shift.torque_nm) + 2.0 * shift.std_nm < 0.5 * abs(force_n) / ratio
        return 0.0 if none else force_n

    def calibrated(self, levels: Levels, note: dict[str, Any]) -> str:
        """The file's text, of whose levels its effects make ``levels``, with a line of history."""
        levels = self._as_in_file(levels)
        after: dict[str, Any] = {side: round(float(getattr(levels, side)), 7) for side in _SIDES}
        for name in ("pos_ci95_nm", "neg_ci95_nm"):
            interval = getattr(levels, name)
            if interval is not None:
                after[name] = [round(float(bound), 7) for bound in interval]
        return self._written(after, note)

    def _as_in_file(self, levels: Levels) -> Levels:
        """What the file has to say for ``levels`` to be in use; effects scale and shift a level."""
        friction = self._model.friction
        raised = {side: getattr(friction, side) + _STEP_NM for side in _SIDES}
        more = levels_in_use(replace(self._model, friction=replace(friction, **raised)))

        def in_file(side: str, level_nm: float) -> float:
            used = getattr(self.in_use, side)
            slope = (getattr(more, side) - used) / _STEP_NM
            return float(getattr(self.present, side)) + (level_nm - float(used)) / slope

        def both(side: str, ends: tuple[float, float] | None) -> tuple[float, float] | None:
            return None if ends is None else (in_file(side, ends[0]), in_file(side, ends[1]))

        pos, neg = _SIDES
        return Levels(
            in_file(pos, levels.offset_pos_nm),
            in_file(neg, levels.offset_neg_nm),
            both(pos, levels.pos_ci95_nm),
            both(neg, levels.neg_ci95_nm),
        )

    def reset(self, note: dict[str, Any]) -> str:
        """The file's text with the levels from before the first calibration."""
        if not self.history:
            raise InputError(
                self._path, _BLOCK, "holds no calibration that could be reset", "nothing to do"
            )
        first = self.history[0]["before"]
        return self._written({side: float(first[side]) for side in _SIDES}, note)

    def try_writing(self, out: Path) -> None:
        """:class:`InputError` where a calibration could not be written, or would lose others.

        Asked before anything moves: the levels of the file itself stand for those to come.
        """
        self._written({side: getattr(self.present, side) for side in _SIDES}, {})
        if not out.is_file():
            return
        known = yaml_file.read(out)
        there = list(known.get(_BLOCK) or []) if isinstance(known, dict) else []
        if there != self.history[: len(there)]:
            raise InputError(
                out, _BLOCK, f"holds calibrations that {self._path} does not",
                f"go on from it (model: {out} in the configuration), or write to another file",
            )  # fmt: skip

    def _written(self, after: dict[str, Any], note: dict[str, Any]) -> str:
        before = {side: getattr(self.present, side) for side in _SIDES}
        utc = datetime.now(UTC).isoformat(timespec="seconds")
        entry = {"utc": utc, **note, "before": before, "after": after}
        text = _without_block(self._text)
        for side in _SIDES:
            text, found = re.subn(
                rf"^(\s*{side}:\s*)[^\s#,}}]+", rf"\g<1>{after[side]!r}", text, flags=re.MULTILINE
            )
            if found != 1:
                raise InputError(
                    self._path, f"model.friction.{side}", "is not on one line of its own",
                    "write the block out",
                )  # fmt: skip
        block = yaml.safe_dump({_BLOCK: [*self.history, entry]}, sort_keys=False)
        return text.rstrip("\n") + "\n" + block
