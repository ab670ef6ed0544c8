"""The whole way from recordings to a verdict (CONTRACT 7)."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

import numpy as np
from threadpoolctl import threadpool_limits

from eps_hil.diagnosis.accept.improvement import only_if_clear
from eps_hil.diagnosis.attribute.select import Say
from eps_hil.diagnosis.balance.late_channel import late_channels
from eps_hil.diagnosis.balance.load import (
    load_of,
    missing,
    own_drag,
)
from eps_hil.diagnosis.balance.problem import sliding
from eps_hil.diagnosis.data.channels import channels_in_doubt
from eps_hil.diagnosis.data.held import own_samples
from eps_hil.diagnosis.data.intake import (
    measured,
    prepared,
    same_load,
    split,
)
from eps_hil.diagnosis.data.prepare import Prepared, seen_twice
from eps_hil.diagnosis.data.side_by_side import each
from eps_hil.diagnosis.data.size import size_of
from eps_hil.diagnosis.given_load import Diagnosis, slides, under
from eps_hil.diagnosis.unmeasured_load import under_load
from eps_hil.physics.model import Model
from eps_hil.series import Series


def diagnose(
    model: Model,
    recordings: Mapping[str, Mapping[str, Series]],
    holdouts: Mapping[str, Mapping[str, Series]],
    say: Say | None = None,
    without: Collection[str] = (),
    unexplained_nm: float = 0.0,
    *,
    trust_channels: bool = False,
    began_s: Mapping[str, float] = MappingProxyType({}),
) -> Diagnosis:
    """Find what physics ``model`` lacks to explain the recordings.

    Without hold-outs the last recording (of several), or the last third (of one), is kept from
    the fit. Effects in ``without`` (ids) are not considered. ``unexplained_nm`` (rms, at the rotor)
    is known to be the model's own fault and no finding. ``began_s``: how long after its rig each
    recording (or hold-out) began, where they are parts of one run: what warms up goes on.
    :class:`RecordingError` (a ``ValueError``) where a recording lacks what a diagnosis needs, or a
    channel is not what its name says; with ``trust_channels`` the latter is only said in
    ``limits``.
    """
    # Matrices here have a few dozen columns: BLAS threads only wait for one another.
    with threadpool_limits(limits=1, user_api="blas"):
        recordings, holdouts = measured(recordings), measured(holdouts)
        fitted, kept = split(own_samples(recordings), own_samples(holdouts))
        series = [*fitted.items(), *kept.items()]
        every = each(
            lambda one: prepared(one[0], one[1], unexplained_nm, {} if holdouts else recordings),
            series,
        )
        every = seen_twice(every)
        size, among = size_of(every, model), len(every)
        every = [
            one.changed(size=size, among=among, begins_s=began_s.get(one.name, one.begins_s))
            for one in every
        ]
        ready = list(zip(every[: len(fitted)], fitted.values(), strict=True))
        spare = list(zip(every[len(fitted) :], kept.values(), strict=True))
        same_load(every)
        doubts = channels_in_doubt({**recordings, **holdouts}, model, trust_channels)
        if not missing(every):
            doubts += late_channels(every, model, trusted=trust_channels)
        found = _found(model, ready, spare, say, without)
        content = only_if_clear(found.content, found.elsewhere)
        return replace(found, content={**content, "limits": [*doubts, *content["limits"]]})


def _found(
    model: Model,
    ready: Sequence[tuple[Prepared, Mapping[str, Series]]],
    spare: Sequence[tuple[Prepared, Mapping[str, Series]]],
    say: Say | None,
    without: Collection[str],
) -> Diagnosis:
    """The diagnosis under the load that fits best, where nobody measured one."""
    every = [one for one, _ in (*ready, *spare)]
    learnt = [one for one, _ in ready]  # a hold-out that the load was fitted to judges nothing
    slides(learnt, np.concatenate([sliding(one, model) for one in learnt]))
    if not missing(every):
        return under(None, model, ready, spare, say, without)
    load = load_of(learnt, model)
    beside = load.beside_own_drag(model)
    told = under_load(replace(load, drag_nm_s_per_rad=0.0), beside, ready, spare, say, without)
    said = own_drag(model, told.model)
    return replace(told, content={**told.content, "limits": [*said, *told.content["limits"]]})
