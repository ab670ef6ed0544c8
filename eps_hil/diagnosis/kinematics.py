"""The second residual: where the rotor is against where the rack is, and what the twist says.

    e = φ − i_APA · x           (rad at the rotor; zero for a rigid drive)
    u = ψ_wheel − i_pi · x      (rad at the column; the torsion bar's twist)

Play between rotor and rack, a belt that gives, a ratio that changes with x and play in the torque
sensor show here directly; in the torque balance they look like noise. With the transmitted torque
τ = F/i_APA − (i_pi/i_APA)·T_sen + J₂ω̇ an elastic belt makes e = τ/c, play makes e jump by the gap
where τ changes its sign, a wrong ratio makes it grow with x, a late angle with the speed.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.drift import drift_matters
from eps_hil.diagnosis.prepare import Prepared, low_pass, with_play
from eps_hil.physics.effects.catalogue import catalogue
from eps_hil.physics.model import Model

Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

BLOCK_S = 2.0
LEAST_GAIN = 60.0
"""Least gain (noise variances, on blocks not fitted) of an accepted effect…"""
LEAST_SHARE = 0.1
"""…and least share of what the residual holds above the noise."""
LEAST_COMPLIANCE = 1.0 / 60.0
"""rad/Nm; a stiffer drive resonates above 150 Hz, where no torque balance sees it."""
LEAST_GAP_RAD = 0.02
LEAST_PLAY_NM = 0.03
LEAST_RATIO = 0.004
_OPEN_NM, _WIDE = 0.03, 9
"""Within so many thinned samples of a smaller transmitted torque a gap may be open."""
_CONTACT_NM = 0.01
"""Transmitted torque at which a gap counts as closed."""
_ONE_SOURCE = 1e-3
"""A rack position this near (rad at the rotor) to the angle was made from it."""
_LEAST_TWIST = 0.9
"""Least correlation of twist and torque for the twist to be the torsion bar's."""
_INERTIA_SHARE = 0.33
_TWIST_HZ = 40.0
_PLAY_HZ = 15.0
_CLEAR = 4.0
"""Play is seen where it is this many deviations of the twist's noise."""
_PLAYS_NM = (0.05, 0.1, 0.2, 0.4, 0.8)


@dataclass(frozen=True)
class Seen:
    """One effect seen in the kinematics: its entry, deviations of its numbers, its gain."""

    entry: dict[str, Any]
    sigma: Mapping[str, float]
    gain: float
    share: float
    where: tuple[tuple[str, float, float, float], ...]


@dataclass(frozen=True)
class Kinematics:
    """What the second residual shows; ``content`` is for the JSON, empty where there is none.

    ``coefficients``: of the whole fit, by column name. ``twist`` (gain, damping, offset) turns the
    twist into torque, where play in the sensor was found.
    """

    seen: tuple[Seen, ...] = ()
    content: dict[str, Any] = field(default_factory=dict)
    twist: tuple[float, float, float] | None = None
    gap_rad: float = 0.0

    def corrected(self, one: Prepared, model: Model) -> Prepared:
        """The recording with the torsion-bar torque that the twist shows in place of the report."""
        if self.twist is None or not _has_twist(one):
            return one
        gain, damping, offset = self.twist
        twist = _twist(one, model)
        true = gain * twist + damping * np.gradient(low_pass(twist, _TWIST_HZ), 1e-3) + offset
        late = model.delays_s.of("torque_sensor_nm")
        raw = {**one.raw, "torque_sensor_nm": np.interp(one.time_s - late, one.time_s, true)}
        sigma = gain * _twist_noise(one, model)
        return one.changed(raw=raw, noise={**one.noise, "torque_sensor_nm": sigma})

    def put_right(self, one: Prepared, model: Model) -> Prepared:
        """As :meth:`corrected`, with the samples barred at which the drive is in two pieces."""
        loose = self.loose(one, model)
        right = self.corrected(one, model)
        return right.changed(barred=loose if one.barred is None else one.barred | loose)

    def loose(self, one: Prepared, model: Model) -> Flags:
        """Thinned samples at which the gap is open and the drive in two pieces, shape (m,)."""
        n = len(one.thin_time_s)
        if self.gap_rad == 0.0 or "rack_position_m" not in one.raw:
            return np.zeros(n, dtype=bool)
        return _changing(one.thin(_transmitted(one, model)))


def examine(
    fitted: Sequence[Prepared],
    judged: Sequence[Prepared],
    model: Model,
    without: Collection[str] = (),
) -> Kinematics:
    """Look at rotor against rack, and at the twist, of all recordings that hold them.

    An effect is seen only if it also lowers the same residual of the ``judged`` recordings, and
    if its id is not in ``without``.
    """
    seen: list[Seen] = []
    content: dict[str, Any] = {}
    gap = 0.0
    rows = [_Rows(one, model) for one in fitted if _has_rack(one, model)]
    kept = [_Rows(one, model) for one in judged if _has_rack(one, model)]
    if rows:
        found, content = _rotor_against_rack(rows, kept)
        found = [one for one in found if one.entry["effect"] not in without]
        seen += found
        gap = next((s.entry["gap_rad"] for s in found if s.entry["effect"] == "backlash"), 0.0)
    twist = None
    play = _sensor_play(fitted, judged, model)
    if play is not None and play[0].entry["effect"] not in without:
        seen.append(play[0])
        twist = play[1]
    return Kinematics(tuple(seen), content, twist, gap)


class _Rows:
    """Thinned residual and regressors of one recording."""

    def __init__(self, one: Prepared, model: Model) -> None:
        motion = one.motion(model)
        ratio = model.rack_to_rotor_ratio_rad_per_m
        self.one = one
        torque = _transmitted(one, model)
        closed = ~_changing(one.thin(torque))

        def thin(values: Floats) -> Floats:
            return one.thin(values)[closed]

        self.e = thin(motion.angle_rad - ratio * motion.position_m)
        self.x = thin(motion.position_m)
        self.torque, self.force = thin(torque), thin(motion.rack_force_n)
        self.columns = {
            "ratio": ratio * self.x,
            "delay": -thin(motion.speed_rad_s),
            "drift": -thin(motion.speed_rad_s * (one.time_s - one.time_s[0])) * 1e-6,
            "compliance": self.torque,
            "inertia": thin(model.inertia_kg_m2 * motion.acceleration_rad_s2),
            "half_gap": np.tanh(self.torque / _CONTACT_NM),
            "ratio_slope": ratio * self.x * self.x,
            "ratio_bend": ratio * self.x**3,
        }
        sigma = np.hypot(
            one.noise.get("motor_angle_rad", 0.0), ratio * one.noise["rack_position_m"]
        )
        self.sigma = max(float(sigma) * np.sqrt(_passed()), 1e-6)
        block = (one.thin_time_s - one.thin_time_s[0]) // BLOCK_S
        self.block = block[closed].astype(np.int64)


def _changing(torque: Floats) -> Flags:
    """Where the transmitted torque is about to change its sign: a gap may be open there."""
    small = np.abs(torque) < _OPEN_NM
    small |= np.append(np.diff(np.sign(torque)) != 0, False)
    return np.asarray(np.convolve(small, np.ones(_WIDE), mode="same") > 0)


def _passed() -> float:
    """Share of white noise's power that the low-pass of ``thin`` lets through."""
    from scipy.signal import butter, sosfreqz

    sos = butter(4, 40.0, fs=1000.0, output="sos")
    return float(np.mean(np.abs(sosfreqz(sos, 2048)[1]) ** 4))


def _has_rack(one: Prepared, model: Model) -> bool:
    """Angle and rack position, measured apart."""
    if "motor_angle_rad" not in one.raw or "rack_position_m" not in one.raw:
        return False
    apart = one.raw["motor_angle_rad"] - (
        model.rack_to_rotor_ratio_rad_per_m * one.raw["rack_position_m"]
    )
    return float(np.std(np.diff(apart))) > _ONE_SOURCE


def _transmitted(one: Prepared, model: Model) -> Floats:
    """Torque from rotor to rack (Nm at the rotor), 1 kHz; the rack side's inertia included."""
    motion = one.motion(model)
    load = motion.rack_force_n / model.rack_to_rotor_ratio_rad_per_m
    hand = model.sensor_to_rotor * motion.torque_sensor_nm
    share = _INERTIA_SHARE * model.inertia_kg_m2
    return np.asarray(load - hand + share * low_pass(motion.acceleration_rad_s2, _TWIST_HZ))


_ALWAYS = ("ratio", "delay")
_GROUPS = {
    "belt_compliance": ("compliance", "inertia"),
    "backlash": ("half_gap",),
    "rack_ratio": ("ratio_slope", "ratio_bend"),
    "clock_drift": ("drift",),
}


def _design(rows: Sequence[_Rows], names: Sequence[str]) -> tuple[Floats, Floats]:
    """(columns, residual), both in noise deviations; one constant a recording."""
    parts = []
    for k, one in enumerate(rows):
        constants = np.zeros((len(one.e), len(rows)))
        constants[:, k] = 1.0
        columns = np.column_stack([one.columns[name] for name in names])
        parts.append(np.column_stack([constants, columns]) / one.sigma)
    return np.concatenate(parts), np.concatenate([one.e / one.sigma for one in rows])


def _fit(rows: Sequence[_Rows], names: Sequence[str]) -> tuple[dict[str, float], Floats]:
    """(coefficients by name, their residual in noise deviations)."""
    a, b = _design(rows, names)
    size = np.sqrt(np.sum(a**2, axis=0)) + 1e-300
    solved = np.linalg.lstsq(a / size, b, rcond=1e-9)[0] / size
    values = (float(value) for value in solved[len(rows) :])
    return dict(zip(names, values, strict=True)), b - a @ solved


def _cost(residual: Floats) -> float:
    """Sum of squares with far ones cut, as an angle that slips a turn would be."""
    at = max(5.0, 3.0 * 1.4826 * float(np.median(np.abs(residual))))
    return float(np.sum(np.clip(residual, -at, at) ** 2))


def _held_out_gain(rows: Sequence[_Rows], names: Sequence[str], group: Sequence[str]) -> float:
    """What ``group`` gains beside ``names`` on blocks that were not fitted."""
    a, b = _design(rows, [*names, *group])
    block = np.concatenate([one.block + 1000 * k for k, one in enumerate(rows)])
    size = np.sqrt(np.sum(a**2, axis=0)) + 1e-300
    gain = 0.0
    for part in (0, 1):
        fitted, judged = block % 2 == part, block % 2 != part
        costs = []
        for columns in (a[:, : len(rows) + len(names)], a):
            scale = size[: columns.shape[1]]
            solved = np.linalg.lstsq(columns[fitted] / scale, b[fitted], rcond=1e-9)[0] / scale
            costs.append(_cost(b[judged] - columns[judged] @ solved))
        gain += costs[0] - costs[1]
    return gain


def _rotor_against_rack(
    rows: Sequence[_Rows], kept: Sequence[_Rows]
) -> tuple[list[Seen], dict[str, Any]]:
    names = list(_ALWAYS)
    accepted: list[str] = []
    base = _fit(rows, names)[1]
    while True:
        excess = _cost(_fit(rows, names)[1]) - len(base)
        gains = {
            effect: _held_out_gain(rows, names, group)
            for effect, group in _GROUPS.items()
            if effect not in accepted
        }
        if not gains:
            break
        best = max(gains, key=lambda effect: gains[effect])
        if gains[best] < max(LEAST_GAIN, LEAST_SHARE * excess):
            break
        accepted.append(best)
        names += _GROUPS[best]
    values, left = _fit(rows, names)
    found = []
    for effect in accepted:
        one = _judged(rows, kept, names, values, effect)
        if one is not None:
            found.append(one)
    if abs(values["ratio"]) > LEAST_RATIO:
        one = _judged(rows, kept, names, values, "rack_ratio", constant=True)
        if one is not None and all(s.entry["effect"] != "rack_ratio" for s in found):
            found.append(one)
    content = {
        "residual": "motor angle less rack_to_rotor_ratio times rack position, rad",
        "rms_rad": float(np.sqrt(np.mean(base**2))) * rows[0].sigma,
        "rms_left_rad": float(np.sqrt(np.mean(left**2))) * rows[0].sigma,
        "noise_rad": rows[0].sigma,
        "ratio_error": values["ratio"],
        "angle_delay_beyond_model_s": values["delay"],
    }
    return found, content


def _judged(
    rows: Sequence[_Rows],
    kept: Sequence[_Rows],
    names: Sequence[str],
    values: Mapping[str, float],
    effect: str,
    *,
    constant: bool = False,
) -> Seen | None:
    """The finding, if its numbers make sense, are large enough, and help on the hold-outs."""
    group = ("ratio",) if constant else _GROUPS[effect]
    entry = _entry(effect, values, constant=constant)
    if effect == "clock_drift" and not drift_matters(values["drift"], [one.one for one in rows]):
        return None
    if entry is None or (kept and not _helps(kept, names, values, group)):
        return None
    others = [name for name in names if name not in group]
    with_it, without = _fit(rows, names)[1], _fit(rows, others)[1]
    sigma = _deviations(rows, names, with_it)
    gain = _cost(without) - _cost(with_it)
    total = max(_cost(without) - len(without), 1.0)
    force = np.concatenate([one.force for one in rows])
    low, high = (float(v) for v in np.percentile(force, [2, 98]))
    position = np.concatenate([one.x for one in rows])
    near, far = (float(v) for v in np.percentile(position, [2, 98]))
    place = (
        ("rack_position_m", near, far, 1.0)
        if effect == "rack_ratio"
        else ("rack_force_n", low, high, 1.0)
    )
    return Seen(entry, _own(effect, values, sigma), gain, min(1.0, gain / total), (place,))


def _entry(effect: str, values: Mapping[str, float], *, constant: bool) -> dict[str, Any] | None:
    if effect == "rack_ratio":
        return {"effect": effect, "scale": values["ratio"]} if constant else {
            "effect": effect, "scale": values["ratio"],
            "slope_per_m": values["ratio_slope"], "bend_per_m2": values["ratio_bend"],
        }  # fmt: skip
    if effect == "clock_drift":
        return {"effect": effect, "ppm": values["drift"]}
    if effect == "backlash":
        gap = 2.0 * values["half_gap"]
        return {"effect": effect, "gap_rad": gap} if gap > LEAST_GAP_RAD else None
    compliance = values["compliance"]
    if compliance < LEAST_COMPLIANCE:
        return None
    return {"effect": effect, "stiffness_nm_per_rad": 1.0 / compliance}


def _own(effect: str, values: Mapping[str, float], sigma: Mapping[str, float]) -> dict[str, float]:
    """Deviations of the effect's own parameters."""
    if effect == "rack_ratio":
        return {
            "scale": sigma["ratio"],
            "slope_per_m": sigma.get("ratio_slope", 0.0),
            "bend_per_m2": sigma.get("ratio_bend", 0.0),
        }
    if effect == "clock_drift":
        return {"ppm": sigma["drift"]}
    if effect == "backlash":
        return {"gap_rad": 2.0 * sigma["half_gap"]}
    return {"stiffness_nm_per_rad": sigma["compliance"] / values["compliance"] ** 2}


def _helps(
    kept: Sequence[_Rows], names: Sequence[str], values: Mapping[str, float], group: Sequence[str]
) -> bool:
    """Whether the fitted numbers of ``group`` lower the hold-outs' residual."""
    cost = {True: 0.0, False: 0.0}
    for one in kept:
        for with_group in (True, False):
            used = [name for name in names if with_group or name not in group]
            left = one.e - sum(values[name] * one.columns[name] for name in used)
            cost[with_group] += _cost((left - np.mean(left)) / one.sigma)
    return cost[True] < cost[False]


def _deviations(rows: Sequence[_Rows], names: Sequence[str], residual: Floats) -> dict[str, float]:
    """Sandwich deviations over blocks."""
    a, _ = _design(rows, names)
    block = np.concatenate([one.block + 1000 * k for k, one in enumerate(rows)])
    inverse = np.linalg.pinv(a.T @ a)
    middle = np.zeros_like(inverse)
    for number in np.unique(block):
        inside = block == number
        score = a[inside].T @ residual[inside]
        middle += np.outer(score, score)
    spread = np.sqrt(np.maximum(np.diag(inverse @ middle @ inverse), 0.0))
    return dict(zip(names, (float(s) for s in spread[len(rows) :]), strict=True))


def _has_twist(one: Prepared) -> bool:
    needed = ("steering_wheel_angle_rad", "rack_position_m", "torque_sensor_nm")
    return all(name in one.raw for name in needed)


def _twist(one: Prepared, model: Model) -> Floats:
    return np.asarray(
        one.raw["steering_wheel_angle_rad"]
        - model.pinion_ratio_rad_per_m * one.raw["rack_position_m"]
    )


def _twist_noise(one: Prepared, model: Model) -> float:
    return float(
        np.hypot(
            one.noise["steering_wheel_angle_rad"],
            model.pinion_ratio_rad_per_m * one.noise["rack_position_m"],
        )
    )


class _Twisted:
    """Twist, its rate and the reported torque of one recording; 1 kHz, low-passed."""

    def __init__(self, one: Prepared, model: Model) -> None:
        late = model.delays_s.of("torque_sensor_nm")
        self.twist = low_pass(_twist(one, model), _PLAY_HZ)
        self.rate = np.gradient(self.twist, 1e-3)
        reported = low_pass(one.raw["torque_sensor_nm"], _PLAY_HZ)
        self.torque = np.interp(one.time_s + late, one.time_s, reported)
        self.sigma = max(one.noise["torque_sensor_nm"], 1e-4)
        self.noise = _twist_noise(one, model)

    def left(self, gain: float, damping: float, offset: float, play: float) -> Floats:
        """Reported torque less what a sensor with this play would report; thinned."""
        true = gain * self.twist + damping * self.rate + offset
        seen = with_play(true, play) if play > 0 else true
        edge = 250
        return np.asarray((self.torque - seen)[edge:-edge:8])


def _sensor_play(
    fitted: Sequence[Prepared], judged: Sequence[Prepared], model: Model
) -> tuple[Seen, tuple[float, float, float]] | None:
    from scipy.optimize import least_squares

    rows = [_Twisted(one, model) for one in fitted if _has_twist(one)]
    kept = [_Twisted(one, model) for one in judged if _has_twist(one)]
    if not rows:
        return None
    twist = np.concatenate([one.twist for one in rows])
    torque = np.concatenate([one.torque for one in rows])
    if np.std(twist) < 1e-9 or np.std(torque) < 1e-9:
        return None
    if abs(float(np.corrcoef(twist, torque)[0, 1])) < _LEAST_TWIST:
        return None
    slope = float(np.std(torque) / np.std(twist))
    passed = np.sqrt(2e-3 * _PLAY_HZ)
    sigma = float(passed * np.hypot(rows[0].sigma, slope * rows[0].noise))

    def residual(p: Floats) -> Floats:
        return np.concatenate([one.left(slope * p[0], slope * p[1], p[2], p[3]) for one in rows])

    def cost(p: Floats, records: Sequence[_Twisted]) -> float:
        return sum(
            _cost(one.left(slope * p[0], slope * p[1], p[2], p[3]) / sigma) for one in records
        )

    plain = least_squares(lambda p: residual(np.append(p, 0.0)), [1.0, 0.0, 0.0])
    start = np.append(plain.x, 0.0)
    best = min((np.append(plain.x, w) for w in _PLAYS_NM), key=lambda p: cost(p, rows))
    done = least_squares(
        residual, best, loss="soft_l1", f_scale=3 * sigma, x_scale=[0.1, 0.01, 0.1, 0.1],
        bounds=([0.2, -1.0, -5.0, 0.0], [5.0, 1.0, 5.0, 2.0]), diff_step=1e-3,
    )  # fmt: skip
    found = np.asarray(done.x)
    gain = cost(start, rows) - cost(found, rows)
    excess = cost(start, rows) - len(residual(start))
    play = float(found[3])
    if play < max(LEAST_PLAY_NM, _CLEAR * sigma) or gain < max(
        LEAST_GAIN, 3 * LEAST_SHARE * excess
    ):
        return None
    if kept and cost(found, kept) >= cost(start, kept):
        return None
    spread = np.linalg.pinv(done.jac.T @ done.jac)[3, 3] * sigma**2 * 12.0
    low, high = (float(v) for v in np.percentile(torque, [2, 98]))
    seen = Seen(
        {"effect": "torque_sensor_hysteresis", "play_nm": play},
        {"play_nm": float(np.sqrt(max(spread, 0.0)))},
        gain,
        min(1.0, gain / max(excess, 1.0)),
        (("torque_sensor_nm", low, high, 1.0),),
    )
    return seen, (slope * float(found[0]), slope * float(found[1]), float(found[2]))


def finding(seen: Seen) -> dict[str, Any]:
    """The JSON entry (CONTRACT 7) of an effect seen in the kinematics."""
    effect = catalogue()[seen.entry["effect"]]
    sentence, values = effect.wording({**_defaults(effect), **seen.entry})
    parameters = {}
    for one in effect.parameters:
        if one.name in seen.entry:
            value, sigma = seen.entry[one.name], seen.sigma.get(one.name, 0.0)
            parameters[one.name] = {
                "value": value,
                "unit": one.unit,
                "ci95": [value - 1.96 * sigma, value + 1.96 * sigma],
            }
    return {
        "effect": effect.id,
        "kind": str(effect.kind),
        "confidence": round(min(0.99, 1.0 - 0.4 * float(np.exp(1.0 - seen.gain / LEAST_GAIN))), 3),
        "equation": effect.equation,
        "summary": sentence.format(**values),
        "parameters": parameters,
        "where": [
            {"signal": s, "from": low, "to": high, "share_of_excess": seen.share}
            for s, low, high, _ in seen.where
        ],
        "confusable_with": [],
        "next_experiment": "",
        "seen_in": "kinematics",
    }


def _defaults(effect: Any) -> dict[str, Any]:
    return {p.name: p.default for p in effect.parameters if p.default is not None}
