"""What a diagnosis takes: recordings fit for it, and which of them are kept to judge the rest."""

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType

import numpy as np

from eps_hil.diagnosis.data.prepare import Prepared, prepare
from eps_hil.errors import InputError
from eps_hil.identification.prepare import check_rate
from eps_hil.series import Series
from eps_hil.signals import PUBLISHED

BELIEVABLE = {
    "motor_torque_nm": 1e4,
    "torque_sensor_nm": 1e4,
    "motor_speed_rad_s": 1e5,
    "motor_angle_rad": 1e7,
    "rack_force_n": 1e7,
    "rack_position_m": 1e2,
    "steering_wheel_angle_rad": 1e5,
}
"""Magnitudes beyond which a signal is no steering drive's, whatever the drive."""


FEWEST_VALUES = 16
"""Different values of the signal that tells the motion: of fewer nobody makes a speed."""


class RecordingError(ValueError):
    """What a diagnosis needs and one recording, by its name, lacks."""

    def __init__(self, recording: str, problem: str) -> None:
        super().__init__(problem)
        self.recording = recording


@contextlib.contextmanager
def refusing() -> Iterator[None]:
    """What an identification refuses is refused by a diagnosis in the same words."""
    try:
        yield
    except InputError as error:
        place = "" if error.problem.startswith(error.place) else f"{error.place}: "
        raise RecordingError(error.file, f"{place}{error.problem}; {error.remedy}") from None


def measured(recordings: Mapping[str, Mapping[str, Series]]) -> dict[str, dict[str, Series]]:
    """Recordings without what the service published: a bus log has it from before the rig began."""
    return {
        name: {signal: one for signal, one in series.items() if signal not in PUBLISHED}
        for name, series in recordings.items()
    }


def check_rates(recordings: Mapping[str, Mapping[str, Series]]) -> None:
    """:class:`RecordingError` for a time in ms, before any array is as long as it says."""
    with refusing():
        for name, series in recordings.items():
            check_rate(name, series)


def prepared(
    name: str,
    series: Mapping[str, Series],
    unexplained_nm: float,
    whole: Mapping[str, Mapping[str, Series]] = MappingProxyType({}),
) -> Prepared:
    """:func:`prepare`, with the recording's name and signals in what it refuses.

    ``whole``: recordings by name, of which this one may be a part.
    """
    for signal, most in BELIEVABLE.items():
        if signal in series and (found := _largest(series[signal])) > most:
            problem = f"{signal} reaches {found:.3g}, which no drive does; check unit and scaling"
            raise RecordingError(name, problem)
    check_values(name, series)
    try:
        one = prepare(name, series, unexplained_nm)
    except ValueError as error:
        there = ", ".join(sorted(series))
        raise RecordingError(name, f"{error} (it holds {there})") from error
    return one.changed(begins_s=_began_s(series, whole.get(name, series)))


def check_values(name: str, series: Mapping[str, Series]) -> None:
    """:class:`RecordingError` for a motion that is told in too few values to be one.

    A signal of one value rests; what that means is said where the motion is looked for.
    """
    moving = [one for one in ("motor_speed_rad_s", "motor_angle_rad") if one in series]
    if not moving:
        return
    value = series[moving[0]].value
    different = len(np.unique(value[np.isfinite(value)]))
    if 1 < different < FEWEST_VALUES:
        problem = (
            f"{moving[0]} takes {different} different values in "
            f"{len(value)} samples: too few to tell a motion by; record it in finer steps, or "
            "more of the motion"
        )
        raise RecordingError(name, problem)


def _largest(one: Series) -> float:
    return float(np.max(np.abs(one.value), initial=0.0, where=np.isfinite(one.value)))


def same_load(recordings: Sequence[Prepared]) -> None:
    """A load cell in some recordings only would be left aside in all: that is no answer."""
    without = [one.name for one in recordings if "rack_force_n" not in one.raw]
    if 0 < len(without) < len(recordings):
        raise RecordingError(
            without[0], "has no rack_force_n, but others have; leave it out, or all the others"
        )


def split(
    recordings: Mapping[str, Mapping[str, Series]], holdouts: Mapping[str, Mapping[str, Series]]
) -> tuple[Mapping[str, Mapping[str, Series]], Mapping[str, Mapping[str, Series]]]:
    """What is fitted and what is kept to judge it: by recording, else by time, never by sample.

    :class:`RecordingError` for a time in ms.
    """
    check_rates({**recordings, **holdouts})
    if holdouts:
        return dict(recordings), dict(holdouts)
    names = list(recordings)
    if len(names) > 2:
        return {n: recordings[n] for n in names[:-1]}, {names[-1]: recordings[names[-1]]}
    first: dict[str, Mapping[str, Series]] = {}
    last: dict[str, Mapping[str, Series]] = {}
    for name, series in recordings.items():
        start = min(int(one.t_ns[0]) for one in series.values())
        end = max(int(one.t_ns[-1]) for one in series.values())
        cut = start + (end - start) * 2 // 3
        first[name] = {key: _part(one, start, cut) for key, one in series.items()}
        last[name] = {key: _part(one, cut, end) for key, one in series.items()}
    return first, last


def _began_s(part: Mapping[str, Series], whole: Mapping[str, Series]) -> float:
    """How long after the start of its recording a part of it begins, s."""
    first, start = (min(int(one.t_ns[0]) for one in some.values()) for some in (part, whole))
    return 1e-9 * (first - start)


def _part(one: Series, start: int, end: int) -> Series:
    keep = slice(*np.searchsorted(one.t_ns, (start, end + 1)).tolist())
    return Series(one.t_ns[keep], one.value[keep])


def unseen(recordings: Sequence[Prepared]) -> list[str]:
    """What nobody recorded beside the load, or in noise only, and what that means."""
    hidden = [one.name for one in recordings if one.speed_is_hidden]
    said = [
        "motor_speed_rad_s is mostly its own noise; the rate of motor_angle_rad is taken for it "
        f"({', '.join(hidden)})."
    ]
    return [*(said if hidden else []), *_held_still(recordings), *_unheld(recordings)]


def _held_still(recordings: Sequence[Prepared]) -> list[str]:
    """A motor torque of one value: a motor that is off, or a channel that was not recorded."""
    still = [one.name for one in recordings if np.ptp(one.raw["motor_torque_nm"]) == 0.0]
    if not still:
        return []
    return [
        f"motor_torque_nm has one value throughout ({', '.join(still)}). If the motor was not off "
        "or held so, it was not recorded, and what is found there is the torque that is missing."
    ]


def _unheld(recordings: Sequence[Prepared]) -> list[str]:
    blind = [one.name for one in recordings if "torque_sensor_nm" not in one.raw]
    if not blind:
        return []
    where = "any recording" if len(blind) == len(recordings) else ", ".join(blind)
    return [
        f"No torsion-bar torque in {where}: what a driver or robot holds the wheel with counts as "
        "missing physics there."
    ]
