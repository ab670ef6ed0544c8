"""Where and when a mismatch sits, in plain words: what people are told of the JSON's places."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from eps_hil.diagnosis.accept.free_run import DISAGREE
from eps_hil.diagnosis.accept.proof_of_fit import more_than_noise

_WORDS: Mapping[str, tuple[str, float, str]] = {
    "motor_speed_rad_s": ("rotor speed", 1.0, "rad/s"),
    "abs_motor_speed_rad_s": ("rotor speed of either sign", 1.0, "rad/s"),
    "motor_angle_rad": ("rotor angle", 1.0, "rad"),
    "motor_torque_nm": ("motor torque", 1.0, "Nm"),
    "torque_sensor_nm": ("torsion-bar torque", 1.0, "Nm"),
    "rack_force_n": ("rack force", 1.0, "N"),
    "rack_position_m": ("rack position", 1e3, "mm"),
    "steering_wheel_angle_rad": ("steering-wheel angle", 1.0, "rad"),
    "time_s": ("time", 1.0, "s"),
    "since_reversal_s": ("time since the last reversal", 1.0, "s"),
    "dwell_s": ("time at rest before it moved", 1.0, "s"),
    "motor_temperature_degc": ("motor temperature", 1.0, "°C"),
    "temperature_degc": ("temperature", 1.0, "°C"),
}
_MOST = 0.6
"""Share of the excess in one recording from which it is said to be mostly there."""
_ONLY = 0.95
_HALF = 0.5
"""Share of the excess in one stretch of time from which that is named."""
_BEYOND = 0.1
"""Share of the excess beyond that of the time, from which a place is one."""


def all_clear(limits: Sequence[str]) -> str:
    """What ``no_mismatch`` says with these ``limits`` beside it; no full stop."""
    if more_than_noise(limits):
        return "No effect of the catalogue explains what differs, and it is more than sensor noise"
    if limits:
        return "Nothing is missing that these recordings could show"
    return "Nothing is missing: what differs is sensor noise, or too small to be told from it"


def but(limits: Sequence[str]) -> str:
    """How the words of an explanation go on where ``limits`` take some of it back; else empty."""
    if any(one.startswith(f"{DISAGREE}:") for one in limits):
        return ", but a free simulation is worse with it"
    if more_than_noise(limits):
        return ", but not all of it: more than sensor noise is left"
    return ""


def place_in_words(place: Mapping[str, Any]) -> str:
    """``rack position -8 to 8 mm`` for a place of CONTRACT 7; a signal unknown here by its name."""
    signal = str(place["signal"])
    words, factor, unit = _WORDS.get(signal, (signal, 1.0, ""))
    low, high = (factor * float(place[end]) for end in ("from", "to"))
    return f"{words} {low:.4g} to {high:.4g} {unit}".rstrip()


def shares_in_words(
    places: Sequence[Mapping[str, Any]],
    where: Callable[[Mapping[str, Any]], str] = place_in_words,
) -> list[str]:
    """``87 % of it in 12 % of the time at rotor speed -20 to 20 rad/s`` for each place.

    Places of one signal that hold together as much of the time as of the excess are told at once:
    that signal hardly matters. ``where``: a place in other words.
    """
    told: dict[str, None] = {}
    for place in places:
        alike = [one for one in places if one["signal"] == place["signal"]]
        share, time = (sum(one.get(key) or 0.0 for one in alike) for key in _SHARES)
        known = all(one["share_of_excess"] and one.get("share_of_time") for one in alike)
        if known and share - time < _BEYOND:
            told[_evenly(str(place["signal"]), share, time)] = None
        else:
            told[_share_at(place, where(place))] = None
    return list(told)


_SHARES = ("share_of_excess", "share_of_time")


def _evenly(signal: str, share: float, time: float) -> str:
    name = signal.partition("|")[0]
    name = _WORDS.get(name, (name,))[0].removesuffix(" of either sign")
    much = f"{_percent(share)} of it in {_percent(time)} of the time"
    return f"{much}: hardly more at one {name} than at another"


def _share_at(place: Mapping[str, Any], where: str) -> str:
    share, time = place["share_of_excess"], place.get("share_of_time")
    if not share:
        return f"at {where}"
    if time is None:
        return f"{_percent(share)} of it at {where}"
    return f"{_percent(share)} of it in {_percent(time)} of the time at {where}"


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %" if not 0.0 < share < 0.01 else "under 1 %"


def most_in_words(location: Mapping[str, Any]) -> str:
    """The signal or pair of signals in which it stands out most, of ``location``; else empty."""
    cells = location.get("cells", [])
    if not cells:
        return ""
    cell = cells[0]
    sides = [
        place_in_words({"signal": signal, "from": low, "to": high})
        for signal, low, high in zip(cell["signals"], cell["from"], cell["to"], strict=True)
    ]
    share, time = (_percent(float(cell[one])) for one in ("share_of_excess", "share_of_time"))
    return f"{share} of it in {time} of the time: {' and '.join(sides)}"


def when_in_words(
    segments: Sequence[Mapping[str, Any]], recordings: Sequence[Mapping[str, Any]] = ()
) -> str:
    """``only in train_2`` where one recording holds it all, and the stretch that holds most of it.

    ``recordings``: each one's share of excess and time (``location.recordings``); a recording is
    named where it holds clearly more of the excess than of the time. Else empty.
    """
    several = len(recordings) > 1
    top = max(recordings, key=lambda one: one["share_of_excess"]) if several else None
    told = []
    if top is not None and top["share_of_excess"] >= _ONLY:
        told.append(f"only in {top['recording']}")
    elif top is not None and top["share_of_excess"] >= max(_MOST, top["share_of_time"] + _BEYOND):
        told.append(
            f"{100 * top['share_of_excess']:.0f} % of it in {top['recording']} "
            f"({100 * top['share_of_time']:.0f} % of the time)"
        )
    for one in segments[:1]:
        if one["share_of_excess"] >= _HALF:
            name = f" of {one['recording']}" if several else ""
            told.append(
                f"{100 * one['share_of_excess']:.0f} % of it from {one['from_s']:.1f} to "
                f"{one['to_s']:.1f} s{name}"
            )
    return "; ".join(told)
