"""Constant errors of a torque sensor that hands off, or the motor off, show for themselves.

While sliding, a constant of the torsion bar, of the motor's torque and of the friction are one and
the same. Where a sensor is seen with nothing on it, what it reads then says which it is: a clear
reading goes into the model before the balance is looked at, and none takes its name off the list.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from eps_hil.diagnosis.balance.fit import Fit
from eps_hil.diagnosis.balance.problem import Problem, clipped, knee
from eps_hil.diagnosis.data.entry import around, known
from eps_hil.diagnosis.data.prepare import STEP_S, Floats, Prepared
from eps_hil.diagnosis.data.side_by_side import each
from eps_hil.identification.zero_torque import WINDOW_S, readings
from eps_hil.physics.effects.catalogue import catalogue
from eps_hil.physics.model import Model

SENSORS = {"torque_sensor_nm": "torque_sensor_offset", "motor_torque_nm": "motor_torque_offset"}
"""Signals, and the effects that are their constant errors."""
_UNEVEN = "friction_asymmetry"
"""What a constant may be that no sensor reads."""
FEWEST = 3
"""Windows: one may be a hand that lies still."""
_MOST_NM = {"torque_sensor_nm": 0.5, "motor_torque_nm": 0.2}
"""A reading beyond this, on a machine of ordinary size, is a torque that somebody holds."""
_LEAST_GAIN = 60.0
"""Noise variances that a constant has to be worth in the balance, as any effect that is seen."""
_SLIDING_RAD_S = 0.5
_AS_NOISE = 1.5
"""Times the scatter that noise alone makes, up to which it is noise."""
_OF_A_SENSOR = 0.2
"""Of the scatter that a sensor's noise makes, what a command that is none does not have."""
_FEWEST_TOGETHER, _TOGETHER = 5, 0.2
"""Windows that make a majority, and their range over the scatter of all: chance makes it wide."""
_AS_SURE = 3.0
"""Times the half width of the surest recording, up to which another one counts as sure too."""
_REFUTED = 0.5
"""Of a reading, that the balance takes back under another name."""
_SURE = 0.95


@dataclass(frozen=True)
class ZeroReading:
    """What one sensor reads (Nm) with nothing on it, less what the model knows; 95 % half width."""

    signal: str
    value: float
    half: float
    seconds: float
    gain: float
    """What such a constant is worth in the torque balance, noise variances."""
    measured: bool = True
    """Whether it has the noise of a sensor: a motor torque that is a command is none, exactly."""
    scale: float = 1.0
    """True torque per reported: what the sensor reads counts so much as an offset behind it."""

    @property
    def effect(self) -> str:
        """The effect that is this sensor's constant error."""
        return SENSORS[self.signal]

    @property
    def clear(self) -> bool:
        """Whether it is an error that counts, and surely not nothing."""
        return self.gain > _LEAST_GAIN and abs(self.value) > 2.0 * self.half

    @property
    def entry(self) -> dict[str, Any]:
        """Of a model file."""
        motor = self.signal == "motor_torque_nm"
        return {
            "effect": self.effect,
            "offset_nm": self.scale * (-self.value if motor else self.value),
        }

    def finding(self) -> dict[str, Any]:
        """The JSON entry (CONTRACT 7)."""
        effect = catalogue()[self.effect]
        sentence, values = effect.wording(self.entry)
        alone = "the motor off" if self.signal == "motor_torque_nm" else "the hands off"
        return known(
            effect.id,
            f"{sentence.format(**values)} Seen in {self.seconds:g} s of motion with {alone}.",
            {"offset_nm": around(self.entry["offset_nm"], self.scale * self.half)},
            _SURE,
            "zero torque",
        )


@dataclass(frozen=True)
class ZeroReadings:
    """What the sensors read with nothing on them, as far as the recordings show it."""

    seen: tuple[ZeroReading, ...] = ()

    @property
    def clear(self) -> list[ZeroReading]:
        """Errors, which go into the model."""
        return [one for one in self.seen if one.clear]

    @property
    def settled(self) -> set[str]:
        """Constants that what the balance shows beside the model is not called by."""
        return {one.effect for one in self.seen}

    @property
    def possible(self) -> set[str]:
        """Of those, what may be all the same: a motor whose torque is a command reads none."""
        return {one.effect for one in self.seen if not one.clear and not one.measured}

    def behind(self, found: Fit) -> "ZeroReadings":
        """The same behind a gain of the motor's torque that was found: gain · T_em + offset."""
        gains = [e["gain"] for e in found.entries if e["effect"] == "motor_torque_gain"]
        scaled = [
            replace(one, scale=gains[0]) if gains and one.signal == "motor_torque_nm" else one
            for one in self.seen
        ]
        return ZeroReadings(tuple(scaled))

    def in_model(self, model: Model) -> Model:
        """The model with the errors."""
        return replace(model, effects=(*model.effects, *(one.entry for one in self.clear)))

    def refuted(self, problem: Problem, found: Fit, judged: Sequence[Prepared]) -> bool:
        """Whether the balance takes back what was read, or the hold-outs are worse for it.

        ``problem`` has the errors in its model, and ``found`` is what was found beside them.
        """
        if not self.clear:
            return False
        read = sum(_at_rotor(one.entry, problem.model) for one in self.clear)
        back = sum(_at_rotor(entry, problem.model) for entry in found.entries)
        if back * read < 0.0 and abs(back) > _REFUTED * abs(read):
            return True
        names = {one.effect for one in self.clear}
        bare = tuple(e for e in problem.model.effects if e["effect"] not in names)
        costs = []
        for model in (problem.model, replace(problem.model, effects=bare)):
            test = Problem(judged, model)
            residual = test.residual(test.with_entries(found.entries, found.own))
            costs.append((test, residual))
        at = knee(costs[0][1])
        with_it, without = (float(np.sum(clipped(residual, at) ** 2)) for _, residual in costs)
        return with_it >= without


def zero_readings(
    recordings: Sequence[Prepared], model: Model, without: Collection[str], play_nm: float = 0.0
) -> ZeroReadings:
    """Of the sensors whose effect is not in ``without``; none where too little was recorded.

    ``play_nm``: half width of what is known of the torque sensor's play, whose middle is not
    known any better.
    """
    floor = float(np.sqrt(np.mean([one.floor_nm(model) ** 2 for one in recordings])))
    sliding = sum(np.count_nonzero(_speed(one) > _SLIDING_RAD_S) for one in recordings)
    seen = []
    for signal, effect in SENSORS.items():
        if effect in without or not all(signal in one.raw for one in recordings):
            continue
        values = each(partial(_windows_nm, signal=signal, model=model), recordings)
        white = float(np.mean([one.noise[signal] for one in recordings]))
        most = _unit_nm(signal, recordings[0]) * _MOST_NM[signal]
        reading = _together(signal, values, _of_a_window(white), most)
        if reading is None:
            continue
        unsure = play_nm if signal == "torque_sensor_nm" else 0.0
        beside = reading.value - held_nm(signal, model)
        reading = replace(reading, value=beside, half=float(np.hypot(reading.half, unsure)))
        per_nm = sliding * (_at_rotor({"effect": effect, "offset_nm": 1.0}, model) / floor) ** 2
        one = replace(reading, gain=per_nm * reading.value**2)
        if one.clear or per_nm * reading.half**2 < _LEAST_GAIN:
            seen.append(one)
    return ZeroReadings(tuple(seen))


def _speed(one: Prepared) -> Floats:
    """Of a rotor of ordinary size, rad/s, at the thinned samples."""
    return np.abs(one.thin(one.raw["motor_speed_rad_s"])) / one.size.angle


def told_apart(
    one: Prepared, model: Model, entry: Mapping[str, Any], rival: str, without: Collection[str]
) -> float:
    """Noise variances by which sensors with nothing on them tell ``entry`` from a ``rival``.

    The rival is as large as the entry is while sliding. What sensors of the effects ``without``
    read tells nothing.
    """
    size = _at_rotor(entry, model)
    if size == 0.0 or rival not in (*SENSORS.values(), _UNEVEN):
        return 0.0
    told = 0.0
    for signal, effect in SENSORS.items():
        if effect in without or effect not in (entry["effect"], rival) or signal not in one.raw:
            continue
        count = len(windows_nm(one, signal, model))
        offset_nm = size / _at_rotor({"effect": effect, "offset_nm": 1.0}, model)
        if count >= FEWEST:
            told += count * (offset_nm / _of_a_window(one.noise[signal])) ** 2
    return told


def _of_a_window(noise: float) -> float:
    """What white noise (rms) makes of one window's reading (rms)."""
    return noise * float(np.sqrt(STEP_S / WINDOW_S))


def held_nm(signal: str, model: Model) -> float:
    """What a sensor reads with nothing on it by the model's own effects, Nm."""
    effects = model.effects
    offset = sum(float(e["offset_nm"]) for e in effects if e["effect"] == SENSORS[signal])
    return offset if signal == "torque_sensor_nm" else -offset / motor_gain(model)


def motor_gain(model: Model) -> float:
    """True motor torque per reported, offsets aside."""
    return float(np.prod([e["gain"] for e in model.effects if e["effect"] == "motor_torque_gain"]))


def windows_nm(one: Prepared, signal: str, model: Model) -> list[float]:
    """What a sensor reads in every window of 2 s with motion and nothing on it, in order."""
    good = np.ones(len(one.time_s), dtype=bool)
    if one.barred is not None:
        bad = np.interp(one.time_s, one.thin_time_s, one.barred.astype(np.float64)) > 0.0
        good &= ~bad
    unit, angle = _unit_nm(signal, one), one.size.angle
    of_wheel = signal == "torque_sensor_nm"
    read = readings(  # of a drive of ordinary size
        one.raw[signal] / unit,
        one.raw["motor_speed_rad_s"] / angle,
        good,
        one.noise[signal] / unit,
        1.0 / (model.sensor_to_rotor * angle) if of_wheel else None,
    )
    return [unit * value for value in read]


def _windows_nm(one: Prepared, signal: str, model: Model) -> Floats:
    return np.array(windows_nm(one, signal, model))


def _unit_nm(signal: str, one: Prepared) -> float:
    """What 1 Nm at that sensor of an ordinary drive is on a machine of this size."""
    return one.size.power if signal == "torque_sensor_nm" else one.size.torque


def _together(
    signal: str, values: Sequence[Floats], noise: float, most: float
) -> ZeroReading | None:
    """What the windows of all recordings say, each recording by how well its own agree.

    In one of them somebody may have held a torque. Recordings with few windows go together. Where
    two that are sure contradict one another, neither is believed more than they differ.
    """
    many = [one for one in values if len(one) >= _FEWEST_TOGETHER]
    few = [one for one in values if len(one) < _FEWEST_TOGETHER]
    groups = [*many, np.concatenate(few)] if few else many
    told = [
        one for one in (_reading(signal, each, noise, most) for each in groups) if one is not None
    ]
    if not told:
        return None
    best = min(told, key=lambda one: one.half)
    weight = np.array([one.half**-2.0 for one in told])
    apart = np.array([one.value - best.value for one in told])
    mean = float(weight @ apart / np.sum(weight))
    sure = np.array([one.half < _AS_SURE * best.half for one in told])
    spread = float(np.max(np.abs(apart[sure]) - 2.0 * np.array([one.half for one in told])[sure]))
    return replace(
        best,
        value=best.value + mean,
        half=max(float(np.sum(weight)) ** -0.5, spread),
        seconds=sum(one.seconds for one, counts in zip(told, sure, strict=True) if counts),
    )


def _reading(signal: str, values: Floats, noise: float, most: float) -> ZeroReading | None:
    """What windows read together; ``noise`` is what noise alone makes of one (rms). Nothing beyond
    ``most`` (Nm).

    Their mean, where they scatter as that noise does, or where most of them lie close together and
    the others far off: torques that somebody held are not all the same. Else their median, by
    their own scatter.
    """
    from scipy.special import stdtrit

    n = len(values)
    if n < FEWEST:
        return None
    together = _closest(values)
    if len(together) >= _FEWEST_TOGETHER and np.ptp(together) < _TOGETHER * np.std(values):
        values, n = together, len(together)
        middle = float(np.mean(values))
        half = float(stdtrit(n - 1, 0.975)) * max(_AS_NOISE * float(np.std(values)), noise)
    elif float(np.std(values)) < _AS_NOISE * noise:
        middle, half = float(np.mean(values)), 1.96 * noise
    else:
        middle = float(np.median(values))
        usual = 1.4826 * float(np.median(np.abs(values - middle)))
        half = 1.2533 * float(stdtrit(n - 1, 0.975)) * max(usual, float(np.std(values)) / 3.0)
    if abs(middle) > most:
        return None
    measured = float(np.std(values)) > _OF_A_SENSOR * noise
    return ZeroReading(signal, middle, half / float(np.sqrt(n)), n * WINDOW_S, 0.0, measured)


def _closest(values: Floats) -> Floats:
    """More than half of the values, those that lie closest together (the shorth)."""
    ordered = np.sort(values)
    count = len(values) // 2 + 1
    widths = ordered[count - 1 :] - ordered[: len(values) - count + 1]
    first = int(np.argmin(widths))
    return ordered[first : first + count]


def _at_rotor(entry: Mapping[str, Any], model: Model) -> float:
    """Constant torque at the rotor while sliding that an entry stands for, Nm."""
    if entry["effect"] == "torque_sensor_offset":
        return -model.sensor_to_rotor * float(entry["offset_nm"])
    if entry["effect"] == "motor_torque_offset":
        return float(entry["offset_nm"])
    if entry["effect"] == _UNEVEN:
        return -float(entry["half_difference_nm"])
    return 0.0
