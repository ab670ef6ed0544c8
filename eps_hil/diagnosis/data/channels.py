"""Channels that are not what their names say: wrong signs, units and columns, wrapped angles.

They would come back from the torque balance as physics, and with a high confidence. What names
them is the identification's; here it is asked only what no physics looks like: what of the torques
stays open without a name is for the diagnosis to explain. So is what a missing spring would do: a
motor that only holds the rack as a spring does, with its sign turned round, is left to it.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from eps_hil.diagnosis.data.far_off import check_clocks
from eps_hil.diagnosis.data.intake import RecordingError, refusing
from eps_hil.diagnosis.data.one_machine import check_one_machine
from eps_hil.diagnosis.data.side_by_side import each
from eps_hil.errors import InputError
from eps_hil.identification import kinematics, plausibility
from eps_hil.identification.balance import Case
from eps_hil.identification.filters import STEP_S
from eps_hil.identification.motion_check import check_place, check_turns
from eps_hil.identification.prepare import SHORTEST_S, Prepared, prepare
from eps_hil.identification.state import State
from eps_hil.physics.effects.catalogue import with_model_effects
from eps_hil.physics.model import Model
from eps_hil.series import Series

Signals = Mapping[str, Series]

LONGEST_S = 240.0
"""Of all recordings together about as much is looked at: of each its liveliest stretch…"""
LEAST_S = 20.0
"""…of no less than this."""
COMPARED_S = 40.0
"""Speed and angle are compared for as long from the first motion on; then a clock that drifts has
carried them apart."""
WINDOW_S = 5.0
"""…and in windows, most of which have to say the same: one of the two may stick for seconds."""
FULL_TURN = 1.1 * 2.0 * np.pi
"""What starts anew within it is told in other words (``check_turns``)."""
ANEW, ALONE = 0.8, 10
"""Share of an angle's range that a step is where it starts anew; and samples between two such."""
_MOVES_RAD_S = 0.5
_FEWEST = 8


def check_channels(recordings: Mapping[str, Signals], model: Model) -> None:
    """``RecordingError`` (of the intake) with the first channel that is not what its name says."""
    most_s = max(LONGEST_S / max(len(recordings), 1), LEAST_S)
    ready = each(lambda one: _check(one[0], one[1], model, most_s), recordings.items())
    check_one_machine([one for one in ready if one is not None])


def channels_in_doubt(recordings: Mapping[str, Signals], model: Model, trusted: bool) -> list[str]:
    """:func:`check_channels`; where channels are ``trusted``, what it refuses as a sentence."""
    try:
        check_channels(recordings, model)
    except RecordingError as error:
        if not trusted:
            raise
        return [f"{error.recording}: {error}. The channels were trusted all the same."]
    return []


def _check(name: str, series: Signals, model: Model, most_s: float) -> Prepared | None:
    used: Signals = {
        key: one for key, one in series.items() if np.isfinite(one.value).sum() >= _FEWEST
    }
    moving = {"motor_speed_rad_s", "motor_angle_rad"} & used.keys()
    if "motor_torque_nm" not in used or not moving:
        return None
    with refusing():
        if "motor_angle_rad" in used:
            check_turning_on(name, used["motor_angle_rad"])
        used = _liveliest(used, most_s)
        if _shared_s(used) < SHORTEST_S:
            return None
        ready = prepare(name, used)
        check_clocks(ready)
        _motion(ready, model)
        _torques(ready, model)
    return ready


def check_turning_on(name: str, angle: Series) -> None:
    """:class:`InputError` for an angle that starts anew at the end of its range, whatever that is.

    Jumps of nearly all of the range, each alone, where no other step is a tenth of it.
    """
    value = angle.value[np.isfinite(angle.value)]
    step = np.diff(value)
    span = float(np.ptp(value))
    jumps = np.flatnonzero(np.abs(step) > ANEW * span)
    others = np.delete(np.abs(step), jumps)
    if len(jumps) < 2 or span < FULL_TURN or np.max(others, initial=0.0) > 0.1 * span:
        return
    if np.min(np.diff(jumps)) < ALONE:  # there and back: a value that was read wrong
        return
    problem = (
        f"jumps by {float(np.median(np.abs(step[jumps]))):.4g} rad {len(jumps)} times: it starts "
        "anew at the end of its range"
    )
    raise InputError(name, "motor_angle_rad", problem, "unwrap it")


def _motion(one: Prepared, model: Model) -> None:
    """Speed, angle and rack position against each other."""
    if one.has("motor_angle_rad"):
        check_turns(one)
        if one.has("motor_speed_rad_s"):
            _speed_and_angle(one)
    for told in check_place(one, model.rack_to_rotor_ratio_rad_per_m):
        if told.kind == "sign":
            _torques(one, model)  # where it is the angle, and the speed with it, they tell
            problem = "turns the other way than motor_angle_rad: wrong sign"
            remedy = "turn one of them (in a mapping: scale: -1)"
            raise InputError(one.name, "rack_position_m", problem, remedy)


def _torques(one: Prepared, model: Model) -> None:
    """The torque balance, by the speed alone where it was recorded: its clock is the torques'."""
    if one.has("motor_speed_rad_s"):
        raw = {key: values for key, values in one.raw.items() if key != "motor_angle_rad"}
        one = replace(one, raw=raw)
    case = Case(one, kinematics.kinematics(one, 0.0), 0)
    plausibility.check_one(case, State(with_model_effects(model)), sure=True)


def _speed_and_angle(one: Prepared) -> None:
    moving = np.abs(one.raw["motor_speed_rad_s"]) > _MOVES_RAD_S
    first, size = int(np.argmax(moving)), round(WINDOW_S / STEP_S)
    last = min(first + round(COMPARED_S / STEP_S), len(moving))
    starts = [k for k in range(first, last - size + 1, size) if np.any(moving[k : k + size])]
    refused = []
    for start in starts:
        try:
            kinematics.check(_cut_out(one, start, start + size))
        except InputError as error:
            refused.append(error)
    if 2 * len(refused) > len(starts):
        raise refused[len(refused) // 2]


def _cut_out(one: Prepared, first: int, last: int) -> Prepared:
    raw = {key: values[first:last] for key, values in one.raw.items()}
    return replace(one, time_s=one.time_s[first:last], raw=raw, good=one.good[first:last])


def _shared_s(series: Signals) -> float:
    """How long all signals last together, s."""
    start = max(int(one.t_ns[0]) for one in series.values())
    end = min(int(one.t_ns[-1]) for one in series.values())
    return (end - start) * 1e-9


def _liveliest(series: Signals, most_s: float) -> Signals:
    """The stretch of ``most_s`` in which the motor torque varies most; all of what is shorter."""
    torque = series["motor_torque_nm"]
    start, whole = int(torque.t_ns[0]), int(most_s * 1e9)
    if int(torque.t_ns[-1]) - start <= whole:
        return series
    starts = range(start, int(torque.t_ns[-1]) - whole + 1, whole)
    swings = [float(np.nanstd(_cut(torque, at, at + whole).value)) for at in starts]
    best = starts[int(np.argmax(swings))]
    return {key: _cut(one, best, best + whole) for key, one in series.items()}


def _cut(one: Series, start: int, end: int) -> Series:
    keep = slice(*np.searchsorted(one.t_ns, (start, end)).tolist())
    return Series(one.t_ns[keep], one.value[keep])
