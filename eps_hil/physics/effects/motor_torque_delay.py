"""Shaft torque that comes later than the file says: dead time, a lag, or some of both."""

import math
from collections.abc import Mapping
from dataclasses import replace

from eps_hil.compiled import kernel
from eps_hil.physics.effects.effect import Effect, Floats, Instant, Kind, Parameter, Probe, Slot
from eps_hil.physics.model import Model


def _lag_s(values: Mapping[str, float]) -> float:
    return max(values["delay_s"], 0.0) * values["lag_share"]


def _change(model: Model, values: Mapping[str, float]) -> Model:
    delays = model.delays_s
    dead = values["delay_s"] - _lag_s(values)
    return replace(model, delays_s=replace(delays, motor_torque=delays.motor_torque - dead))


def _left(values: Mapping[str, float]) -> Mapping[str, float] | None:
    lag = _lag_s(values)
    return {"delay_s": lag, "lag_share": 1.0} if lag > 0.0 else None


_RUNNING, _OUT, _IN, _STEP_S = 0, 1, 2, 3


@kernel
def _shaft_nm(p: Floats, s: Floats, _u: Instant, torque: float) -> float:
    """A first-order lag of straight lines, exactly; it begins as if it had always been so."""
    if s[_RUNNING] == 0.0:
        return torque
    step, lag = s[_STEP_S], p[0] * p[1]
    kept = math.exp(-step / lag)
    even = kept * s[_OUT] + (1.0 - kept) * s[_IN]
    return even + (torque - s[_IN]) * (1.0 - (1.0 - kept) * lag / step)


@kernel
def _advance(p: Floats, s: Floats, u: Instant, step_s: float) -> None:
    s[_OUT] = _shaft_nm(p, s, u, u.motor_torque_nm)
    s[_RUNNING], s[_IN], s[_STEP_S] = 1.0, u.motor_torque_nm, step_s


def _words(values: Mapping[str, float]) -> str:
    return _LAG if values.get("lag_share", 0.0) > 0.5 else _LATE


_LATE = "The torque reaches the shaft {delay_s:.3g} s later than the file says."
_LAG = (
    "The torque follows {delay_s:.3g} s behind what the file says, and rather as behind a low-pass "
    "than as after a dead time."
)

EFFECT = Effect(
    id="motor_torque_delay",
    title="Motor torque delay",
    kind=Kind.INSTRUMENT,
    slot=Slot.MODEL,
    equation="T_em(t) on the shaft = reported for t − delay; lag_share of it is a first-order lag",
    parameters=(
        Parameter("delay_s", "s", -0.05, 0.1, "shaft torque later than reported"),
        Parameter(
            "lag_share", "1", 0.0, 1.0, "how much of that is a first-order lag", 0.0, closed=True
        ),
    ),
    sentence=_LATE,
    sentence_negative="The torque reaches the shaft {delay_s:.3g} s earlier than the file says.",
    words=_words,
    twins={"speed_sensor_delay": "a third signal with a known clock (load cell, rack position)"},
    change=_change,
    left=_left,
    elsewhere={Slot.MOTOR: _shaft_nm},
    advance=_advance,
    stage=-1,
    probe=Probe("delay_s", 0.0, 2e-4, least=0.75e-3),
)
