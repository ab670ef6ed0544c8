"""A recording made ready: aligned to physical instants, motion smoothed, noise measured.

Nonlinear terms are evaluated at the full 1 kHz on a lightly smoothed motion; the residual is then
low-passed once, without phase, and thinned. The filter is linear, so residual and sensitivities all
pass the same one.
"""

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.compiled import njit
from eps_hil.diagnosis.data.motor_path import (
    behind_lag,
    bends_motor_torque,
    follows_motor_torque,
    what_it_follows,
)
from eps_hil.diagnosis.data.noise import half_rate_hz, noise_at_1_khz, passed_of_band
from eps_hil.diagnosis.data.seen_twice import motion_hz
from eps_hil.diagnosis.data.size import ORDINARY, Size
from eps_hil.identification.butterworth import low_pass, passed
from eps_hil.identification.filters import every_so_many, on_grid, shifted
from eps_hil.physics.balance import Key, Motion, motor_torque_acting_nm, residual_nm
from eps_hil.physics.effects.catalogue import with_model_effects
from eps_hil.physics.model import Model
from eps_hil.physics.simulate import rack_position_m
from eps_hil.series import Series

Floats = npt.NDArray[np.float64]

STEP_S = 1e-3
CUTOFF_HZ = 40.0
THIN = 8
"""Every THIN-th sample of the filtered residual is kept: 125 Hz, above twice the cut-off."""
SMOOTH_HZ = 100.0
"""Low-pass of the speed that friction is evaluated at."""
CLEAR_SIGMA, _CLEARER = 8.0, 0.5
"""Sliding means that the smoothed speed is so many deviations of its noise from zero; a share of a
measured speed's noise that the angle's rate has to stay below to take its place."""
SLOW_HZ, TAKEN_UP = 4.0, 6
"""Below this an arbitrary force takes up what the balance lacks, in so many rounds."""
REST_WINDOW_S, REST_RAD_S = 0.03, 0.02
CREEP_HZ = 20.0
"""Low-pass of the angle that shows how a resting rotor creeps."""
_LOST_SIGMAS = 5.0
"""Noise that a turn of a resting rotor has to stand out of, of the low-passed angle."""
_FORCE_HZ, _NO_FORCE = 10.0, 1.6
"""A rack force whose mean size is below so many noise deviations (of noise alone: 0.8) is slow."""
FEWEST_STEPS = 2.0
"""Of the balance's grid in one step of the fastest signal, where all are slower than 1 kHz."""
EDGE_S = 0.25
"""Left out at both ends of a recording, where a filter without phase has only one side."""

_MOST_SHIFTED, _LEAST_SHIFTED = 40, 12
_MOST_SHIFTED_BYTES = 200_000_000
"""Of all recordings together: an hour's signals are 29 MB each. Where there is no room for the
twelve that one balance may need, none is remembered: they would only push each other out."""
_SAMPLED = 3e-4
"""Of the motor torque's rms: what the balance of a sampled recording leaves without any noise. A
torque that steps, or friction that turns, between samples of 1 ms leaves nearly as much."""
_MOST_SHARES = 6
_STRAYED = 0.461
"""∫(W − mean W)² dt over a Brownian bridge's or a random walk's unit time exceeds this in 5 of 100:
Cramér's and von Mises' statistic."""
_NEEDED, _MOVING = ("motor_torque_nm",), ("motor_speed_rad_s", "motor_angle_rad")
_DERIVATIVES = {"motor_speed_rad_s": 1, "motor_angle_rad": 2}
"""Of a signal in the balance."""


@dataclass(frozen=True)
class Prepared:
    """One recording on a 1 kHz grid of its own time base; ``raw`` holds signals as reported."""

    name: str
    time_s: Floats
    raw: Mapping[str, Floats]
    noise: Mapping[str, float]
    speed_is_derived: bool
    unexplained_nm: float = 0.0
    """What somebody's simulator leaves open (``simulation.py``): no difference below it counts."""
    barred: npt.NDArray[np.bool_] | None = None
    """Thinned samples that nothing may be concluded from (``first_look.py``); None: no such."""
    interval_s: float = STEP_S
    """Between samples of the slowest signal that the balance needs: no instant is known better."""
    begins_s: float = 0.0
    """Where its own time is 0, since the start of a recording of which it is the last part."""
    taken_from: Floats | None = None
    """Balance (n,), Nm, from which an unmeasured force was taken that takes up whatever is slow."""
    load_is_assumed: bool = False
    """Whether ``raw``'s rack force is a load that was fitted, where nobody measured one."""
    slack_rad_s2: Floats | None = None
    """What a belt that gives adds to the acceleration of all inertia (``belt.py``), (n,)."""
    size: Size = ORDINARY
    """How large the machine is by all recordings."""
    bands_hz: Mapping[str, float] = field(default_factory=dict)
    """Half the rate that a signal was sampled at: between samples there is no noise of its own."""
    motion_hz: float = np.inf
    """Beyond this a slow speed's changes are not seen by the angle: no acceleration."""
    speed_is_hidden: bool = False
    """Whether a speed was measured, but mostly noise, so that the angle's rate took its place."""
    among: int = 1
    """Recordings that are looked at together, and share what may be remembered of them."""
    _shifted: dict[tuple[Any, ...], Floats] = field(default_factory=dict)
    """Signals at other instants, and what friction was along the motion."""

    def changed(self, **values: Any) -> "Prepared":
        """A copy with fields changed; what is remembered of the signals goes with them."""
        more = values.keys() - {"barred", "unexplained_nm", "interval_s"}
        if more - {"raw"} or "_kinematics" not in self.__dict__:
            return replace(self, _shifted={}, **values)
        raw = values.get("raw", self.raw)
        same = {name for name in raw if raw[name] is self.raw.get(name)}
        copy = replace(self, **values, _shifted={} if more else self._shifted)
        if all(name in same for name in _MOVING if name in raw or name in self.raw):
            copy.__dict__["_kinematics"] = self._kinematics
        if "_without_noise" in self.__dict__ and "rack_force_n" in same:
            copy.__dict__["_without_noise"] = self._without_noise
        return copy

    def alone(self) -> "Prepared":
        """The same, looked at by itself: what is remembered of its signals goes with it."""
        copy = replace(self, among=1, _shifted={})
        for name in ("_kinematics", "_without_noise"):
            copy.__dict__[name] = getattr(self, name)
        return copy

    def by_angle(self) -> "Prepared":
        """The same with the angle's rate for its speed."""
        angle = self.raw["motor_angle_rad"]
        band_hz = self.bands_hz.get("motor_angle_rad", np.inf)
        speed, noise = _rate(angle, self.noise["motor_angle_rad"], band_hz)
        return self.changed(
            bands_hz={**self.bands_hz, "motor_speed_rad_s": band_hz},
            raw={**self.raw, "motor_speed_rad_s": speed},
            noise={**self.noise, "motor_speed_rad_s": noise},
            speed_is_derived=True,
        )

    def never_resting(self) -> "Prepared":
        """The same with its speed as it was measured also where that is nothing but noise.

        At rest that wears a bristle down; a rotor that only turns round loses its way without it.
        """
        smooth = low_pass(self.raw["motor_speed_rad_s"], SMOOTH_HZ)
        travel = _moved(smooth)
        copy = replace(self, _shifted={})
        copy.__dict__["_kinematics"] = {**self._kinematics, "speed": smooth, "travel": travel}
        return copy

    def smoothly_moved(self) -> "Prepared":
        """The same with its smoothed motion as that which the signals show without any noise."""
        smooth = low_pass(self.raw["motor_speed_rad_s"], SMOOTH_HZ)
        moved, raw = self._kinematics["travel"], {**self.raw, "motor_speed_rad_s": smooth}
        angle = self._kinematics["angle"][0] + np.cumsum(moved)
        if "motor_angle_rad" in raw:
            raw["motor_angle_rad"] = angle
        slack = 0.0 if self.slack_rad_s2 is None else self.slack_rad_s2
        copy = replace(self, raw=raw, _shifted={})
        copy.__dict__["_kinematics"] = {
            **self._kinematics,
            "angle": angle,
            "acceleration": np.gradient(smooth, STEP_S) + slack,
        }
        return copy

    def as_measured(self) -> "Prepared":
        """The same without a load that was only assumed: what a simulation is driven by."""
        if not self.load_is_assumed:
            return self
        raw = {name: values for name, values in self.raw.items() if name != "rack_force_n"}
        noise = {name: size for name, size in self.noise.items() if name != "rack_force_n"}
        return self.changed(raw=raw, noise=noise, load_is_assumed=False, taken_from=None)

    def cut(self, first: int, last: int) -> "Prepared":
        """The window of samples ``first`` (a multiple of THIN) to ``last``, with their time."""
        window = slice(first, min(last, len(self.time_s)))
        cut = self.changed(
            time_s=self.time_s[window],
            raw={name: values[window] for name, values in self.raw.items()},
            slack_rad_s2=None if self.slack_rad_s2 is None else self.slack_rad_s2[window],
            taken_from=None if self.taken_from is None else self.taken_from[window],
        )
        if self.barred is None:
            return cut
        start = first // THIN
        return cut.changed(barred=self.barred[start : start + len(cut.thin_time_s)])

    def motion(self, model: Model) -> Motion:
        """The motion at physical instants under the delays of ``model`` (its effects included)."""
        return self._motion(model, 1)

    def _motion(self, model: Model, every: int) -> Motion:
        """The same at every so many samples, of which thinned ones are some."""
        delays = with_model_effects(model).delays_s
        late = delays.of("motor_angle_rad" if self.speed_is_derived else "motor_speed_rad_s")
        late_angle = delays.of("motor_angle_rad")
        kinematics = self._kinematics
        angle = self._at(kinematics["angle"], late_angle, every)
        if "rack_position_m" in self.raw:
            position = self._at(self.raw["rack_position_m"], 0.0, every)
        else:
            position = rack_position_m(model, angle)
        return Motion(
            self._at(self.time_s, 0.0, every),
            self._signal("motor_torque_nm", delays.of("motor_torque_nm"), every),
            self._signal("torque_sensor_nm", delays.of("torque_sensor_nm"), every),
            self._signal("rack_force_n", delays.of("rack_force_n"), every),
            position,
            self._at(kinematics["speed"], late, every),
            angle,
            self._at(kinematics["travel"], late, every, summed=True),
            self._at(kinematics["travel"], late, every, summed=True, size=True),
            self._at(kinematics["acceleration"], late, every),
        )

    def residual(self, model: Model) -> tuple[Floats, Floats]:
        """(residual, friction plus load torque), filtered and thinned, Nm at the rotor, (m,)."""
        raw, torque = self._balance(model, self.every)
        return self._thinned(self._told(raw), self.every), self._thinned(torque, self.every)

    def left_over(self, model: Model) -> Floats:
        """The residual alone, filtered and thinned, Nm at the rotor, (m,)."""
        return self._thinned(self._told(self._balance(model, self.every)[0]), self.every)

    def balance(self, model: Model) -> Floats:
        """The residual at 1 kHz, not filtered, Nm at the rotor, (n,)."""
        return self._balance(model, 1)[0]

    def _balance(self, model: Model, every: int) -> tuple[Floats, Floats]:
        def friction(follows: Key, whole: bool, work: Callable[[], Floats]) -> Floats:
            """Worked out once for what it follows from: most of what a model may lack is none."""
            delays = with_model_effects(model).delays_s
            own = "motor_angle_rad" if self.speed_is_derived else "motor_speed_rad_s"
            late = delays if whole else (delays.of(own), delays.of("rack_force_n"))
            key = ("friction", every, late, *follows)
            found = self._shifted.pop(key, None)
            if found is None:
                found = work()
                self._remember(key, found, self.time_s.nbytes)
            else:
                self._shifted[key] = found
            return found

        motion = self._motion(model, every)
        rubbing, driving = self._rubbing_n(model, every), self._driving_nm(model, every)
        return residual_nm(model, motion, rubbing, friction, driving)

    @cached_property
    def every(self) -> int:
        """Samples of 1 ms in a step of the balance: between slow signals' samples nothing is told.

        A power of two, for thinned samples are on any such grid.
        """
        if self.taken_from is not None:
            return 1
        most = 1.0 / (FEWEST_STEPS * 2.0 * self.band_hz * STEP_S)
        return max(k for k in (1, 2, 4) if k <= max(most, 1.0))

    @cached_property
    def band_hz(self) -> float:
        """Half the rate of its fastest signal; no limit at 1 kHz."""
        own = [name for name in self.raw if name != "rack_force_n" or not self.load_is_assumed]
        return max(self.bands_hz.get(name, np.inf) for name in own)

    @property
    def independent(self) -> float:
        """Independent samples in a thinned one: what filter and signals pass of what is kept."""
        return 2.0 * min(CUTOFF_HZ, self.band_hz) * THIN * STEP_S

    def _told(self, balance: Floats) -> Floats:
        """The balance, less what the force would have taken of it too (``taken_from``)."""
        if self.taken_from is None:
            return balance
        more = balance - self.taken_from
        for _ in range(TAKEN_UP):
            more = more - low_pass(more, SLOW_HZ)
        return np.asarray(self.taken_from + more)

    def thin(self, signal: Floats) -> Floats:
        """Low-pass without phase at CUTOFF_HZ, edges off, every THIN-th sample."""
        return self._thinned(signal, 1)

    def _thinned(self, signal: Floats, every: int) -> Floats:
        """The same of a signal at every so many samples."""
        first, step = round(EDGE_S / STEP_S) // every, THIN // every
        last = first + step * len(self.thin_time_s)
        return np.ascontiguousarray(low_pass(signal, CUTOFF_HZ * every)[first:last:step])

    @property
    def since_start_s(self) -> Floats:
        """Time since the start of the whole recording, (n,): what a drifting clock goes by."""
        return self.time_s + self.begins_s

    @cached_property
    def thin_time_s(self) -> Floats:
        """Instants of the thinned samples."""
        edge = round(EDGE_S / STEP_S)
        return self.time_s[edge : len(self.time_s) - edge : THIN]

    def floor_nm(self, model: Model) -> float:
        """Rms (Nm) that sensor noise alone leaves in the thinned residual.

        Under ``model``: what it multiplies a signal with, it multiplies the signal's noise with.
        """
        return max(float(np.sqrt(sum(self.noise_parts_nm2(model)))), self.sampled_nm)

    def noise_parts_nm2(self, model: Model) -> tuple[float, float, float]:
        """That floor's variances (Nm²): of motor torque, of what acts behind it, of J · ω̇."""
        worked_in = with_model_effects(model)
        gains = {str(e["effect"]): float(e["gain"]) for e in worked_in.effects if "gain" in e}
        motor = self.acting_share(worked_in)
        sensor = worked_in.sensor_to_rotor / gains.get("torque_sensor_gain", 1.0)
        load = 1.0 / worked_in.rack_to_rotor_ratio_rad_per_m
        lag = behind_lag(worked_in, CUTOFF_HZ)
        behind = sensor**2 * self._noise_left("torque_sensor_nm")
        behind += load**2 * self._noise_left("rack_force_n")
        return (
            motor**2 * self._noise_left("motor_torque_nm") * lag,
            behind,
            worked_in.inertia_kg_m2**2 * self._acceleration_variance(),
        )

    def acting_share(self, model: Model) -> float:
        """What acts of a small change of the reported motor torque while the rotor moves, rms.

        Saturation, or a law that takes torque off, makes noise and all that is left smaller too.
        """
        if not any(bends_motor_torque(entry) for entry in model.effects):
            return 1.0
        follows = what_it_follows(model)
        for known, share in [*self._shares]:  # other threads may add to it at any time
            if known == follows:
                return share
        share = self._acting_share(model)
        self._shares.append((follows, share))
        return share

    @cached_property
    def _shares(self) -> "deque[tuple[Key, float]]":
        """What acted under the last few models, by what that follows from."""
        return deque(maxlen=_MOST_SHARES)

    def _acting_share(self, model: Model) -> float:
        motion = self._motion(model, self.every)
        torque = motion.motor_torque_nm
        size = max(self.noise["motor_torque_nm"], _SAMPLED * float(np.std(torque)), 1e-12)
        up, down = (
            motor_torque_acting_nm(model, motion._replace(motor_torque_nm=torque + one))
            for one in (size, -size)
        )
        moving = motion.speed_rad_s != 0.0
        slope = (up - down)[moving] / (2.0 * size)
        return float(np.sqrt(np.mean(slope**2))) if moving.any() else 1.0

    @cached_property
    def sampled_nm(self) -> float:
        """What sampling leaves of a recording without any noise, Nm: no floor is nothing."""
        torque = self.raw["motor_torque_nm"]
        return max(_SAMPLED * float(np.sqrt(np.mean(torque**2))), 1e-15)

    @property
    def strayed_rad(self) -> float:
        """Rms error about its mean of an angle that is the sum of a noisy speed; 0 if measured."""
        if "motor_angle_rad" in self.raw:
            return 0.0
        variance = _STRAYED * STEP_S**2 * len(self.time_s)
        return self.noise["motor_speed_rad_s"] * float(np.sqrt(variance))

    @property
    def lost_path_rad(self) -> float:
        """How far a resting rotor creeps back before it shows in the angle's noise."""
        return (
            _LOST_SIGMAS
            * self.noise.get("motor_angle_rad", 0.0)
            * float(np.sqrt(2 * CREEP_HZ * STEP_S))
        )

    @property
    def speed_noise_rad_s(self) -> float:
        """Deviation of the smoothed speed by noise alone."""
        band_hz = min(SMOOTH_HZ, self.bands_hz.get("motor_speed_rad_s", np.inf))
        return self.noise["motor_speed_rad_s"] * float(np.sqrt(2.0 * band_hz * STEP_S))

    @cached_property
    def slow_rate(self) -> tuple[Floats, float] | None:
        """(the angle's rate below SLOW_HZ (n,), its noise), rad/s; None where nobody measured one.

        It shows that a rotor turns slowly where a coarse speed does not, of which samples that lie
        far apart leave no mean to be taken.
        """
        if self.speed_is_derived or "motor_angle_rad" not in self.raw:
            return None
        if not np.isfinite(self.bands_hz.get("motor_speed_rad_s", np.inf)):
            return None
        rate = np.gradient(low_pass(self.raw["motor_angle_rad"], SLOW_HZ), STEP_S)
        band_hz = self.bands_hz.get("motor_angle_rad", np.inf)
        variance = passed_of_band(band_hz, SLOW_HZ, 2)
        return rate, self.noise["motor_angle_rad"] * float(np.sqrt(variance))

    def _acceleration_variance(self) -> float:
        """Of the filtered acceleration, by noise alone, rad²/s⁴."""
        corner = min(CUTOFF_HZ, self.motion_hz)
        if self.speed_is_derived:
            return self._noise_left("motor_angle_rad", 4, corner)
        return self._noise_left("motor_speed_rad_s", 2, corner)

    def _noise_left(self, name: str, power: int = 0, corner_hz: float = CUTOFF_HZ) -> float:
        """Variance of a filtered signal by noise alone, times (2πf) to this power."""
        band_hz = self.bands_hz.get(name, np.inf)
        return self.noise.get(name, 0.0) ** 2 * passed_of_band(band_hz, corner_hz, power)

    def _signal(self, name: str, delay_s: float, every: int) -> Floats:
        if name not in self.raw:
            return np.zeros(len(self._at(self.time_s, 0.0, every)))
        return self._at(self.raw[name], delay_s, every)

    def _at(
        self,
        values: Floats,
        delay_s: float,
        every: int = 1,
        *,
        summed: bool = False,
        size: bool = False,
    ) -> Floats:
        """A signal, or its ``size``, at physical instants."""
        if delay_s == 0.0 and every == 1:
            return np.abs(values) if size else values
        key = (id(values), delay_s, every, size)
        found = self._shifted.pop(key, None)  # other threads may take one away at any time
        if found is None:
            first = round(EDGE_S / STEP_S) % every  # the first thinned sample is one of them
            # straight lines would take noise off between the samples, and a delay would gain by it
            late = shifted(np.abs(values) if size else values, delay_s)
            if size:  # cubics go below zero beside a rest, and a path has no way back
                late = np.maximum(late, 0.0)
            found = every_so_many(late, every, first, summed=summed)
            self._remember(key, found, values.nbytes)
        else:
            self._shifted[key] = found
        return found

    def _remember(self, key: tuple[Any, ...], found: Floats, size: int) -> None:
        most = min(_MOST_SHIFTED, _MOST_SHIFTED_BYTES // (size * self.among))
        if most < _LEAST_SHIFTED:
            return
        for old in [*self._shifted][: -most + 1]:
            self._shifted.pop(old, None)  # what was wanted last stands last
        self._shifted[key] = found

    @cached_property
    def _kinematics(self) -> Mapping[str, Floats]:
        """Smoothed speed (zero at rest), travel and raw acceleration at report stamps."""
        speed = self.raw["motor_speed_rad_s"]
        smooth = low_pass(speed, SMOOTH_HZ)
        resting = self._resting(speed)
        if "motor_angle_rad" in self.raw:
            angle = self.raw["motor_angle_rad"]
            slow = low_pass(angle, CREEP_HZ)
            creep = np.diff(with_play(slow, 0.5 * self.lost_path_rad), prepend=slow[0])
        else:
            angle = np.cumsum(smooth) * STEP_S
            creep = np.zeros(len(speed))
        travel = np.where(resting, creep, _moved(smooth))
        travel[0] = 0.0
        return {
            "speed": np.where(resting, 0.0, smooth),
            "angle": angle,
            "travel": travel,
            "acceleration": np.gradient(self._of_motion(speed), STEP_S)
            + (0.0 if self.slack_rad_s2 is None else self.slack_rad_s2),
        }

    def _of_motion(self, speed: Floats) -> Floats:
        """What of a speed's changes is motion."""
        return low_pass(speed, self.motion_hz) if np.isfinite(self.motion_hz) else speed

    def _rubbing_n(self, model: Model, every: int) -> Floats | None:
        """The rack force that friction grows with, at physical instants."""
        force = self._without_noise
        delays = with_model_effects(model).delays_s
        return None if force is None else self._at(force, delays.of("rack_force_n"), every)

    def _driving_nm(self, model: Model, every: int) -> Floats | None:
        """The motor torque that a law follows, with no more noise than speed has."""
        if not any(follows_motor_torque(entry) for entry in model.effects):
            return None
        delays = with_model_effects(model).delays_s
        return self._at(self._slow_torque_nm, delays.of("motor_torque_nm"), every)

    @cached_property
    def _slow_torque_nm(self) -> Floats:
        return low_pass(self.raw["motor_torque_nm"], SMOOTH_HZ)

    @cached_property
    def _without_noise(self) -> Floats | None:
        """The rack force, low-passed where it is no more than noise; None where it is nowhere.

        Noise of a free rack's load cell has a size, too: |F| of it would rub.
        """
        sigma = self.noise.get("rack_force_n", 0.0)
        if sigma == 0.0 or "rack_force_n" not in self.raw:
            return None
        force = self.raw["rack_force_n"]
        lost = low_pass(np.abs(force), _FORCE_HZ) < _NO_FORCE * sigma
        if not lost.any():
            return None
        slow = low_pass(force, _FORCE_HZ)
        hidden = 3.0 * sigma * float(np.sqrt(passed(_FORCE_HZ, 0)))
        return np.where(lost, np.where(np.abs(slow) < hidden, 0.0, slow), force)

    def _resting(self, speed: Floats) -> npt.NDArray[np.bool_]:
        """Where the mean speed over a window is no more than its noise would make it."""
        n = max(3, round(REST_WINDOW_S / STEP_S) | 1)
        window = np.ones(n) / n
        mean = np.convolve(np.pad(speed, n // 2, mode="edge"), window, mode="valid")
        sigma = self.noise["motor_speed_rad_s"] / np.sqrt(n)
        return np.asarray(np.abs(mean) < max(4.0 * sigma, REST_RAD_S * self.size.angle))


def _moved(speed: Floats) -> Floats:
    """Way since the sample before, rad: half a sample more is a tenth of a quick presliding."""
    return np.concatenate([[0.0], 0.5 * STEP_S * (speed[1:] + speed[:-1])])


def prepare(name: str, series: Mapping[str, Series], unexplained_nm: float = 0.0) -> Prepared:
    """Put one recording on a 1 kHz grid; ``ValueError`` says what is missing for a diagnosis."""
    used = {name: one for name, one in series.items() if len(one.t_ns) > 1}
    derived = "motor_speed_rad_s" not in used
    for needed in (*_NEEDED, "motor_angle_rad" if derived else "motor_speed_rad_s"):
        if needed not in used:
            values = "two values of " if needed in series else ""
            raise ValueError(f"a diagnosis needs {values}{needed}")
    origin = max(int(one.t_ns[0]) for one in used.values())
    end = min(int(one.t_ns[-1]) for one in used.values())
    n = (end - origin) // 1_000_000 + 1
    if n * STEP_S < 2.0:
        raise ValueError("is shorter than 2 s, too short for a diagnosis")
    t_ns = np.arange(n, dtype=np.int64) * 1_000_000
    start = min(int(one.t_ns[0]) for one in used.values())
    raw = {name: on_grid(one, origin, t_ns) for name, one in used.items()}
    noise = {
        name: noise_at_1_khz(one, moving=name in _MOVING, derivatives=_DERIVATIVES.get(name, 0))
        for name, one in used.items()
    }
    bands = {name: half_rate_hz(one) for name, one in used.items()}
    if derived:
        bands["motor_speed_rad_s"] = bands["motor_angle_rad"]
        speed, sigma = _rate(
            raw["motor_angle_rad"], noise["motor_angle_rad"], bands["motor_angle_rad"]
        )
        raw["motor_speed_rad_s"], noise["motor_speed_rad_s"] = speed, sigma
    time_s = np.asarray(t_ns * 1e-9 + (origin - start) * 1e-9, dtype=np.float64)
    balance = ("motor_torque_nm", "motor_speed_rad_s", "motor_angle_rad", "rack_force_n")
    slowest = max(float(np.median(np.diff(used[n].t_ns))) for n in balance if n in used) * 1e-9
    interval = max(slowest, STEP_S)
    one = Prepared(
        name, time_s, raw, noise, derived, unexplained_nm, interval_s=interval, bands_hz=bands
    )
    return _seen_by_angle(seen_twice([one])[0])


def seen_twice(recordings: Sequence[Prepared]) -> list[Prepared]:
    """With the end of what speed and angle both tell, where both are slower than the grid.

    One for all ``recordings`` of a machine, which tell it together.
    """
    slow = [one for one in recordings if _is_slow_twice(one)]
    if not slow:
        return list(recordings)
    most_hz = min(one.bands_hz[name] for one in slow for name in _MOVING)
    pairs = [
        (one.raw["motor_speed_rad_s"], one.by_angle().raw["motor_speed_rad_s"]) for one in slow
    ]
    end = motion_hz(pairs, STEP_S, min(most_hz, CUTOFF_HZ))
    return [one.changed(motion_hz=end) if _is_slow_twice(one) else one for one in recordings]


def _is_slow_twice(one: Prepared) -> bool:
    """Whether speed and angle were both measured, and more slowly than the grid."""
    measured = not one.speed_is_derived and "motor_angle_rad" in one.raw
    return measured and all(np.isfinite(one.bands_hz[name]) for name in _MOVING)


def _seen_by_angle(one: Prepared) -> Prepared:
    """The angle's rate for the speed where that is mostly noise and the angle's rate is not."""
    if one.speed_is_derived or "motor_angle_rad" not in one.raw:
        return one
    usual = float(np.sqrt(np.mean(one.raw["motor_speed_rad_s"] ** 2)))
    if CLEAR_SIGMA * one.speed_noise_rad_s < usual:
        return one
    other = one.by_angle()
    clearer = other.speed_noise_rad_s < _CLEARER * one.speed_noise_rad_s
    return other.changed(speed_is_hidden=True) if clearer else one


def _rate(angle: Floats, noise: float, band_hz: float) -> tuple[Floats, float]:
    """(speed, its noise: white, as strong in the smoothed speed) from an angle and its noise."""
    share = passed_of_band(band_hz, SMOOTH_HZ, 2) / passed_of_band(band_hz, SMOOTH_HZ, 0)
    return np.gradient(low_pass(angle, SMOOTH_HZ), STEP_S), noise * float(np.sqrt(share))


@njit
def with_play(angle: Floats, half_width: float) -> Floats:
    """The angle followed only past a gap: noise inside it is no path, and wears no bristle down."""
    out = np.empty(len(angle))
    held = angle[0]
    for k in range(len(angle)):
        if angle[k] > held + half_width:
            held = angle[k] - half_width
        elif angle[k] < held - half_width:
            held = angle[k] + half_width
        out[k] = held
    return out
