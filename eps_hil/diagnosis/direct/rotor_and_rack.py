"""Rotor against rack, e = φ − i_APA · x: play, a belt that gives, a wrong ratio, a clock's drift.

The ratio is the model's, its effects included. With the transmitted torque
τ = F/i_APA − (i_pi/i_APA)·T_sen + J₂ω̇ an elastic belt makes e = τ/c, play makes e jump by the gap
where τ changes its sign, a wrong ratio makes it grow with x, a late angle with the speed. All are
columns of one least-squares fit.
"""

from collections.abc import Collection, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.balance.spread import half_widths, partitions
from eps_hil.diagnosis.data.drift import drift_matters
from eps_hil.diagnosis.data.prepare import CUTOFF_HZ, Prepared
from eps_hil.diagnosis.data.side_by_side import each
from eps_hil.diagnosis.direct.seen import LEAST_GAIN, LEAST_SHARE, Seen, robust_cost
from eps_hil.identification.butterworth import low_pass, passed
from eps_hil.physics.effects.catalogue import can_be, with_model_effects
from eps_hil.physics.model import Model
from eps_hil.physics.simulate import rotor_angle_rad

Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

BLOCK_S = 2.0
STIFF_HZ = 152.0
"""A drive whose belt resonates above this is stiff: no torque balance sees it."""
LEAST_GAP_RAD = 0.005
"""Beside a belt that is free to give, noise alone shows gaps of less than a tenth of this."""
LEAST_RATIO = 0.004
LEAST_BEND = 1e-3
"""Of the ratio, between the places that were visited: many minutes show much less, and it is how
stiff joints are."""
_OPEN_NM, _WIDE = 0.03, 9
"""Within so many thinned samples of a smaller transmitted torque a gap may be open."""
_CLEAR = 2.0
"""Half widths of its interval that a gap is away from none."""
_CONTACT_NM = 0.01
"""Transmitted torque at which a gap counts as closed."""
_TURNS_RAD_S = 1.0
"""Speed within which friction turns over."""
_ONE_SOURCE = 1e-3
"""A rack position this near (rad at the rotor) to the angle was made from it."""
_INERTIA_SHARE = 0.33
_SMOOTH_HZ = 40.0
_ALWAYS = ("ratio", "delay")
"""Columns of every fit…"""
USUAL = (*_ALWAYS, "compliance", "inertia")
"""…and what every drive has a little of."""
_GROUPS = {
    "belt_compliance": ("compliance", "inertia"),
    "backlash": ("half_gap",),
    "rack_ratio": ("ratio_slope", "ratio_bend"),
    "clock_drift": ("drift",),
}
"""Columns that an effect adds."""
JOINTS = ("belt_compliance", "backlash")
"""What rotor and rack come apart by."""
_JOINT = (*USUAL, "half_gap")
SEPARATE = tuple(_GROUPS)
"""Effects (ids) that rotor against rack shows."""


class Rows:
    """Thinned residual and regressors of one recording, where no gap is open and data are good."""

    def __init__(self, one: Prepared, model: Model, *, behind: bool = False) -> None:
        motion = one.motion(model)
        ratio = with_model_effects(model).rack_to_rotor_ratio_rad_per_m
        self.one, self.model = one, model
        torque = transmitted(one, model, behind=behind)
        usable = ~may_be_open(one.thin(torque), one)
        if one.barred is not None:
            usable &= ~one.barred

        def thin(values: Floats) -> Floats:
            return one.thin(values)[usable]

        self.e = thin(motion.angle_rad - rotor_angle_rad(model, motion.position_m))
        self.x = thin(motion.position_m)
        self.torque, self.force = thin(torque), thin(motion.rack_force_n)
        self.at = {
            "rack_force_n": ratio * self.torque,  # as far as the rotor carries it
            "rack_position_m": self.x,
            "motor_speed_rad_s": thin(motion.speed_rad_s),
        }
        self.columns = {
            "ratio": ratio * self.x,
            "delay": -thin(motion.speed_rad_s),
            "drift": -thin(motion.speed_rad_s * one.since_start_s) * 1e-6,
            "compliance": self.torque,
            "inertia": thin(model.inertia_kg_m2 * motion.acceleration_rad_s2),
            "friction": thin(np.tanh(motion.speed_rad_s / (_TURNS_RAD_S * one.size.angle))),
            "half_gap": np.tanh(self.torque / (_CONTACT_NM * one.size.torque)),
            "ratio_slope": ratio * self.x * self.x,
            "ratio_bend": ratio * self.x**3,
        }
        sigma = np.hypot(
            one.noise.get("motor_angle_rad", 0.0), ratio * one.noise["rack_position_m"]
        )
        self.sigma = max(float(sigma) * np.sqrt(passed(CUTOFF_HZ, 0)), 1e-6 * one.size.angle)
        block = (one.thin_time_s - one.thin_time_s[0]) // BLOCK_S
        self.block = block[usable].astype(np.int64)


def least_compliance(model: Model) -> float:
    """Compliance (rad/Nm at the rotor) of a belt that is just as stiff as shows no more."""
    behind = _INERTIA_SHARE * model.inertia_kg_m2
    return 1.0 / (behind * (2.0 * np.pi * STIFF_HZ) ** 2)


def may_be_open(torque: Floats, one: Prepared) -> Flags:
    """Where the transmitted torque is about to change its sign: a gap may be open there."""
    small = np.abs(torque) < _OPEN_NM * one.size.torque
    small |= np.append(np.diff(np.sign(torque)) != 0, False)
    return np.asarray(np.convolve(small, np.ones(_WIDE), mode="same") > 0)


def has_rack(one: Prepared, model: Model) -> bool:
    """Angle and rack position, measured apart."""
    if "motor_angle_rad" not in one.raw or "rack_position_m" not in one.raw:
        return False
    apart = one.raw["motor_angle_rad"] - (
        model.rack_to_rotor_ratio_rad_per_m * one.raw["rack_position_m"]
    )
    return float(np.std(np.diff(apart))) > _ONE_SOURCE * one.size.angle


def transmitted(one: Prepared, model: Model, *, behind: bool = False) -> Floats:
    """Torque from rotor to rack (Nm at the rotor), 1 kHz; the rack side's inertia included.

    Where friction acts ``behind``, on the rack, it is part of it: it is what the motor gives beyond
    the rotor's inertia then, whatever the friction is.
    """
    motion, model = one.motion(model), with_model_effects(model)
    inertia = model.inertia_kg_m2 * low_pass(motion.acceleration_rad_s2, _SMOOTH_HZ)
    if behind:
        given = low_pass(motion.motor_torque_nm, _SMOOTH_HZ)
        return np.asarray(given - (1.0 - _INERTIA_SHARE) * inertia)
    load = motion.rack_force_n / model.rack_to_rotor_ratio_rad_per_m
    hand = model.sensor_to_rotor * motion.torque_sensor_nm
    return np.asarray(load - hand + _INERTIA_SHARE * inertia)


def rubs_behind(recordings: Sequence[Prepared], model: Model) -> bool:
    """Whether friction acts on the rack, behind what gives or is loose: by what leaves less.

    Each with all that a joint may have, on the samples at which it is shut: where friction acts
    says when that is, so that samples on which both agree tell nothing.
    """
    if not recordings or not all("motor_torque_nm" in one.raw for one in recordings):
        return False
    left, samples = [], []
    for behind in (False, True):
        rows = each(partial(Rows, model=model, behind=behind), recordings)
        residual = solved(rows, _JOINT)[1]
        left.append(robust_cost(residual) / max(len(residual), 1))
        samples.append(len(residual))
    return (left[0] - left[1]) * min(samples) > LEAST_GAIN


def _level(values: Floats, chosen: Flags | slice = slice(None)) -> Floats:
    """Without the mean of the ``chosen`` samples, which is 0 where there are none."""
    some = values[chosen]
    return values - np.mean(some, axis=0) if len(some) else values


def _design(
    rows: Sequence[Rows], names: Sequence[str], part: int | None = None
) -> tuple[Floats, Floats]:
    """(columns, residual), both in noise deviations, without each recording's own constant.

    That is fitted to the blocks of one ``part`` (0 or 1), or to all; least squares with a constant
    for each recording gives the same numbers (Frisch and Waugh's theorem).
    """
    columns, residuals = [], []
    for one in rows:
        chosen = slice(None) if part is None else one.block % 2 == part
        columns.append(_level(np.column_stack([one.columns[n] for n in names]), chosen) / one.sigma)
        residuals.append(_level(one.e, chosen) / one.sigma)
    return np.concatenate(columns), np.concatenate(residuals)


def least_squares(a: Floats, b: Floats) -> Floats:
    """What of the columns ``a`` (n, p) comes nearest to ``b`` (n,), whatever their units; (p,)."""
    size = np.sqrt(np.sum(a**2, axis=0)) + 1e-300
    return np.asarray(np.linalg.lstsq(a / size, b, rcond=1e-9)[0] / size)


def solved(rows: Sequence[Rows], names: Sequence[str]) -> tuple[dict[str, float], Floats]:
    """(coefficients by name, their residual in noise deviations)."""
    a, b = _design(rows, names)
    best = least_squares(a, b)
    return dict(zip(names, best.tolist(), strict=True)), b - a @ best


def columns_of(effects: Sequence[str]) -> list[str]:
    """The columns of a fit with these effects: beside a gap, the belt may always give a little."""
    names = [*_ALWAYS, *(column for effect in effects for column in _GROUPS[effect])]
    return list(dict.fromkeys([*names, *USUAL])) if "backlash" in effects else names


def _held_out_gain(rows: Sequence[Rows], names: Sequence[str], group: Sequence[str]) -> float:
    """What ``group`` gains beside ``names`` on blocks that were not fitted."""
    even = np.concatenate([one.block % 2 == 0 for one in rows])
    gain = 0.0
    for part, fitted in enumerate((even, ~even)):
        a, b = _design(rows, [*names, *group], part)
        costs = []
        for columns in (a[:, : len(names)], a):
            best = least_squares(columns[fitted], b[fitted])
            costs.append(robust_cost(b[~fitted] - columns[~fitted] @ best))
        gain += costs[0] - costs[1]
    return gain


def _accepted(rows: Sequence[Rows], without: Collection[str]) -> list[str]:
    """Effects in the order of their gain on blocks that were not fitted, while it is enough."""
    names = list(_ALWAYS)
    accepted: list[str] = []

    def gained(effects: Sequence[str]) -> dict[str, float]:
        found = each(lambda effect: _held_out_gain(rows, names, _GROUPS[effect]), effects)
        return dict(zip(effects, found, strict=True))

    while True:
        left = solved(rows, names)[1]
        excess = robust_cost(left) - len(left)
        gains = gained([name for name in _GROUPS if name not in accepted and name not in without])
        best = max(gains, key=lambda effect: gains[effect], default=None)
        if best is None or gains[best] < max(LEAST_GAIN, LEAST_SHARE * excess):
            return accepted
        accepted.append(best)
        names += _GROUPS[best]


def rotor_against_rack(
    rows: Sequence[Rows], kept: Sequence[Rows], without: Collection[str] = ()
) -> tuple[list[Seen], dict[str, Any], list[str]]:
    """Effects seen, what the JSON says of the residual, and the effects that the fit has taken in.

    ``kept``: hold-outs, on which an effect must help too. Ids in ``without`` are not considered.
    """
    accepted = _accepted(rows, without)
    names = columns_of(accepted)
    start, base = solved(rows, _ALWAYS)
    values, left = solved(rows, names)
    found = []
    for effect in accepted:
        one = _judged(rows, kept, names, values, effect)
        if one is not None:
            found.append(one)
    if abs(values["ratio"]) > LEAST_RATIO and "rack_ratio" not in without:
        one = _judged(rows, kept, names, values, "rack_ratio", constant=True)
        if one is not None and all(s.entry["effect"] != "rack_ratio" for s in found):
            found.append(one)
    if accepted and kept and _cost(kept, values) >= _cost(kept, start):
        # two that cancel each other here help each beside the other, and together do not
        found, accepted, values, left = [], [], start, base
    content = {
        "residual": "motor angle less rack_to_rotor_ratio times rack position, rad",
        "rms_rad": float(np.sqrt(np.mean(base**2))) * rows[0].sigma,
        "rms_left_rad": float(np.sqrt(np.mean(left**2))) * rows[0].sigma,
        "noise_rad": rows[0].sigma,
        "ratio_error": values["ratio"],
        "angle_delay_beyond_model_s": values["delay"],
    }
    if kept:
        content["holdout_rms_rad"] = _rms_rad(kept, start)
        content["holdout_left_rad"] = _rms_rad(kept, values)
    return found, content, accepted


def _judged(
    rows: Sequence[Rows],
    kept: Sequence[Rows],
    names: Sequence[str],
    values: Mapping[str, float],
    effect: str,
    *,
    constant: bool = False,
) -> Seen | None:
    """The finding, if its numbers make sense, are large enough, and help on the hold-outs."""
    group = ("ratio",) if constant else _GROUPS[effect]
    entry = _entry(rows, effect, values, constant=constant)
    if entry is None or not can_be(entry, rows[0].model):
        return None
    if not constant and not _matters(effect, rows, values):
        return None
    if kept and not _helps(kept, names, values, group):
        return None
    others = [name for name in names if name not in group]
    with_it, without = solved(rows, names)[1], solved(rows, others)[1]
    half = _half_widths(rows, names, with_it)
    if effect == "backlash" and entry["gap_rad"] < _CLEAR * 2.0 * half["half_gap"]:
        return None
    gain = robust_cost(without) - robust_cost(with_it)
    if gain < LEAST_GAIN:
        return None
    total = max(robust_cost(without) - len(without), 1.0)
    force = np.concatenate([one.force for one in rows])
    low, high = (float(v) for v in np.percentile(force, [2, 98]))
    position = np.concatenate([one.x for one in rows])
    near, far = (float(v) for v in np.percentile(position, [2, 98]))
    place = (
        ("rack_position_m", near, far, 1.0)
        if effect == "rack_ratio"
        else ("rack_force_n", low, high, 1.0)
    )
    return Seen(entry, _own(effect, values, half), gain, min(1.0, gain / total), (place,))


def _entry(
    rows: Sequence[Rows], effect: str, values: Mapping[str, float], *, constant: bool
) -> dict[str, Any] | None:
    if effect == "rack_ratio":
        return {"effect": effect, "scale": values["ratio"]} if constant else {
            "effect": effect, "scale": values["ratio"],
            "slope_per_m": values["ratio_slope"], "bend_per_m2": values["ratio_bend"],
        }  # fmt: skip
    if effect == "clock_drift":
        return {"effect": effect, "ppm": values["drift"]}
    if effect == "backlash":
        gap = 2.0 * values["half_gap"]
        return (
            {"effect": effect, "gap_rad": gap}
            if gap > LEAST_GAP_RAD * rows[0].one.size.angle
            else None
        )
    compliance = values["compliance"]
    if compliance < least_compliance(rows[0].model):
        return None
    return {"effect": effect, "stiffness_nm_per_rad": 1.0 / compliance}


def _matters(effect: str, rows: Sequence[Rows], values: Mapping[str, float]) -> bool:
    """Whether a clock drifts, or a ratio changes over the places that were visited, by enough."""
    if effect == "clock_drift":
        return drift_matters(values["drift"], [one.one for one in rows])
    if effect != "rack_ratio":
        return True
    x = np.linspace(*np.percentile(np.concatenate([one.x for one in rows]), [2, 98]))
    return float(np.ptp(values["ratio_slope"] * x + values["ratio_bend"] * x**2)) > LEAST_BEND


def _own(effect: str, values: Mapping[str, float], half: Mapping[str, float]) -> dict[str, float]:
    """Half widths of the effect's own parameters."""
    if effect == "rack_ratio":
        return {
            "scale": half["ratio"],
            "slope_per_m": half.get("ratio_slope", 0.0),
            "bend_per_m2": half.get("ratio_bend", 0.0),
        }
    if effect == "clock_drift":
        return {"ppm": half["drift"]}
    if effect == "backlash":
        return {"gap_rad": 2.0 * half["half_gap"]}
    return {"stiffness_nm_per_rad": half["compliance"] / values["compliance"] ** 2}


def _left(one: Rows, values: Mapping[str, float]) -> Floats:
    """What fitted numbers leave of the residual, rad; its constant is the recording's own."""
    left = one.e - sum(value * one.columns[name] for name, value in values.items())
    return np.asarray(left - np.mean(left))


def _rms_rad(rows: Sequence[Rows], values: Mapping[str, float]) -> float:
    left = np.concatenate([_left(one, values) for one in rows])
    return float(np.sqrt(np.mean(left**2)))


def _helps(
    kept: Sequence[Rows], names: Sequence[str], values: Mapping[str, float], group: Sequence[str]
) -> bool:
    """Whether the fitted numbers of ``group`` lower the hold-outs' residual."""
    others = {name: values[name] for name in names if name not in group}
    return _cost(kept, values) < _cost(kept, others)


def _cost(rows: Sequence[Rows], values: Mapping[str, float]) -> float:
    return sum(robust_cost(_left(one, values) / one.sigma) for one in rows)


def _half_widths(rows: Sequence[Rows], names: Sequence[str], residual: Floats) -> dict[str, float]:
    """Half widths of 95 % intervals, over blocks and stretches."""
    a, _ = _design(rows, names)
    wide = half_widths(a, residual, partitions([one.block for one in rows]))
    return dict(zip(names, wide.tolist(), strict=True))
