"""The whole way from recordings to a verdict (CONTRACT 7)."""

from collections.abc import Collection, Mapping
from dataclasses import replace
from types import MappingProxyType

import numpy as np
from threadpoolctl import threadpool_limits

from eps_hil.diagnosis.accept.improvement import only_if_clear
from eps_hil.diagnosis.attribute.select import Say
from eps_hil.diagnosis.balance.late_channel import late_channels
from eps_hil.diagnosis.balance.load import (
    missing,
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
from eps_hil.diagnosis.data.prepare import seen_twice
from eps_hil.diagnosis.data.side_by_side import each
from eps_hil.diagnosis.data.size import size_of
from eps_hil.diagnosis.given_load import Asked, Diagnosis, slides, under
from eps_hil.diagnosis.unmeasured_load import under_unmeasured_load
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
        asked = Asked(
            model,
            list(zip(every[: len(fitted)], fitted.values(), strict=True)),
            list(zip(every[len(fitted) :], kept.values(), strict=True)),
            say,
            without,
        )
        same_load(every)
        doubts = channels_in_doubt({**recordings, **holdouts}, model, trust_channels)
        measured_load = not missing(every)
        if measured_load:
            doubts += late_channels(every, model, trusted=trust_channels)
        slides(asked.learnt, np.concatenate([sliding(one, model) for one in asked.learnt]))
        found = under(None, asked) if measured_load else under_unmeasured_load(asked)
        content = only_if_clear(found.content, found.elsewhere)
        return replace(found, content={**content, "limits": [*doubts, *content["limits"]]})
