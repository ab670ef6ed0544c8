"""What ``eps-hil calibrate`` does with levels that it found: refuse, warn, write, reset."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from eps_hil.errors import EpsHilError, InputError

if TYPE_CHECKING:
    from eps_hil.adaptation.unknown_force import Shift
    from eps_hil.service.calibrated_model import Levels
    from eps_hil.service.calibration import CalibrationSettings
    from eps_hil.service.config import ServiceConfig


def accept(
    levels: "Levels",
    setup: "ServiceConfig",
    settings: "CalibrationSettings",
    write_model: Path | None,
    note: dict[str, Any],
    insist: bool,
    shift: "Shift | None" = None,
    said: Sequence[str] = (),
) -> None:
    """Refuse, warn, or write; ``shift``: what torque injection saw of a force at the rack.

    Written first, and told (``said`` before all) afterwards: nobody may be there to read.
    """
    lines = list(said)
    try:
        _accept(levels, setup, settings, write_model, note, insist, shift, lines)
    finally:
        for line in lines:
            typer.echo(line)


def _accept(
    levels: "Levels",
    setup: "ServiceConfig",
    settings: "CalibrationSettings",
    write_model: Path | None,
    note: dict[str, Any],
    insist: bool,
    shift: "Shift | None",
    lines: list[str],
) -> None:
    """:func:`accept` without a word; what is to be told is put into ``lines``."""
    from eps_hil.adaptation.unknown_force import NOT_SEEN
    from eps_hil.physics.effects.effect import Slot
    from eps_hil.physics.model import load_model
    from eps_hil.service.calibrated_model import CalibratedModel, effects_in, widened

    model = CalibratedModel(setup.model)
    rig = load_model(setup.model)
    ratio = rig.rack_to_rotor_ratio_rad_per_m
    force_n = model.unknown_force_n(levels, ratio, shift or NOT_SEEN)
    if force_n:
        levels = widened(levels, force_n / ratio)
        note["rack_force_that_would_explain_it_n"] = round(force_n, 1)
    old = model.in_use
    for name, new, was, ci in (
        ("k0+", levels.offset_pos_nm, old.offset_pos_nm, levels.pos_ci95_nm),
        ("k0-", levels.offset_neg_nm, old.offset_neg_nm, levels.neg_ci95_nm),
    ):
        interval = f"  (95 %: {ci[0]:.4f} to {ci[1]:.4f})" if ci else ""
        lines.append(f"{name}        {new:.4f} Nm{interval}, in the model {was:.4f} Nm")
    beside = effects_in(rig, (Slot.LEVEL, Slot.LEVEL_FACTOR, Slot.MOTOR, Slot.SENSOR))
    if beside:
        note["measured_beside"] = list(beside)
        lines.append(
            f"note       the levels were measured with {', '.join(beside)} in them, which the "
            "model adds once more: look whether that counts twice"
        )
    if force_n:
        lines.append(_of_force(force_n, known=bool(model.history) and not insist))
    within = model.check(levels, settings.sanity_band, insist=insist)
    note["bus"] = str(setup.bus)
    note["within_band"] = within
    if write_model is not None:
        _write(write_model, model.calibrated(levels, note))
        lines.append(f"model      written to {write_model}")


def _of_force(force_n: float, *, known: bool) -> str:
    """A note, or an :class:`EpsHilError` where the model's levels are this gear's (``known``)."""
    said = (
        "the levels moved apart and their sum stayed: an unknown rack force of about"
        f" {force_n:.0f} N would explain this"
    )
    if known:
        raise EpsHilError(
            f"refused: {said}; free the rack, then repeat, or insist with --accept-outside-band"
        )
    return f"note       {said}; the intervals are widened for it, look whether the rack is free"


def check_calibrated_place(setup: "ServiceConfig", write_model: Path | None) -> None:
    """:class:`InputError`, before anything moves, where levels could not be written there."""
    from eps_hil.cli._files import check_model_place
    from eps_hil.service.calibrated_model import CalibratedModel

    check_model_place(write_model)
    if write_model is not None:
        CalibratedModel(setup.model).try_writing(write_model)


def reset_levels(setup: "ServiceConfig", write_model: Path | None) -> None:
    """The levels from before the first calibration, written."""
    from eps_hil.service.calibrated_model import CalibratedModel

    if write_model is None:
        raise InputError("--write-model", "", "is missing", "name the file that --reset writes")
    _write(write_model, CalibratedModel(setup.model).reset({"method": "reset"}))
    typer.echo(f"model      written to {write_model}")


def _write(path: Path, text: str) -> None:
    from eps_hil.recordings.files import replacing

    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
