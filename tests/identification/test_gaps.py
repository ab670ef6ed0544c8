"""Stretches without samples: left out, and told from lost time."""

from typing import Any

import numpy as np
import pytest

from eps_hil.errors import InputError
from eps_hil.identification import gaps
from eps_hil.identification.prepare import prepare
from eps_hil.series import Series

T = np.arange(6000) * 1e-3
HOLE = (3000, 3034)


def turning(t: Any, stamps: Any) -> dict[str, Series]:
    """A rotor at 54 rad/s and a little more, reported at ``stamps`` (s) as it is at ``t`` (s)."""
    rng = np.random.default_rng(5)
    t_ns = np.round(stamps * 1e9).astype(np.int64)
    noise = rng.normal(size=(3, len(t)))
    turn = 2 * np.pi * 0.7
    return {
        "motor_torque_nm": Series(t_ns, 0.3 * np.sin(t) + 4e-3 * noise[0]),
        "motor_speed_rad_s": Series(t_ns, 54 + 4 * np.sin(turn * t) + 0.25 * noise[1]),
        "motor_angle_rad": Series(t_ns, 54 * t - 4 / turn * np.cos(turn * t) + 2e-3 * noise[2]),
    }


def test_lost_frames_are_left_out_and_no_more() -> None:
    kept = np.delete(T, np.arange(*HOLE))
    one = prepare("drive", turning(kept, kept))
    told = {finding.kind: finding for finding in one.findings}
    assert set(told) == {"gaps"}
    assert "1 gap longer than 0.005 s left out, in all signals" in told["gaps"].summary
    assert not one.good[HOLE[0] : HOLE[1]].any()
    assert one.good[: HOLE[0] - 1].all()
    assert one.good[HOLE[1] + 1 :].all()


def test_a_rig_that_stood_still_while_the_clock_ran_is_named() -> None:
    """What a simulated rig does that its PC holds up: stamps jump, physics do not."""
    t = T[: len(T) - 34]
    stamps = t + np.where(np.arange(len(t)) >= HOLE[0], 0.034, 0.0)
    one = prepare("drive", turning(t, stamps))
    lost = next(finding for finding in one.findings if finding.kind == "lost_time")
    assert "at 3.00 s, 35 ms" in lost.summary
    assert not one.good[HOLE[0] : HOLE[1]].any()


@pytest.mark.parametrize("every", [1, 2, 3])
def test_single_lost_frames_are_bridged(every: int) -> None:
    kept = np.delete(T, np.arange(100, 5900, 50 * every))
    one = prepare("drive", turning(kept, kept))
    assert one.findings == ()
    assert one.good.all()


@pytest.mark.parametrize(("jump_s", "said"), [(1.7e9, "1.7e[+]09 s"), (7200.0, "7200 s")])
def test_a_long_recording_with_next_to_nothing_in_it_is_refused(jump_s: float, said: str) -> None:
    """A clock that is set while it records: the grid was as long as the jump."""
    stamps = T + np.where(np.arange(len(T)) >= HOLE[0], jump_s, 0.0)
    with pytest.raises(InputError, match=f"without any {said}, after 2.999 s; split"):
        prepare("drive", turning(T, stamps))


def test_a_slow_signal_has_no_gaps_between_its_samples() -> None:
    t_ns = np.arange(0, 6_000_000_000, 10_000_000)
    assert gaps.holes(t_ns) == []
    assert gaps.holes(np.delete(t_ns, slice(100, 104))) == []
    assert len(gaps.holes(np.delete(t_ns, slice(100, 106)))) == 1
