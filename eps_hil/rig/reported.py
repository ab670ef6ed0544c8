"""Effects of the rig's model file that act on what it reports: lost frames, a clock that drifts."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from eps_hil.errors import InputError
from eps_hil.physics.chain import build_chain
from eps_hil.physics.chain_parameters import ChainParameters
from eps_hil.physics.effects.catalogue import catalogue, values_of, with_model_effects
from eps_hil.physics.model import Model
from eps_hil.rig.frames import Cyclic
from eps_hil.rig.sensors import REPORTED

_SEE = "see docs/reference-rig.md"


def split(
    path: str | Path, model: Model, chain: ChainParameters, order: int
) -> tuple[Model, tuple[dict[str, Any], ...]]:
    """The model without those effects, and their values; refuses what this rig cannot have.

    :class:`~eps_hil.errors.InputError` names the effect.
    """
    inside, reported = [], []
    for k, entry in enumerate(model.effects):
        effect, values = values_of(entry, model, rig=True)
        if not effect.on_bus:
            inside.append(entry)
            continue
        signal = values["signal"]
        if signal is not None and signal not in REPORTED:
            raise InputError(
                path, f"model.effects[{k}]", f"'{signal}' is no signal of the rig", _SEE
            )
        if values.get("ppm", 0.0) < 0.0:
            raise InputError(
                path,
                f"model.effects[{k}]",
                "clock_drift: a live rig cannot report a signal before it happens",
                "give the other signals' clocks a positive ppm instead",
            )
        reported.append({"effect": effect.id, **values})
    rest = replace(model, effects=tuple(inside))
    for each in inside:
        _check_acts(path, replace(model, effects=(each,)), str(each["effect"]), chain, order)
    if len(inside) > 1:
        names = ", ".join(str(each["effect"]) for each in inside)
        _check_acts(path, rest, names, chain, order)
    return rest, tuple(reported)


def _check_acts(path: str | Path, model: Model, name: str, chain: ChainParameters, n: int) -> None:
    """One line by name for an effect that cannot act in this chain, or before its cause."""
    try:
        build_chain(model, chain, n)
    except (InputError, ValueError) as error:
        raise InputError(path, f"model.effects: {name}", str(error), _SEE) from None
    delays = with_model_effects(model).delays_s
    late = {"motor_speed": delays.motor_speed, "motor_angle": delays.motor_angle or 0.0}
    early = [signal for signal, delay in late.items() if delay < 0.0]
    if early:
        raise InputError(
            path,
            f"model.effects: {name}",
            f"{early[0]} would be reported {-late[early[0]]:g} s before it happens",
            "give delay_s above the negative of the model file's delay",
        )


def drifts_ppm(reported: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """Drift of signals' clocks, in ppm by canonical name."""
    return {
        one["signal"]: one["ppm"]
        for one in reported
        if one["effect"] == catalogue()["clock_drift"].id
    }


class Losses:
    """Which frames of a round are lost: as many as the effects say, drawn from the seed."""

    def __init__(
        self,
        path: str | Path,
        reported: Sequence[Mapping[str, Any]],
        messages: Sequence[Cyclic],
        ticks: int,
        seed: int,
    ) -> None:
        self._ticks = ticks
        self._lost: set[tuple[int, int]] = set()
        random = np.random.default_rng([seed, 0xD201])
        for one in reported:
            if one["effect"] != catalogue()["dropped_frames"].id:
                continue
            sent = [
                (k, message.encoder.can_id)
                for message in messages
                if message.signals and _carries(message, one["signal"])
                for k in range(message.phase, ticks, message.every)
            ]
            count = round(one["count"])
            if count > len(sent):
                raise InputError(
                    path,
                    "model.effects: dropped_frames",
                    f"{count} frames of {len(sent)} in one round cannot be lost",
                    "give a smaller count",
                )
            self._lost |= {sent[i] for i in random.choice(len(sent), count, replace=False)}

    def lost(self, tick: int, can_id: int) -> bool:
        """Whether the frame of this tick does not reach the bus."""
        return bool(self._lost) and (tick % self._ticks, can_id) in self._lost


def _carries(message: Cyclic, signal: str | None) -> bool:
    return signal is None or any(name == signal for name, *_ in message.signals)
