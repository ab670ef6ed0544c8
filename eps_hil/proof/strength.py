"""How strong a hidden effect is against the noise, after all that a refit could take away.

The torque balance of the nominal model (eq. 1, 2) along the reported signals leaves a residual.
Without noise that residual is the effect; its part orthogonal to the sensitivities of all
baseline parameters is what no refit of them removes. Its rms over the rms that sensor noise
alone makes, both below 80 Hz, is the effect-to-noise ratio of the proof.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from eps_hil.compiled import njit
from eps_hil.proof.sensors import RATE_HZ, SPEED_LATE_S, TORQUE_LATE_S
from eps_hil.proof.truth import Drive, Floats

CUT_HZ, _DECIMATE, _FINE, _EDGE = 80.0, 4, 8, 100
_LATE_S = {
    "motor_speed_rad_s": SPEED_LATE_S,
    "motor_angle_rad": SPEED_LATE_S,
    "motor_torque_nm": TORQUE_LATE_S,
}
_FREE = ("k0_pos", "k0_neg", "kw_pos", "kw_neg", "kr_pos", "kr_neg", "sigma0", "sigma1")
_LAW = (
    "k0_pos", "kw_pos", "kr_pos", "k0_neg", "kw_neg", "kr_neg", "sigma0", "sigma1", "sigma1_speed",
)  # fmt: skip


@njit(error_model="numpy")
def _nominal_friction(p: Floats, speed: Floats, load: Floats, out: Floats) -> None:
    """LuGre torques (m, n) along given speed and load at 1 kHz, the bristle by backward Euler.

    ``p`` (m, 9) as :data:`_LAW`. All m at once, because one alone mostly waits for its divisions.
    """
    dt, m = 1.0e-3 / _FINE, len(p)
    k0_pos, kw_pos, kr_pos = p[:, 0].copy(), p[:, 1].copy(), p[:, 2].copy()
    k0_neg, kw_neg, kr_neg = p[:, 3].copy(), p[:, 4].copy(), p[:, 5].copy()
    sigma0, sigma1, width = p[:, 6].copy(), p[:, 7].copy(), p[:, 8].copy()
    z, stretch = np.zeros(m), np.zeros(m)
    for k in range(len(speed) - 1):
        for j in range(_FINE):
            a = j / _FINE
            w = speed[k] + a * (speed[k + 1] - speed[k])
            f = abs(load[k] + a * (load[k + 1] - load[k]))
            if w >= 0.0:
                for i in range(m):
                    stretch[i] = abs(w) * sigma0[i] / (k0_pos[i] + kw_pos[i] * w + kr_pos[i] * f)
            else:
                for i in range(m):
                    stretch[i] = abs(w) * sigma0[i] / (k0_neg[i] - kw_neg[i] * w + kr_neg[i] * f)
            for i in range(m):
                z[i] = (z[i] + w * dt) / (1.0 + stretch[i] * dt)
            if j == 0:
                for i in range(m):
                    damping = sigma1[i] * np.exp(-((w / width[i]) ** 2))
                    out[i, k] = sigma0[i] * z[i] + damping * (w - stretch[i] * z[i])
    out[:, -1] = out[:, -2]


def _frictions(drives: Sequence[Drive], speed: Floats, load: Floats) -> Floats:
    """(m, n): the friction of each drive along the same speed and load (n,)."""
    out = np.zeros((len(drives), len(speed)))
    laws = np.array([[getattr(d, name) for name in _LAW] for d in drives])
    _nominal_friction(laws, np.ascontiguousarray(speed), np.ascontiguousarray(load), out)
    return out


def aligned(columns: Mapping[str, Floats]) -> dict[str, Floats]:
    """Signals at common physical instants, by the delays that the model file states."""
    n = len(columns["motor_torque_nm"]) - round(SPEED_LATE_S * RATE_HZ)
    result = {}
    for name, values in columns.items():
        late = round(_LATE_S.get(name, 0.0) * RATE_HZ)
        result[name] = values[late : late + n]
    return result


def filtered(values: Floats) -> Floats:
    """Below 80 Hz without phase, ends cut off, every fourth sample; the last axis is time."""
    from scipy.signal import butter, sosfiltfilt

    sos = butter(4, CUT_HZ, fs=RATE_HZ, output="sos")
    return np.asarray(sosfiltfilt(sos, values, axis=-1)[..., _EDGE:-_EDGE:_DECIMATE])


def residual(d: Drive, columns: Mapping[str, Floats], friction: Floats | None = None) -> Floats:
    """Torque (Nm, at the rotor) that the nominal model leaves over, at 1 kHz.

    ``friction`` (n,) replaces the LuGre torque along the reported speed.
    """
    a = aligned(columns)
    drive = a["motor_torque_nm"] + d.pinion_rad_per_m / d.rack_rad_per_m * a["torque_sensor_nm"]
    inertial = d.inertia_kg_m2 * np.gradient(a["motor_speed_rad_s"]) * RATE_HZ
    if friction is None:
        friction = _frictions([d], a["motor_speed_rad_s"], a["rack_force_n"])[0]
    return np.asarray(drive - inertial - a["rack_force_n"] / d.rack_rad_per_m - friction)


def sensitivities(d: Drive, columns: Mapping[str, Floats]) -> Floats:
    """(p, n): what each baseline parameter can change of the residual."""
    a = aligned(columns)
    speed, load = a["motor_speed_rad_s"], a["rack_force_n"]
    rows = [np.gradient(speed) * RATE_HZ, np.ones(len(speed))]
    up = [d._replace(**{name: 1.02 * getattr(d, name)}) for name in _FREE]
    down = [d._replace(**{name: 0.98 * getattr(d, name)}) for name in _FREE]
    moved = _frictions(up + down, speed, load)
    steps = np.array([[0.04 * getattr(d, name)] for name in _FREE])
    return np.concatenate([rows, (moved[: len(up)] - moved[len(up) :]) / steps])


@dataclass(frozen=True, slots=True)
class Strength:
    """Effect (after and before projection) and noise, rms in Nm below 80 Hz."""

    effect_nm: float
    raw_nm: float
    noise_nm: float

    @property
    def ratio(self) -> float:
        """Effect-to-noise after projection."""
        return self.effect_nm / self.noise_nm

    @property
    def raw_ratio(self) -> float:
        """Effect-to-noise before projection."""
        return self.raw_nm / self.noise_nm


def noise_rms(d: Drive, clean: Mapping[str, Floats], noisy: Mapping[str, Floats]) -> float:
    """What the sensors' noise alone leaves in the torque balance (Nm rms below 80 Hz).

    Friction is left as it is without noise: a stuck bristle that noise leaks away is a weakness
    of a method, no noise of the recording.
    """
    a = aligned(clean)
    friction = _frictions([d], a["motor_speed_rad_s"], a["rack_force_n"])[0]
    difference = residual(d, noisy, friction) - residual(d, clean, friction)
    return float(np.std(filtered(difference)))


def strength(d: Drive, clean: Sequence[Mapping[str, Floats]], noise_nm: float) -> Strength:
    """Measure what is hidden in recordings without noise against the noise they will have."""
    rest = np.concatenate([filtered(residual(d, one)) for one in clean])
    free = np.concatenate([filtered(sensitivities(d, one)) for one in clean], axis=1)
    return Strength(_rms(beyond_refit(free, rest)), _rms(rest), noise_nm)


def beyond_refit(free: Floats, rest: Floats) -> Floats:
    """What of ``rest`` (n,) or (n, m) is orthogonal to the sensitivities ``free`` (p, n).

    A parameter that these recordings do not excite takes nothing away.
    """
    size = np.linalg.norm(free, axis=1)
    scaled = (free[size > 0.0] / size[size > 0.0, None]).T
    return np.asarray(rest - scaled @ np.linalg.lstsq(scaled, rest, rcond=None)[0])


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))
