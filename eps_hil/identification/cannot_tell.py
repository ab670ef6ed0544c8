"""What these recordings cannot tell, and what would: said beside the numbers, never invented."""

from collections.abc import Mapping, Sequence

import numpy as np

from eps_hil.identification.balance import Case
from eps_hil.identification.finding import Unknown
from eps_hil.identification.motor_lag import MotorLag
from eps_hil.identification.result import Estimate

LEAST_N = 250.0
"""Rack forces beyond this in both directions count as preloads of both signs."""


def cannot_tell(
    parameters: Mapping[str, Estimate],
    offsets: Mapping[str, Estimate],
    cases: Sequence[Case],
    reference: str,
    lag: MotorLag,
) -> tuple[Unknown, ...]:
    """Everything that looks alike in these recordings, structural limits first."""
    held = f"{reference} is held at the model file's value" if reference else "none could be held"
    told = [
        Unknown(
            "a delay common to all signals",
            f"recordings show differences of delays only; {held}",
            "",
        ),
        Unknown(
            "a scale common to all torques and the load cell",
            "friction and inertia scale with it; the ratios are taken from the model file",
            "",
        ),
        *_lag(parameters, lag),
        *_offsets(offsets),
        *_load_cell(cases),
    ]
    if any(not case.measured_load for case in cases):
        why = (
            "without a load cell only the friction that the load makes tells them apart; the "
            "intervals say how little that is"
        )
        told += [
            Unknown("viscous friction and the damping of the load", why, "record the load cell"),
            Unknown("k0+ minus k0- and the zero of the load", why, "record the load cell"),
        ]
    for name, one in parameters.items():
        if one.status == "kept":
            told.append(Unknown(name, one.note, ""))
    return tuple(told)


def _lag(parameters: Mapping[str, Estimate], lag: MotorLag) -> list[Unknown]:
    delay = parameters.get("delays_s.motor_torque")
    if delay is None or delay.status == "kept" or lag.separable:
        return []
    most = "" if not np.isfinite(lag.most_s) else f" (a lag of up to {1e3 * lag.most_s:.2g} ms)"
    return [
        Unknown(
            f"dead time and lag of the motor torque{most}",
            "below 10 Hz both are a delay; motor_torque's delay is their sum",
            "record some minutes of multisine by the motor",
        )
    ]


def _offsets(offsets: Mapping[str, Estimate]) -> list[Unknown]:
    return [
        Unknown(f"{name} and k0+ minus k0-", one.note, "")
        for name, one in offsets.items()
        if one.status == "kept"
    ]


def _load_cell(cases: Sequence[Case]) -> list[Unknown]:
    """Of the load cell; with preloads of one sign a scale is an asymmetry of the load gains."""
    loads = [case.recording.raw["rack_force_n"] for case in cases if case.measured_load]
    if not loads:
        return []
    zero = Unknown(
        "the zero of the load cell and k0+ minus k0-",
        "both are a torque of one sign; the load cell is taken at its word",
        "zero the load cell before the run",
    )
    lowest = min(float(np.percentile(load, 2)) for load in loads)
    highest = max(float(np.percentile(load, 98)) for load in loads)
    if (lowest < -LEAST_N) == (highest > LEAST_N):
        return [zero]
    return [
        zero,
        Unknown(
            "the scale of the motor torque and kr+ minus kr-",
            "the rack force has one sign only",
            "record preloads of both signs",
        ),
    ]
