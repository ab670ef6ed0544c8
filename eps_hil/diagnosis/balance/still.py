"""What a motor torque that never changes says nothing of.

A gain times a constant is a constant, and a ripple of it a torque of that order: both would be told
in a channel's name that holds nothing. And what stays unexplained may be the torque itself, of a
motor that was on and not recorded; a law of it would be one of the controller.
"""

from collections.abc import Sequence

import numpy as np

from eps_hil.diagnosis.balance.probes import candidates
from eps_hil.diagnosis.balance.problem import Problem
from eps_hil.diagnosis.data.prepare import Prepared

_TORQUE = "motor_torque_nm"
_TURNS_HZ = 0.3
"""Of the torque that is tried in its place."""


def is_still(recordings: Sequence[Prepared]) -> bool:
    """Whether the motor's torque has one value in every recording."""
    return all(np.ptp(one.raw[_TORQUE]) == 0.0 for one in recordings)


def of_motor_torque(problem: Problem) -> list[str]:
    """Ids of effects that change a residual where that torque varies, and none where it is zero."""
    nm = problem.size.torque

    def seen(amplitude: float) -> set[str]:
        tried = problem.over(
            [
                one.changed(
                    raw={
                        **one.raw,
                        _TORQUE: amplitude * np.sin(2.0 * np.pi * _TURNS_HZ * one.time_s),
                    }
                )
                for one in problem.recordings
            ]
        )
        found = candidates(tried, [], tried.residual(tried.model))
        return {one.effect.id for one in found}

    return sorted(seen(nm) - seen(0.0))


def sentence(ids: Sequence[str]) -> str:
    """For ``limits``, beside that the channel has one value."""
    return (
        f"Under a motor torque of one value nothing can be told of {', '.join(ids)}; and what "
        "stays unexplained may be the motor's torque, so that no law is made of it."
    )
