"""Recordings without a load cell: what the load was, as far as that can be known (DIAGNOSIS 7).

A free rack, or one that works against a spring and a damper, follows its own motion: two numbers
and a constant, which are fitted with the model's own. So does a joint that lifts a weight, by the
sine and the cosine of the angle, in the place of a spring. A damper may be drag of the model's own
that is off: inside friction it lags as the bristle does. Any other force is known only as what
the torque balance lacks; below a low frequency it is taken from there, and only ripples, which are
faster, can be told from it.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from eps_hil.diagnosis.balance.baseline import GRAVITY, OFFSET, SPRING
from eps_hil.diagnosis.balance.load_written import SpringLoad, written
from eps_hil.diagnosis.balance.problem import sliding
from eps_hil.diagnosis.data.entry import also
from eps_hil.diagnosis.data.prepare import CUTOFF_HZ, SLOW_HZ, TAKEN_UP, Prepared
from eps_hil.identification.butterworth import low_pass, passed
from eps_hil.physics.effects.catalogue import catalogue
from eps_hil.physics.model import Model

Floats = npt.NDArray[np.float64]

ARBITRARY_EXCESS = 15.0
"""Typical residual in noise deviations beyond which the load is no spring and damper."""
RIPPLES = ("screw_ripple", "cogging_torque", "torque_ripple", "cardan_joint")
"""What can be told from an arbitrary force: it repeats with an angle."""
LIKE_LOAD = (
    "unmodelled_spring",
    "viscous_friction",
    "motor_torque_offset",
    "torque_sensor_offset",
    "friction_asymmetry",
    "rack_ratio",
    "load_dependent_friction",
)
"""What a load of unknown spring, damper and constant cannot be told from."""
LIKE_ANY_LOAD = ("motor_torque_gain", "motor_torque_saturation")
"""A motor that holds against any force has a torque that is like it: less of both leaves less."""
OF_LONE_TORQUE = ("motor_torque_gain",)
"""Of the only torque that was measured: a factor of it is one of the inertia and all friction."""
HUNG_RAD = 0.5, 2.0 * np.pi
"""A joint's travel: less shows no sine, and what turns farther carries no weight about."""
_BETTER = 0.9
"""Of a spring's residual energy: what a weight has to leave less of, to be one. And of a damper's,
what another drag of the model's own has to."""
_DRAG_STEP = 0.02
_DRAG = ("viscous_pos_nm_s_per_rad", "viscous_neg_nm_s_per_rad")
_ROUNDS = 6
_WRONG = 0.05
"""Of the noise: friction under another load that is worth another look."""
_LIKE_A_RATIO, _RATIO = "torque_sensor_gain", "rack_ratio"
_LIKE_FRICTION_OF_A_SPRING, _OF_LOAD = "position_dependent_friction", "load_dependent_friction"


@dataclass(frozen=True)
class Load:
    """F = stiffness x + damping ẋ + constant, none, or an arbitrary force; SI units at the rack.

    A spring's form is also that of a weight on a joint, whose torque follows the rotor's angle.
    """

    form: Literal["spring", "free", "arbitrary"]
    stiffness_n_per_m: float
    damping_n_s_per_m: float
    constant_n: float
    doubtful: bool = False
    """Whether it leaves so much that the force may have another form (:data:`ARBITRARY_EXCESS`)."""
    travel_m: float = 0.1
    speed_rad_s: float = 100.0
    """How far from its middle and how fast the rack went against it (at the rotor)."""
    sine_nm: float = 0.0
    cosine_nm: float = 0.0
    """Of the rotor's angle, at the rotor: a weight, in the place of a spring."""
    drag_nm_s_per_rad: float = 0.0
    """What the model's own drag is more than in its file, either way, in place of a damper."""
    named: bool = False
    """Of no force: whether what follows the motion is the rig's own, and gets its names."""

    @property
    def hangs(self) -> bool:
        """Whether it is a weight's, not a spring's."""
        return self.sine_nm != 0.0 or self.cosine_nm != 0.0

    def followed(self) -> "Load":
        """Of a force that may be arbitrary: the one that follows the motion, as far as it does."""
        return replace(self, form="spring", doubtful=True)

    def in_model(self, model: Model) -> Model:
        """The model with this load as effects of its own, for inputs without a rack force."""
        model = self.beside_own_drag(model)
        if self.form != "spring":
            return model
        numbers = (self.stiffness_n_per_m, self.damping_n_s_per_m, self.constant_n)
        hung = (self.sine_nm, self.cosine_nm)
        return written(model, SpringLoad(*numbers, self.travel_m, self.speed_rad_s, *hung))

    def beside_own_drag(self, model: Model) -> Model:
        """The model with the drag of its own that goes with this load."""
        return _with_drag(model, self.drag_nm_s_per_rad) if self.drag_nm_s_per_rad else model

    def sentence(self, shown: Collection[str] = ()) -> str:
        """What the user is told; ``shown``: effects (ids) that other signals show beside it."""
        hidden = ", ".join(one for one in not_told_apart(self) if one not in shown)
        if self.form == "arbitrary":
            return (
                "The rack force was not measured and follows no spring and damper: of forces only "
                f"ripples ({', '.join(RIPPLES)}) can be told from it. {hidden} cannot be told from "
                "it: record rack_force_n to find them."
            )
        if self.named:
            return (
                "The rack force was not measured; it is taken as none (a free rack): what was "
                "found explains more by fewer numbers than a load would. A load that follows the "
                f"motion would look like {', '.join(LIKE_LOAD)}: such a name is half as sure."
            )
        if self.form == "free":
            return (
                "The rack force was not measured; it is taken as none (a free rack): that explains "
                f"more than a load would. {hidden} cannot be told from one."
            )
        most = np.hypot(self.sine_nm, self.cosine_nm)
        what, held = (
            (f"a weight of {most:.3g} Nm on a joint", "an empirical sine")
            if self.hangs
            else (f"a spring of {self.stiffness_n_per_m:.3g} N/m", SPRING)
        )
        return (
            f"The rack force was not measured; it is taken as {what}, a damper of "
            f"{self.damping_n_s_per_m:.3g} N s/m and {self.constant_n:.3g} N, which a written "
            f"model holds as {held}, viscous_friction "
            f"and {OFFSET}, and friction that grows with it, if any, as an empirical map. For "
            "'simulate' they are the load; 'estimate' and 'run' with that file publish the rest "
            f"of the force: take them out there. {hidden} cannot be told from such "
            "a load."
            + (" What stays unknown may be a load of another form." if self.doubtful else "")
        )


FREE = Load("free", 0.0, 0.0, 0.0)
"""No force at all: friction that grows with load has nothing to grow with then."""
LOAD_NUMBERS = 3
"""Of a load that is written: stiffness, damping and constant; or sine, cosine and damping."""
NAMED = replace(FREE, named=True)
"""The same, with nothing that stands for a load that may be there after all."""


def missing(recordings: Iterable[Prepared]) -> bool:
    """Whether any of the recordings lacks the rack force."""
    return any("rack_force_n" not in one.raw for one in recordings)


def not_told_apart(load: Load) -> Collection[str]:
    """Ids of effects that such a load hides."""
    if load.form == "arbitrary":
        return [name for name in catalogue() if name not in RIPPLES]
    if load.named:
        return ()
    return (*LIKE_LOAD, *LIKE_ANY_LOAD) if load.doubtful else LIKE_LOAD


def of_lone_torque(recordings: Iterable[Prepared]) -> Collection[str]:
    """Ids of effects that nothing shows where the motor's is the only torque of all recordings."""
    others = ("torque_sensor_nm", "rack_force_n")
    return () if any(name in one.raw for one in recordings for name in others) else OF_LONE_TORQUE


def doubted(findings: Sequence[Mapping[str, Any]], load: Load | None) -> list[dict[str, Any]]:
    """Findings (CONTRACT 7) with what they may be instead, where nobody measured the load.

    A spring's force follows the position, and so does friction that grows with it. And with no
    rack force, the ratio only scales what the torsion bar brings to the rotor. What a load does,
    too, is half as sure where it was taken that there is none. And beside an arbitrary force an
    effect is not asked for that may be what its twin is named for.
    """
    told = [dict(one) for one in findings]
    if load is None:
        return told
    sprung = load.form == "spring" and load.stiffness_n_per_m != 0.0
    hidden = not_told_apart(load)
    for one in told:
        if load.named and one["effect"] in LIKE_LOAD:
            one["confidence"] = round(0.5 * float(one["confidence"]), 3)
            settle = "against a load at the rack: record the rack force"
            one["next_experiment"] = "; ".join(filter(None, [one["next_experiment"], settle]))
        other = _RATIO if one["effect"] == _LIKE_A_RATIO else ""
        if sprung and one["effect"] == _LIKE_FRICTION_OF_A_SPRING:
            other = _OF_LOAD
        if other:
            also(one, other, "record the rack force")
        if load.form == "arbitrary" and one["effect"] in RIPPLES:
            for twin in catalogue()[one["effect"]].twins:
                if twin in hidden:
                    also(one, twin, "record the rack force")
    return told


def load_knobs(load: Load | None) -> Mapping[str, float]:
    """The model's own numbers that stand for the load's, always free: spring or weight, damper."""
    if load is None or load.named:
        return {}
    return {
        **dict.fromkeys(GRAVITY if load.hangs else (SPRING,), 0.0),
        **dict.fromkeys(_DRAG, 0.0),
        OFFSET: 0.0,
    }


def own_drag(given: Model, written: Model) -> list[str]:
    """A sentence where the written model has another drag of its own beside an unknown load."""
    was, now = ([getattr(model.friction, name) for name in _DRAG] for model in (given, written))
    old, new = (f"{sum(both) / 2.0:.3g}" for both in (was, now))
    if old == new:
        return []
    return [
        f"Beside that load the model's own drag is {new} Nm s/rad, not {old}: that "
        "explains more than a damper does. A written model holds it. Most of it could as well be "
        "the load's: it is no finding."
    ]


def load_of(recordings: Sequence[Prepared], model: Model, *, level: bool = True) -> Load:
    """The load of the recordings without a load cell, fitted on their sliding samples.

    Beside a friction ``level`` of its own, which is no load's: a damper would take it in. Once
    names have been looked for, what no name stands for has to be somewhere: then without.
    """
    bare = [one for one in recordings if "rack_force_n" not in one.raw]
    load, left = _damped(bare, model, level=level, hung=False)
    angles = [one.motion(model).angle_rad for one in bare]
    travel = max(float(np.max(one)) for one in angles) - min(float(np.min(one)) for one in angles)
    if not HUNG_RAD[0] < travel < HUNG_RAD[1]:
        return load
    weight, less = _damped(bare, model, level=level, hung=True)
    return weight if less < _BETTER * left else load


def _damped(
    bare: Sequence[Prepared], model: Model, *, level: bool, hung: bool
) -> tuple[Load, float]:
    """The same, or with other drag of the model's own for a damper: what leaves clearly less.

    While sliding both are nearly one; a drag inside friction lags as the bristle does.
    """
    load, left = _fitted(bare, model, level=level, hung=hung)
    own, less = _fitted(bare, model, level=level, hung=hung, own=True)
    better = own.form == "spring" and less < _BETTER * left
    return (own, less) if better else (load, left)


def _fitted(
    bare: Sequence[Prepared], model: Model, *, level: bool, hung: bool, own: bool = False
) -> tuple[Load, float]:
    """A spring or a weight with a damper, and what it leaves of the sliding samples' energy.

    ``own``: the model's own drag is free for the damper.
    """
    numbers, given, drag = np.zeros(6), model, 0.0
    free = [*([3, 4] if hung else [0]), 1, 2, 5]
    for _ in range(_ROUNDS):
        rows, left, sizes = [], [], []
        for one in bare:
            filled = _filled(one, model, numbers[:5])
            mask = sliding(filled, model)
            way = np.sign(one.motion(model).speed_rad_s)
            motion = (*_motion(one, model), way if level else np.zeros(len(way)))
            columns = np.column_stack([one.thin(motion[k]) for k in free])[mask]
            rows.append(columns)
            loss = filled.left_over(model)[mask] * model.rack_to_rotor_ratio_rad_per_m
            left.append(loss - numbers[5] * columns[:, -1])
            if own:
                columns[:, free.index(1)] = _of_own_drag(filled, model)[mask]
            sizes.append(np.full(int(np.sum(mask)), filled.floor_nm(model)))
        a, r = np.vstack(rows), np.concatenate(left)
        scale = np.sqrt(np.sum(a**2, axis=0)) + 1e-300
        usual = 1.4826 * float(np.median(np.abs(r))) + 1e-300
        weight = np.minimum(1.0, 2.0 * usual / np.maximum(np.abs(r), 1e-300))
        normal = (a / scale * weight[:, None]).T @ (a / scale) + 1e-9 * np.eye(len(free))
        step = np.linalg.solve(normal, (a / scale * weight[:, None]).T @ r) / scale
        numbers[free] += step
        if own:
            least = -min(getattr(given.friction, name) for name in _DRAG)
            drag, numbers[1] = max(drag + float(numbers[1]), least), 0.0
            model = _with_drag(given, drag)
    ratio = model.rack_to_rotor_ratio_rad_per_m
    excess = usual / ratio / float(np.mean(np.concatenate(sizes)))
    k, c, f, sine, cosine = (float(number) for number in numbers[:5])
    motions = [one.motion(model) for one in bare]
    travel_m, speed = (
        max(float(np.max(np.abs(getattr(of, name)))) for of in motions)
        for name in ("position_m", "speed_rad_s")
    )
    form: Literal["arbitrary", "spring"] = "arbitrary" if excess > ARBITRARY_EXCESS else "spring"
    rest = (travel_m, speed, sine / ratio, cosine / ratio, drag)
    load = Load(form, k, c, f, False, *rest)
    return load, float(np.mean(np.minimum(np.abs(r), 2.0 * usual) ** 2))


def _with_drag(model: Model, more: float) -> Model:
    """With so much more drag of the model's own either way, Nm s/rad."""
    moved = {name: float(f"{max(getattr(model.friction, name) + more, 0.0):.6g}") for name in _DRAG}
    return replace(model, friction=replace(model.friction, **moved))


def _of_own_drag(filled: Prepared, model: Model) -> Floats:
    """What 1 Nm s/rad more of the model's own drag does, as a force at the rack, thinned (m,)."""
    least = 1e-4 * filled.size.torque / filled.size.angle
    step = _DRAG_STEP * max(model.friction.viscous_pos_nm_s_per_rad, least)
    change = filled.left_over(model) - filled.left_over(_with_drag(model, step))
    return change / step * model.rack_to_rotor_ratio_rad_per_m


def may_be_free(load: Load, recordings: Iterable[Prepared], model: Model) -> bool:
    """Whether no force at all could be what was taken for this load: its spring hardly acts."""
    for one in recordings:
        if "rack_force_n" not in one.raw:
            position, _, _, *turned = _motion(one, model)
            hung = model.rack_to_rotor_ratio_rad_per_m * np.array([load.sine_nm, load.cosine_nm])
            pull = load.stiffness_n_per_m * position + hung @ np.array(turned)
            force = float(np.std(pull))
            if force / model.rack_to_rotor_ratio_rad_per_m > ARBITRARY_EXCESS * one.floor_nm(model):
                return False
    return True


def wrong_in_friction(
    load: Load, other: Load, recordings: Iterable[Prepared], model: Model
) -> bool:
    """Whether friction under the ``other`` load differs by what noise does not hide.

    Spring, damper and constant are free beside the effects; the size of the load in it is not.
    """
    growing = 0.5 * (model.friction.load_pos_nm_per_n + model.friction.load_neg_nm_per_n)
    for one in recordings:
        if "rack_force_n" in one.raw:
            continue
        sizes = [np.abs(with_load(one, model, of).raw["rack_force_n"]) for of in (load, other)]
        wrong_nm = growing * float(np.sqrt(np.mean((sizes[1] - sizes[0]) ** 2)))
        if wrong_nm > _WRONG * one.floor_nm(model):
            return True
    return False


def with_load(one: Prepared, model: Model, load: Load) -> Prepared:
    """The recording with that load as its rack force; itself if the force was measured."""
    if "rack_force_n" in one.raw:
        return one
    ratio = model.rack_to_rotor_ratio_rad_per_m
    if load.form != "arbitrary":
        numbers = (load.stiffness_n_per_m, load.damping_n_s_per_m, load.constant_n)
        hung = (ratio * load.sine_nm, ratio * load.cosine_nm)
        return _filled(one, model, np.array([*numbers, *hung]))
    empty = _filled(one, model, np.zeros(5))
    force = np.zeros(len(one.time_s))
    for _ in range(TAKEN_UP):  # friction depends on the force that is being looked for
        rest = _with_force(empty, force, model)
        force = force + low_pass(rest.balance(model), SLOW_HZ) * ratio
    filled = _with_force(empty, force, model)
    filled = filled.changed(taken_from=filled.balance(model))
    left = filled.left_over(model)[sliding(filled, model)]
    size = 1.4826 * float(np.median(np.abs(left))) if len(left) else 0.0
    share = filled.floor_nm(model) / max(size, 1e-12)
    noise = {name: value / max(share, 1e-12) for name, value in filled.noise.items()}
    return filled.changed(noise={**noise, "motor_speed_rad_s": one.noise["motor_speed_rad_s"]})


def _motion(one: Prepared, model: Model) -> tuple[Floats, ...]:
    """What a load's numbers are multiplied with: x, ẋ, 1, sine and cosine of the angle."""
    motion = one.motion(model)
    speed = motion.speed_rad_s / model.rack_to_rotor_ratio_rad_per_m
    angle = motion.angle_rad
    return motion.position_m, speed, np.ones(len(speed)), np.sin(angle), np.cos(angle)


def _filled(one: Prepared, model: Model, numbers: Floats) -> Prepared:
    force = np.column_stack(_motion(one, model)) @ numbers
    strayed = 0.0 if "rack_position_m" in one.raw else one.strayed_rad
    noise = abs(numbers[0]) * strayed / model.rack_to_rotor_ratio_rad_per_m
    return _with_force(one, force, model, noise / np.sqrt(passed(CUTOFF_HZ, 0)))


def _with_force(one: Prepared, force: Floats, model: Model, noise_n: float = 0.0) -> Prepared:
    """``noise_n``: white noise that leaves as much as where the spring is, is unsure."""
    late = model.delays_s.of("rack_force_n")
    reported = force if late == 0.0 else np.interp(one.time_s - late, one.time_s, force)
    raw = {**one.raw, "rack_force_n": np.asarray(reported)}
    noise = {**one.noise, "rack_force_n": noise_n}
    return one.changed(raw=raw, noise=noise, load_is_assumed=True)
