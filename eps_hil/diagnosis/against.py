"""Recordings against somebody's simulator: what they hold and its traces lack (CONTRACT 6)."""

from collections.abc import Collection, Mapping
from dataclasses import replace

from eps_hil.diagnosis.attribute.select import Say
from eps_hil.diagnosis.data.channels import check_channels
from eps_hil.diagnosis.data.intake import check_rates
from eps_hil.diagnosis.diagnose import Diagnosis, diagnose
from eps_hil.diagnosis.simulator.simulation import Simulated, explain, silent_on
from eps_hil.diagnosis.simulator.traces import Signals
from eps_hil.physics.model import Model


def diagnose_against(
    traces: Mapping[str, Signals],
    model: Model,
    recordings: Mapping[str, Signals],
    holdouts: Mapping[str, Signals],
    say: Say | None = None,
    without: Collection[str] = (),
) -> Diagnosis:
    """The diagnosis with somebody's simulator in the place of our model.

    ``model`` holds what is known of the rig (inertia, ratios, delays, friction). ``content`` gets
    the key ``simulation``: how the traces were aligned, the parameters that explain them, caveats.
    The "baseline" of the proof is the simulator as we reduced it.
    """
    every = {**recordings, **holdouts}
    check_rates(every)
    check_channels(every, model)
    simulated = explain(traces, every, model, _part(say, 0.0, 0.5))
    result = diagnose(
        simulated.model,
        recordings,
        holdouts,
        _part(say, 0.5, 1.0),
        without,
        simulated.unexplained_nm,
    )
    content = dict(result.content)
    caveats = [*simulated.content["caveats"], *_silent(result, simulated)]
    content["simulation"] = {**simulated.content, "caveats": caveats}
    return replace(result, content=content)


def _silent(result: Diagnosis, simulated: Simulated) -> list[str]:
    entries = [result.selection.found.entries[k] for k in result.accepted]
    return [
        f"the traces do not move in a way that would show {entry['effect']}: the recordings hold "
        "it; whether the simulator does, these traces cannot tell"
        for entry in entries
        if silent_on(simulated, entry)
    ]


def _part(say: Say | None, start: float, end: float) -> Say | None:
    if say is None:
        return None
    return lambda what, part: say(what, start + part * (end - start))
