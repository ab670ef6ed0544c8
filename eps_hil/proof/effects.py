"""What can be hidden: each effect of CONTRACT 8 as a strength and a shape on the true rig.

Written from the contract's equations, not from anybody's catalogue. ``alien`` effects are real
physics that no entry of the contract describes: a diagnosis is right to call them unknown.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from eps_hil.proof.hidden_effect import Draw, HiddenEffect, Shape
from eps_hil.proof.truth import NUT_NM_PER_RAD
from eps_hil.proof.world import World

_KNOTS = np.linspace(-3.0, 3.0, 31)


def _no_shape(_rng: np.random.Generator) -> dict[str, float]:
    return {}


def _phase(rng: np.random.Generator) -> dict[str, float]:
    return {"phase_rad": float(rng.uniform(-math.pi, math.pi))}


def _hide(world: World, **values: float) -> World:
    return replace(world, hidden=world.hidden._replace(**values))


def _instrument(world: World, **values: Any) -> World:
    return replace(world, instruments=replace(world.instruments, **values))


def _drive(world: World, **values: float) -> World:
    return replace(world, drive=world.drive._replace(**values))


def _plain(
    id: str,
    field: str,
    parameter: str,
    start: float,
    limit: float,
    *,
    kind: str = "structure",
    draw: Draw = _no_shape,
    shape_fields: Mapping[str, str] | None = None,
    **more: Any,
) -> HiddenEffect:
    """An effect whose strength is one field of ``Hidden``; shapes go to fields of their own.

    ``shape_fields``: parameter name of CONTRACT 8 -> field of ``Hidden``.
    """
    fields = shape_fields or {}

    def apply(world: World, strength: float, shape: Shape) -> World:
        shaped = {fields[name]: value for name, value in shape.items() if name in fields}
        return _hide(world, **{field: strength}, **shaped)

    def tell(strength: float, shape: Shape, _world: World) -> dict[str, float]:
        return {parameter: strength, **shape}

    return HiddenEffect(id, kind, start, limit, apply, tell, draw, **more)


def _scale(strength: float, _shape: Shape, _world: World) -> dict[str, float]:
    return {"scale": 1.0 + strength}


def _sign(rng: np.random.Generator) -> float:
    return 1.0 if rng.uniform() < 0.5 else -1.0


_FRICTION = (
    _plain(
        "stribeck", "stribeck_nm", "level_nm", 0.02, 0.3,
        draw=lambda r: {"speed_rad_s": float(r.uniform(4, 20))},
        shape_fields={"speed_rad_s": "stribeck_speed"}, twins=("breakaway_dwell",),
    ),
    _plain(
        "viscous_friction", "viscous", "coefficient_nm_s_per_rad", 2e-4, 5e-3, free=True,
        twins=("quadratic_drag",),
    ),
    _plain(
        "quadratic_drag", "quadratic", "coefficient_nm_s2_per_rad2", 2e-6, 1e-4,
        twins=("viscous_friction",),
    ),
    _plain(
        "load_dependent_friction", "load_gain", "gain_nm_per_n", 1e-5, 2e-4, free=True,
        twins=("coulomb_level", "rack_ratio"),
    ),
    _plain(
        "friction_asymmetry", "half_difference_nm", "half_difference_nm", 0.01, 0.05, free=True,
        signed=True, twins=("motor_torque_offset", "torque_sensor_offset", "coulomb_level"),
    ),
    _plain(
        "position_dependent_friction", "place_nm", "level_nm", 0.03, 0.4,
        draw=lambda r: {
            "centre_m": float(r.uniform(-0.005, 0.005)), "width_m": float(r.uniform(1.5e-3, 5e-3))
        },
        shape_fields={"centre_m": "place_centre_m", "width_m": "place_width_m"},
    ),
    _plain(
        "breakaway_dwell", "dwell_nm", "level_nm", 0.05, 0.5,
        draw=lambda r: {
            "time_s": float(r.uniform(0.2, 1.0)), "release_rad": float(r.uniform(0.5, 3.0))
        },
        shape_fields={"time_s": "dwell_time_s", "release_rad": "dwell_release_rad"},
        twins=("stribeck",),
    ),
    _plain(
        "friction_warmup", "warmup", "amplitude", 0.1, 2.0,
        draw=lambda r: {"time_s": float(r.uniform(5, 20))},
        shape_fields={"time_s": "warmup_time_s"},
        twins=("coulomb_level",),
    ),
)  # fmt: skip

_RIPPLES = (
    _plain(
        "screw_ripple", "screw_nm", "amplitude_nm", 0.005, 0.1, draw=_phase,
        shape_fields={"phase_rad": "screw_phase"}, twins=("cogging_torque",),
    ),
    _plain(
        "cogging_torque", "cogging_nm", "amplitude_nm", 0.005, 0.1,
        draw=lambda r: {"order": float(r.choice([4, 6, 8, 12])), **_phase(r)},
        shape_fields={"order": "cogging_order", "phase_rad": "cogging_phase"},
    ),
    _plain(
        "torque_ripple", "ripple", "fraction", 0.05, 0.5, draw=_phase,
        shape_fields={"phase_rad": "ripple_phase"}, twins=("cogging_torque",),
    ),
    _plain(
        "cardan_joint", "cardan", "fraction", 0.1, 0.45, draw=_phase,
        shape_fields={"phase_rad": "cardan_phase"}, twins=("torque_sensor_gain",),
    ),
    _plain("motor_torque_saturation", "saturation", "curvature_per_nm2", 0.05, 0.8,
           twins=("motor_torque_gain",)),
    _plain("unmodelled_spring", "spring", "stiffness_nm_per_rad", 5e-4, 2e-2,
           twins=("position_torque",)),
)  # fmt: skip


def _stop_at(strength: float) -> float:
    """The stronger, the further inside the travel the stop begins."""
    return 0.025 / (1.0 + strength)


def _stop(world: World, strength: float, shape: Shape) -> World:
    return _hide(world, stop_n_per_m=shape["stiffness_n_per_m"], stop_at_m=_stop_at(strength))


def _static(world: World, strength: float, shape: Shape) -> World:
    return _hide(
        world,
        static_nm=strength,
        static_centre_m=shape["centre_m"],
        static_width_m=shape["width_m"],
    )


def _bump(strength: float, shape: Shape) -> list[list[float]]:
    return [
        [shape["centre_m"] + k * shape["width_m"], strength * math.exp(-(k**2))]
        for k in _KNOTS.tolist()
    ]


_PLACES = (
    HiddenEffect(
        "end_stop", "structure", 0.6, 3.0, _stop,
        lambda s, shape, _w: {"position_m": _stop_at(s), **shape},
        lambda r: {"stiffness_n_per_m": float(r.uniform(1e5, 4e5))},
        twins=("position_torque", "unmodelled_spring"), placed=True,
    ),
    HiddenEffect(
        "position_torque", "structure", 0.02, 0.3, _static,
        lambda s, shape, _w: {"peak_nm": s, **shape},
        lambda r: {
            "centre_m": float(r.uniform(-0.004, 0.004)), "width_m": float(r.uniform(1.5e-3, 4e-3))
        },
        signed=True, twins=("unmodelled_spring",), knots=_bump,
    ),
)  # fmt: skip

_INSTRUMENTS = (
    _plain("motor_torque_offset", "motor_offset_nm", "offset_nm", 0.01, 0.2, kind="instrument",
           free=True, signed=True, twins=("torque_sensor_offset", "friction_asymmetry")),
    _plain("motor_torque_delay", "motor_late_s", "delay_s", 5e-4, 0.02, kind="instrument",
           twins=("speed_sensor_delay",)),
    HiddenEffect(
        "speed_sensor_delay", "instrument", 5e-4, 0.02,
        lambda w, s, _: _instrument(w, speed_late_s=s), lambda s, _, __: {"delay_s": s},
        _no_shape, twins=("motor_torque_delay",),
    ),
    HiddenEffect(
        "torque_sensor_offset", "instrument", 0.2, 3.0,
        lambda w, s, _: _instrument(w, sensor_offset_nm=s), lambda s, _, __: {"offset_nm": s},
        _no_shape, free=True, signed=True, twins=("motor_torque_offset", "friction_asymmetry"),
    ),
    HiddenEffect(
        "torque_sensor_gain", "instrument", 0.05, 0.6,
        lambda w, s, _: _instrument(w, sensor_gain=1.0 + s), lambda s, _, __: {"gain": 1.0 + s},
        _no_shape, signed=True, twins=("cardan_joint",),
    ),
    HiddenEffect(
        "torque_sensor_hysteresis", "instrument", 0.1, 0.9,
        lambda w, s, _: _instrument(w, sensor_play_nm=s), lambda s, _, __: {"play_nm": s},
        _no_shape, twins=("backlash",),
    ),
)  # fmt: skip

_PARAMETERS = (
    HiddenEffect(
        "motor_torque_gain", "parameter", 0.03, 0.4,
        lambda w, s, _: _hide(w, motor_gain=1.0 + s), lambda s, _, __: {"gain": 1.0 + s},
        _no_shape, signed=True, twins=("rack_ratio", "inertia"),
    ),
    HiddenEffect(
        "coulomb_level", "parameter", 0.1, 0.6,
        lambda w, s, _: _hide(w, coulomb_scale=1.0 + s), _scale, _no_shape, free=True,
        signed=True, twins=("friction_warmup", "friction_asymmetry"),
    ),
    HiddenEffect(
        "inertia", "parameter", 0.1, 0.6,
        lambda w, s, _: _drive(w, inertia_kg_m2=w.drive.inertia_kg_m2 * (1.0 + s)), _scale,
        _no_shape, free=True, signed=True, twins=("motor_torque_gain",),
    ),
    HiddenEffect(
        "rack_ratio", "parameter", 0.02, 0.3,
        lambda w, s, _: _drive(w, rack_rad_per_m=w.drive.rack_rad_per_m * (1.0 + s)),
        lambda s, _, __: {"scale": s}, _no_shape, signed=True, twins=("motor_torque_gain",),
    ),
    HiddenEffect(
        "presliding_hysteresis", "structure", 0.5, 6.0,
        lambda w, s, _: _drive(w, sigma0=w.drive.sigma0 / (1.0 + s)),
        lambda s, _, w: {"sigma0_nm_per_rad": w.drive.sigma0 / (1.0 + s)},
        _no_shape, free=True, twins=("stribeck", "backlash"),
    ),
)  # fmt: skip


def _rotor_to_rack(compliance: float, world: World) -> float:
    """What a rotor feels of a rack that is held (Nm/rad): CONTRACT 8 has two masses, one spring.

    On the full plant the belt and the ball nut behind it give one after the other.
    """
    nut = 0.0 if world.simple else 1.0 / NUT_NM_PER_RAD
    return 1.0 / (compliance + nut)


_CHAIN = (
    HiddenEffect(
        "belt_compliance", "structure", 0.05, 0.5,
        lambda w, s, _: replace(w, belt_nm_per_rad=1.0 / s, belt_damping=5e-3),
        lambda s, _, w: {
            "stiffness_nm_per_rad": _rotor_to_rack(s, w), "damping_nm_s_per_rad": 5e-3
        },
        _no_shape, twins=("inertia",),
    ),
    HiddenEffect(
        "backlash", "structure", 0.05, 2.0,
        lambda w, s, _: replace(w, gap_rad=s), lambda s, _, __: {"gap_rad": s},
        _no_shape, twins=("presliding_hysteresis", "torque_sensor_hysteresis"),
    ),
)  # fmt: skip

_ALIENS = (
    _plain(
        "alien_eddy_brake", "alien_eddy_nm", "peak_nm", 0.02, 0.3,
        draw=lambda r: {"speed_rad_s": float(r.uniform(8, 25))},
        shape_fields={"speed_rad_s": "alien_eddy_speed"}, alien=True,
        twins=("viscous_friction", "quadratic_drag", "stribeck"),
    ),
    _plain(
        "alien_load_memory", "alien_load_memory", "share", 0.3, 1.0,
        draw=lambda r: {"time_s": float(r.uniform(1, 4))},
        shape_fields={"time_s": "alien_load_memory_s"}, alien=True,
    ),
    _plain(
        "alien_load_ripple", "alien_load_ripple", "gain_nm_per_n", 1e-5, 1e-4,
        draw=lambda r: {"order": float(r.uniform(0.5, 1.5))},
        shape_fields={"order": "alien_load_ripple_order"}, alien=True,
    ),
    _plain(
        "alien_heat_loss", "alien_heat_loss", "loss_per_nm2", 0.1, 1.0,
        draw=lambda r: {"time_s": float(r.uniform(4, 15))},
        shape_fields={"time_s": "alien_heat_s"}, alien=True,
        twins=("motor_torque_saturation", "motor_torque_gain"),
    ),
    _plain("alien_iron_play", "alien_iron_play_nm", "play_nm", 0.01, 0.3, alien=True,
           twins=("friction_asymmetry", "presliding_hysteresis")),
    _plain("alien_one_way_drag", "alien_one_way_drag", "coefficient_nm_s_per_rad", 2e-4, 5e-3,
           alien=True, twins=("viscous_friction",)),
)  # fmt: skip

_NAMELESS = (
    _plain("alien_dead_time", "alien_dead_time_nm", "loss_nm", 0.01, 0.3, alien=True,
           twins=("coulomb_level", "motor_torque_gain")),
    _plain(
        "alien_weakening", "alien_weakening", "per_rad_s", 1e-3, 0.2,
        draw=lambda r: {"from_rad_s": float(r.uniform(15, 40))},
        shape_fields={"from_rad_s": "alien_weakening_from"}, alien=True,
    ),
    _plain("alien_driven_loss", "alien_driven_loss", "share", 0.02, 0.4, alien=True),
    _plain(
        "alien_unbalance", "alien_unbalance", "nm_s2_per_rad2", 1e-6, 1e-3, draw=_phase,
        shape_fields={"phase_rad": "alien_unbalance_phase"}, alien=True,
    ),
    _plain("alien_guide", "alien_guide", "per_nm", 1e-3, 0.1, alien=True),
    _plain(
        "alien_speed_memory", "alien_speed_memory", "nm_s_per_rad", 2e-4, 5e-3,
        draw=lambda r: {"time_s": float(r.uniform(0.15, 1.0))},
        shape_fields={"time_s": "alien_speed_memory_s"}, alien=True,
    ),
    _plain(
        "alien_ripple", "alien_ripple", "fraction", 0.03, 0.5,
        draw=lambda r: {"order": float(r.choice([2, 5, 7, 10, 14])), **_phase(r)},
        shape_fields={"order": "alien_ripple_order", "phase_rad": "alien_ripple_phase"},
        alien=True,
    ),
    _plain(
        "alien_bushing", "alien_bushing_nm", "torque_nm", 0.01, 0.3,
        draw=lambda r: {"way_rad": float(r.uniform(1.5, 8.0))},
        shape_fields={"way_rad": "alien_bushing_rad"}, alien=True,
    ),
    _plain("alien_travel_drag", "alien_travel_drag", "nm_s_per_rad", 1e-4, 5e-3, alien=True),
    _plain(
        "alien_thinning", "alien_thinning", "share", 0.1, 0.9,
        draw=lambda r: {"time_s": float(r.uniform(4, 15))},
        shape_fields={"time_s": "alien_thinning_s"}, alien=True, twins=("friction_warmup",),
    ),
    _plain(
        "alien_thrust", "alien_thrust", "nm_per_n", 1e-5, 4e-4,
        draw=lambda r: {"from_n": float(r.uniform(100, 600))},
        shape_fields={"from_n": "alien_thrust_from_n"}, alien=True,
    ),
)  # fmt: skip

_LATER = (
    _plain("late_nut_loss", "late_nut_loss", "nm_per_n", 1e-5, 4e-4, alien=True),
    _plain(
        "late_seal", "late_seal_nm", "level_nm", 0.01, 0.3,
        draw=lambda r: {"from_n": float(r.uniform(100, 400))},
        shape_fields={"from_n": "late_seal_n"}, alien=True, twins=("load_dependent_friction",),
    ),
    _plain(
        "late_film", "late_film", "level_nm", 0.01, 0.4,
        draw=lambda r: {"time_s": float(r.uniform(0.1, 0.6))},
        shape_fields={"time_s": "late_film_s"}, alien=True, twins=("stribeck",),
    ),
    _plain(
        "late_film_peak", "late_film_peak_nm", "level_nm", 0.01, 0.3,
        draw=lambda r: {"at_rad_s": float(r.uniform(15, 30)), "wide": float(r.uniform(4, 8))},
        shape_fields={"at_rad_s": "late_film_peak_at", "wide": "late_film_peak_wide"}, alien=True,
    ),
    _plain(
        "late_worn_tooth", "late_worn_tooth_nm", "amplitude_nm", 0.01, 0.3,
        draw=lambda r: {
            "order": float(r.choice([2.5, 5, 7])), "wide_m": float(r.uniform(2e-3, 6e-3))
        },
        shape_fields={"order": "late_worn_tooth_order", "wide_m": "late_worn_tooth_wide_m"},
        alien=True,
    ),
    _plain(
        "late_wet_drag", "late_wet_drag", "nm_s_per_rad", 2e-4, 8e-3,
        draw=lambda r: {"time_s": float(r.uniform(0.1, 0.5))},
        shape_fields={"time_s": "late_wet_drag_s"}, alien=True,
    ),
    _plain("late_one_way_gain", "late_one_way_gain", "gain", 0.02, 0.4, alien=True, signed=True,
           twins=("motor_torque_gain",)),
    _plain("late_braking_loss", "late_braking_loss", "share", 0.02, 0.5, alien=True),
    _plain("late_iron_loss", "late_iron_loss", "s_per_nm_rad", 1e-3, 0.1, alien=True),
    _plain(
        "late_magnet", "late_magnet_loss", "share", 0.02, 0.5,
        draw=lambda r: {"time_s": float(r.uniform(4, 15))},
        shape_fields={"time_s": "late_magnet_s"}, alien=True, twins=("motor_torque_gain",),
    ),
)  # fmt: skip

_LAST = (
    _plain("last_column_rub", "last_column_rub", "per_nm", 1e-3, 0.05, alien=True),
    _plain("last_screw_travel", "last_screw_travel", "share", 0.02, 0.5, alien=True, signed=True,
           twins=("rack_ratio",)),
    _plain(
        "last_fading_cogging", "last_fading_cogging_nm", "amplitude_nm", 0.01, 0.4,
        draw=lambda r: {
            "order": float(r.choice([4, 6, 8])), "speed_rad_s": float(r.uniform(8, 20))
        },
        shape_fields={
            "order": "last_fading_cogging_order", "speed_rad_s": "last_fading_cogging_speed"
        },
        alien=True, twins=("cogging_torque",),
    ),
    _plain(
        "last_power_limit", "last_power_limit", "per_w", 1e-3, 0.3,
        draw=lambda r: {"from_w": float(r.uniform(1, 4))},
        shape_fields={"from_w": "last_power_limit_w"}, alien=True,
    ),
)  # fmt: skip

CATALOGUED = {
    e.id: e for e in (*_FRICTION, *_RIPPLES, *_PLACES, *_INSTRUMENTS, *_PARAMETERS, *_CHAIN)
}
"""Effects of CONTRACT 8 that the plant can hide, by id."""
ALIENS = {e.id: e for e in _ALIENS}
"""Physics that no catalogue entry describes, by a name of our own."""
LATER = {e.id: e for e in (*_LATER, *_LAST)}
"""Families that were written last, before any diagnosis had seen them."""
NAMELESS = {e.id: e for e in (*_ALIENS, *_NAMELESS, *_LATER, *_LAST)}
"""All of it: what has to be modelled although it has no name."""


def find(id: str) -> HiddenEffect:
    """An effect by id; ``KeyError`` if there is none."""
    return CATALOGUED[id] if id in CATALOGUED else {**ALIENS, **NAMELESS}[id]


def drawn_sign(effect: HiddenEffect, rng: np.random.Generator) -> float:
    """±1, always +1 for an effect that has only one direction."""
    return _sign(rng) if effect.signed else 1.0
