"""Figures of the hold-outs by the model file that is written, with a load that nobody measured.

A fit takes such a load for a force that was recorded. A written model holds it as effects, and acts
against the motion that it simulates itself: only that is what ``simulate`` does with the file. A
force of any form can be in no file; then there is nothing that would drive a simulation.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from eps_hil.diagnosis.accept.free_run import DISAGREE, worse_free_run
from eps_hil.diagnosis.accept.improvement import Judged, improvement
from eps_hil.diagnosis.accept.proof_of_fit import (
    Holdout,
    measures,
    noise_floor,
    still_left,
)
from eps_hil.diagnosis.data.side_by_side import each
from eps_hil.physics.model import Model

_MORE = 1.1
"""Times what is left once a channel is put right, from which that is said."""
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
    told: dict[str, Any] = {
        "baseline": {} if read else measures(bare, written, given),
        "augmented": measures(bare, written, written),
        "noise_floor": noise_floor(bare, written),
    }
    if read:
        balance = "put_right" in content["fit"]["holdout"]
        told = as_the_file_does(told, read, given, written, balance=balance)
    content = {**content, "fit": {**content["fit"], "improvement": improvement(
        Judged(read or bare, given), Judged(bare, written), given, written
    )}}  # fmt: skip
    return _with(content, told)


def as_the_file_does(
    told: Mapping[str, Mapping[str, Any]],
    as_read: Sequence[Holdout],
    given: Model,
    written: Model,
    *,
    balance: bool,
    simulated: bool = True,
) -> dict[str, Any]:
    """``fit.holdout`` of the files ``given`` and ``written`` on hold-outs as their files have them.

    ``told``: the same on corrected recordings. A joint that gives or has play is in the written
    file, but in no balance of one mass: without ``balance`` the residual is that of ``told``.
    With it, no file holds the correction, and ``put_right`` keeps ``told``.
    """
    models = [given] if written == given else [given, written]
    measured = each(lambda one: measures(as_read, one, one, simulated=simulated), models)
    before, after = measured[0], dict(measured[-1])
    if not balance:
        after["torque_nrmse"] = told["augmented"]["torque_nrmse"]
    figures = {**told, "baseline": before, "augmented": after}
    return {**figures, "put_right": told["augmented"]} if balance else figures


def in_no_file(told: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """A sentence where recordings (``fit.holdout``) were put right as no model file puts them."""
    left = told["augmented"]["torque_nrmse"]
    right = told.get("put_right", told["augmented"])["torque_nrmse"]
    if not left > _MORE * right:
        return []
    return [
        "The figures after are of the written model on the hold-outs as they were read: it leaves "
        f"torque_nrmse {left:.3g}. Once that channel is corrected, which no model file does, it "
        f"leaves {right:.3g}."
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
    before = [*still_left(known), *(one for one in content["limits"] if one.startswith(DISAGREE))]
    silent = content["verdict"] in ("no_mismatch", "explained")
    limits = [
        one for one in content["limits"] if one not in before and not one.startswith(DISAGREE)
    ]
    limits += [*(still_left(told) if silent else []), *worse_free_run(told)]
    return {**content, "limits": limits, "fit": {**content["fit"], "holdout": dict(told)}}
