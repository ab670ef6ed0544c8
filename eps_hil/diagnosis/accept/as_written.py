"""Figures of the hold-outs by the model file that is written, with a load that nobody measured.

A fit takes such a load for a force that was recorded. A written model holds it as effects, and acts
against the motion that it simulates itself: only that is what ``simulate`` does with the file. A
force of any form can be in no file; then there is nothing that would drive a simulation.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from eps_hil.diagnosis.accept.free_run import worse_free_run
from eps_hil.diagnosis.accept.proof_of_fit import (
    Holdout,
    measures,
    noise_floor,
    still_left,
    torque_nrmse,
)
from eps_hil.physics.model import Model

_MORE = 1.1
"""Times what is reported, from which that is said."""
_SIMULATED = ("speed_fit_percent", "free_run")


def under_written_load(
    content: Mapping[str, Any],
    judged: Sequence[Holdout],
    as_read: Sequence[Holdout],
    given: Model,
    written: Model,
) -> dict[str, Any]:
    """The JSON's content with the figures of ``given`` and ``written``, each with its load.

    ``judged``: hold-outs as they were fitted; ``as_read``: as a file holds them, if that is
    something else.
    """
    bare, read = (
        [replace(one, prepared=one.prepared.as_measured()) for one in some]
        for some in (judged, as_read)
    )
    baseline = measures(read, given, given) if read else measures(bare, written, given)
    told = {
        "baseline": baseline,
        "augmented": measures(bare, written, written),
        "noise_floor": noise_floor(bare, written),
    }
    return _with(content, told)


def in_no_file(
    told: Mapping[str, Mapping[str, Any]], as_read: Sequence[Holdout], given: Model, written: Model
) -> list[str]:
    """A sentence where ``fit.holdout`` after is of recordings put right, and no file puts them so.

    ``as_read``: the hold-outs as their files have them, which is what the model file will meet.
    """
    left = torque_nrmse(as_read, given, written)
    after = told["augmented"]["torque_nrmse"]
    if not left > _MORE * after:
        return []
    return [
        "The figures after are of recordings with that channel put right, which no model file "
        "does: of the hold-outs as they were read the written model leaves torque_nrmse "
        f"{left:.3g}, not {after:.3g}."
    ]


def under_any_force(content: Mapping[str, Any]) -> dict[str, Any]:
    """The content without figures of simulations that nothing drives."""
    told = {
        name: {key: None if key in _SIMULATED else one for key, one in figures.items()}
        for name, figures in content["fit"]["holdout"].items()
    }
    for name in ("baseline", "augmented"):
        told[name]["free_run"] = {"speed_rmse_rad_s": None, "angle_rmse_rad": None}
    return _with(content, told)


def _with(content: Mapping[str, Any], told: Mapping[str, Any]) -> dict[str, Any]:
    """The content with other hold-out figures, and what its limits say of them."""
    known = content["fit"]["holdout"]
    before = [*still_left(known), *worse_free_run(known)]
    silent = content["verdict"] in ("no_mismatch", "explained")
    limits = [one for one in content["limits"] if one not in before]
    limits += [*(still_left(told) if silent else []), *worse_free_run(told)]
    return {**content, "limits": limits, "fit": {**content["fit"], "holdout": dict(told)}}
