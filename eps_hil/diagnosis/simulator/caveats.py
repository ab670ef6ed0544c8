"""What a comparison with somebody's simulator rests on, and where it is weak: for people."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from eps_hil.diagnosis.simulator.align import Match
from eps_hil.diagnosis.simulator.parameters import Reduction
from eps_hil.diagnosis.simulator.traces import Signals, lent

_WIDER = 1.2
"""A recording that goes this much further than the traces asks more than they can tell."""


def about(name: str, trace: Signals, match: Match | None) -> dict[str, Any]:
    """A trace for the JSON: its recording, how they lie to each other, what was lent."""
    rates = {s: round(1e9 / float(np.median(np.diff(one.t_ns))), 3) for s, one in trace.items()}
    return {
        "file": name,
        "recording": match.recording if match else None,
        "offset_s": round(match.offset_s, 6) if match else None,
        "correlation": round(match.correlation, 4) if match else None,
        "rate_hz": rates.get("motor_speed_rad_s", rates.get("motor_angle_rad")),
        "taken_from_recording": lent(trace) if match else [],
    }


def caveats(
    traces: Mapping[str, Signals],
    recordings: Mapping[str, Signals],
    matches: Mapping[str, Match | None],
    reduction: Reduction,
    unexplained_nm: float,
    noise_nm: float,
) -> list[str]:
    """What a person should know before believing the comparison, a sentence each."""
    said = [f"{n}: like no recording; used as it is" for n, one in matches.items() if one is None]
    for signal in ("motor_speed_rad_s", "rack_force_n", "rack_position_m", "motor_torque_nm"):
        mine, theirs = _reach(traces.values(), signal), _reach(recordings.values(), signal)
        if mine > 0 and theirs > _WIDER * mine:
            said.append(
                f"the recordings reach {signal} {theirs:.4g}, the traces only {mine:.4g}: what "
                "happens beyond is compared with our reduction of the simulator carried on"
            )
    for name, trace in traces.items():
        if "motor_torque_nm" not in trace:
            said.append(
                f"{name}: motor torque taken from the recording; right only if the simulator was "
                "driven by the recorded torque"
            )
    if reduction.unseen:
        said.append(
            f"the traces do not show {', '.join(reduction.unseen)}; taken from the model file"
        )
    if unexplained_nm > noise_nm:
        said.append(
            f"our reduction leaves {unexplained_nm:.3g} Nm of the traces unexplained (noise: "
            f"{noise_nm:.3g} Nm); smaller differences are not reported"
        )
    return said + _units(traces, recordings, matches)


def _reach(records: Sequence[Signals] | Any, signal: str) -> float:
    values = [np.abs(one[signal].value) for one in records if signal in one]
    return float(np.nanpercentile(np.concatenate(values), 99)) if values else 0.0


def _units(
    traces: Mapping[str, Signals],
    recordings: Mapping[str, Signals],
    matches: Mapping[str, Match | None],
) -> list[str]:
    """A column whose size or sign is so unlike its recording's that it is hardly the same unit."""
    said = []
    for name, one in matches.items():
        if one is None:
            continue
        for signal in one.signals:
            mine, theirs = (
                float(np.nanstd(r[signal].value)) for r in (traces[name], recordings[one.recording])
            )
            if theirs > 0 and not 0.1 < mine / theirs < 10.0:
                said.append(
                    f"{name}: {signal} is {mine / theirs:.3g} times the recording's; units?"
                )
    return said
