"""Cases: a plan's effects at the strengths that it asks for, and the recordings that result."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from eps_hil.proof.concealment import evidence
from eps_hil.proof.effects import drawn_sign, find
from eps_hil.proof.hidden_effect import HiddenEffect
from eps_hil.proof.model_file import model_yaml
from eps_hil.proof.plans import KINDS, UNMEASURED, Plan
from eps_hil.proof.programmes import programme
from eps_hil.proof.sensors import measured, reported
from eps_hil.proof.sizes import SIZES, Size
from eps_hil.proof.strength import Strength, noise_rms, strength
from eps_hil.proof.truth import Drive, Floats
from eps_hil.proof.world import World

PARAMETERS = (
    "coulomb_level",
    "inertia",
    "friction_asymmetry",
    "load_dependent_friction",
    "viscous_friction",
    "presliding_hysteresis",
)
"""What a rig whose parameters are merely off may rightly be said to have."""
_ROUNDS, _DRAWS, _MOST_DRAWS, _LEAST_KEPT = 7, 5, 30, 0.4
_TO_ROTOR = Drive().pinion_rad_per_m / Drive().rack_rad_per_m
_RUNAWAY_RAD_S = 1e3
"""A rotor that is faster has left its controller (a torque that comes too late): no recording."""


@dataclass(frozen=True, slots=True)
class Case:
    """Recordings by name (canonical columns), and the answer that belongs to them.

    ``force_n`` (n,): the hold-out's true rack force at 1 kHz, which no recording shows. ``oracle``:
    the model file that knows what is hidden; empty where no model file can say it. ``nominal``: the
    model file that is handed out. ``spared``: the hold-out's programme on the same rig with
    nothing hidden, which is all that an oracle leaves.
    """

    recordings: Mapping[str, Mapping[str, Floats]]
    answer: dict[str, Any]
    force_n: Floats
    oracle: str
    nominal: str
    spared: Mapping[str, Floats] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class _Hidden:
    effect: HiddenEffect
    strength: float
    shape: Mapping[str, float]
    measured: Strength
    wanted: float
    raw: bool

    @property
    def ratio(self) -> float:
        return self.measured.raw_ratio if self.raw else self.measured.ratio


def make(plan: Plan) -> Case:
    """Simulate the recordings of a plan and measure what is hidden in them."""
    rng = np.random.default_rng([plan.seed, KINDS.index(plan.kind)])
    *train, last = programme(plan.programme, rng)
    world = World(plan.simple, rubs_behind=plan.rubs_behind, carried_kg=plan.carried_kg)
    world = _with_decoy(world, plan.decoy, rng)
    noise = usual_noise(world, train, rng)
    form = measure(world, train, noise)
    same_form = replace(world, simple=True)
    base = measure(same_form, train, noise)

    def ground(effect: HiddenEffect) -> tuple[World, Strength]:
        # the model file's own form, so that what the form leaves over is no part of a strength
        return (world, form) if effect.placed else (same_form, base)

    raw = bool(plan.twin)  # what a twin can do, a refit may be able to do as well
    hidden = []
    for name, ratio in plan.wanted:
        effect = find(name)
        hidden.append(hide(*ground(effect), effect, ratio, train, rng, raw=raw or effect.free))
    drive = world.drive
    judge = ground(hidden[-1].effect)[0] if hidden else world
    last, kept = _judging(plan, judge, hidden, last, noise, rng)

    def again(one: _Hidden) -> Strength:
        plain, without = ground(one.effect)
        changed = one.effect.apply(plain, one.strength, one.shape)
        return _beyond(measure(changed, train, noise), without)

    bare = noiseless(world, last)
    world, hidden, truth = _with_hidden(world, hidden, (*train, last), again)
    clean = [_seen(world, one) for one in truth]
    noisy = [measured(one, world.instruments, rng) for one in clean]
    answer = _answer(plan, hidden, form, strength(Drive(), clean[:-1], noise))
    answer["holdout_to_noise"] = kept
    answer["concealment"] = evidence(Drive(), clean[:-1], noisy[:-1], noisy[-1], noise)
    spared = measured(bare, world.instruments, rng)
    force_n = clean[-1]["rack_force_n"]
    oracle = _oracle(drive, hidden, SIZES[plan.size])
    return _handed_out(plan, answer, (*noisy, spared), force_n, oracle)


def _handed_out(
    plan: Plan,
    answer: dict[str, Any],
    measured: Sequence[Mapping[str, Floats]],
    force_n: Floats,
    oracle: str,
) -> Case:
    """The case as its plan has it told: without load cell, thinned, in another size.

    ``measured``: the recordings and the spared hold-out, of the rack EPS.
    """
    size = SIZES[plan.size]
    told = [
        {
            name: column[:: plan.every]
            for name, column in size.columns(one).items()
            if name != "rack_force_n" or plan.kind not in UNMEASURED
        }
        for one in measured
    ]
    for effect in answer["effects"]:
        effect["parameters"] = size.parameters(effect["effect"], effect["parameters"])
    return Case(
        dict(zip(("train_1", "train_2", "holdout"), told[:-1], strict=True)),
        answer,
        force_n * size.factor("rack_force_n"),
        oracle,
        model_yaml(Drive(), (), size),
        told[-1],
    )


def _with_hidden(
    world: World,
    hidden: Sequence["_Hidden"],
    programs: Sequence[Floats],
    again: Callable[["_Hidden"], Strength],
) -> tuple[World, list["_Hidden"], list[dict[str, Floats]]]:
    """The world with all effects, these, and what is true in each programme.

    If together they drive the rotor out of its controller's hands the last one is made weaker, and
    measured ``again``: a loop that runs away is no recording of anything.
    """
    while True:
        changed = world
        for one in hidden:
            changed = one.effect.apply(changed, one.strength, one.shape)
        truth = [changed.run(program) for program in programs]
        # the built-in max would pass over a NaN
        fastest = np.max([np.max(np.abs(one["motor_speed_rad_s"])) for one in truth])
        if fastest < _RUNAWAY_RAD_S or not hidden or not hidden[-1].strength:
            return changed, list(hidden), truth
        strength = 0.7 * hidden[-1].strength
        weaker = replace(hidden[-1], strength=strength if abs(strength) > 1e-9 else 0.0)
        hidden = [*hidden[:-1], replace(weaker, measured=again(weaker))]


def _judging(
    plan: Plan,
    world: World,
    hidden: Sequence["_Hidden"],
    last: Floats,
    noise_nm: float,
    rng: np.random.Generator,
) -> tuple[Floats, float]:
    """A hold-out that shows what it shall judge, and the effect-to-noise ratio there.

    Physics that a hold-out never touches (an end stop that is not reached) nobody can prove on it;
    such a hold-out is drawn again, a few times, and the one with the most is taken; more often
    where none of those few showed anything at all.
    """
    best, most = last, 0.0
    if not hidden:
        return best, most
    asked = hidden[-1]
    changed = asked.effect.apply(world, asked.strength, asked.shape)
    for draw in range(1, _MOST_DRAWS + 1):
        ratio, truth = 0.0, changed.run(last)
        # one that runs away on this drive judges nothing
        if np.max(np.abs(truth["motor_speed_rad_s"])) < _RUNAWAY_RAD_S:
            base = measure(world, [last], noise_nm)
            found = strength(Drive(), [_seen(changed, truth)], noise_nm)
            found = _beyond(found, base)
            ratio = found.raw_ratio if asked.raw else found.ratio
        if ratio > most:
            best, most = last, ratio
        if most > _LEAST_KEPT * asked.ratio or (most > 0.0 and draw >= _DRAWS):
            break
        last = programme(plan.programme, rng)[-1]
    return best, most


def _oracle(drive: Drive, hidden: Sequence["_Hidden"], size: Size) -> str:
    entries = [one.effect.entry(one.strength, one.shape, World(True)) for one in hidden]
    known = [entry for entry in entries if entry is not None]
    return model_yaml(drive, known, size) if len(known) == len(entries) else ""


def noiseless(world: World, program: Floats) -> dict[str, Floats]:
    """What the sensors would report of a programme if they had no noise."""
    return _seen(world, world.run(program))


def _seen(world: World, truth: Mapping[str, Floats]) -> dict[str, Floats]:
    columns = reported(truth, world.instruments)
    if world.simple:  # without a steering wheel of its own there is no angle to measure
        return {name: c for name, c in columns.items() if not name.startswith("steering_wheel")}
    return columns


def usual_noise(world: World, train: Sequence[Floats], rng: np.random.Generator) -> float:
    """Rms (Nm at the rotor) that the sensors' noise leaves of the torque balance."""
    rms = []
    for program in train:
        clean = noiseless(world, program)
        rms.append(noise_rms(Drive(), clean, measured(clean, world.instruments, rng)))
    return float(np.sqrt(np.mean(np.square(rms))))


def measure(world: World, train: Sequence[Floats], noise_nm: float) -> Strength:
    """What this world leaves of the nominal model, beside the noise."""
    return strength(Drive(), [noiseless(world, program) for program in train], noise_nm)


def _beyond(found: Strength, base: Strength) -> Strength:
    """What an effect adds to what the form of the plant leaves over without it."""
    return Strength(
        math.sqrt(max(found.effect_nm**2 - base.effect_nm**2, 0.0)),
        math.sqrt(max(found.raw_nm**2 - base.raw_nm**2, 0.0)),
        found.noise_nm,
    )


def hide(
    world: World,
    base: Strength,
    effect: HiddenEffect,
    wanted: float,
    train: Sequence[Floats],
    rng: np.random.Generator,
    *,
    raw: bool,
) -> _Hidden:
    """The strength at which the effect, alone, has the wanted effect-to-noise ratio.

    The ratio grows with strength; secant steps in the logarithms of both, kept between what was
    too weak and what was too strong.
    """
    shape, sign = effect.draw(rng), drawn_sign(effect, rng)
    value, power, weak, strong = effect.start, 1.0, 0.0, effect.limit
    before: tuple[float, float] | None = None
    for _ in range(_ROUNDS):
        changed = effect.apply(world, sign * value, shape)
        found = _beyond(measure(changed, train, base.noise_nm), base)
        ratio = max(found.raw_ratio if raw else found.ratio, 1e-3)
        if abs(ratio - wanted) < 0.05 * wanted or (value == strong and ratio < wanted):
            break
        weak, strong = (value, strong) if ratio < wanted else (weak, value)
        if before is not None:
            slope = math.log(ratio / before[1]) / math.log(value / before[0])
            power = min(max(slope, 0.5), 8.0)
        before = (value, ratio)
        value *= min(max((wanted / ratio) ** (1.0 / power), 0.1), 5.0)
        if not weak < value < strong:
            at_limit = strong == effect.limit and value >= strong
            value = strong if at_limit else math.sqrt(max(weak, 0.02 * strong) * strong)
    return _Hidden(effect, sign * value, shape, found, wanted, raw)


def _with_decoy(world: World, decoy: str, rng: np.random.Generator) -> World:
    i, d = world.instruments, world.drive
    if decoy == "noise_x3":
        return replace(world, instruments=replace(i, noise=3.0))
    if decoy == "heavy_tails":
        return replace(world, instruments=replace(i, heavy_tails=True))
    if decoy == "coarse_encoder":
        return replace(world, instruments=replace(i, encoder_step_rad=2 * math.pi / 4096))
    if decoy == "parameters_off":
        names = ("inertia_kg_m2", "k0_pos", "k0_neg", "kw_pos", "kr_pos", "kr_neg", "sigma0")
        off = {name: getattr(d, name) * float(1 + 0.12 * rng.standard_normal()) for name in names}
        return replace(world, drive=d._replace(**off))
    return world


def _answer(plan: Plan, hidden: list[_Hidden], form: Strength, total: Strength) -> dict[str, Any]:
    tolerated = [] if plan.simple else ["presliding_hysteresis"]
    if plan.decoy == "parameters_off":
        tolerated = sorted({*tolerated, *PARAMETERS})
    if plan.carried_kg:  # whose inertia it is nobody can tell
        tolerated = sorted({*tolerated, "inertia"})
    return {
        "kind": plan.kind,
        "form": "simple" if plan.simple else "full",
        "seed": plan.seed,
        "decoy": plan.decoy,
        "programme": plan.programme,
        "can": plan.can,
        "twin": plan.twin,
        "withheld": list(plan.withheld),
        "every": plan.every,
        "size": plan.size,
        "load": "carried" if plan.carried_kg else plan.programme,
        "pinion_per_rotor": _TO_ROTOR / SIZES[plan.size].angle,
        "effects": [_told(one, World(plan.simple)) for one in hidden],
        "tolerated": tolerated,
        "noise_nm": form.noise_nm,
        "form_to_noise": form.ratio,
        "total_to_noise": total.ratio,
        "oracle_nrmse_gain": 1.0 - 1.0 / math.hypot(1.0, total.ratio),
    }


def _told(one: _Hidden, world: World) -> dict[str, Any]:
    return {
        "effect": one.effect.id,
        "kind": one.effect.kind,
        "alien": one.effect.alien,
        "twins": list(one.effect.twins),
        "parameters": one.effect.tell(one.strength, one.shape, world),
        "effect_to_noise": one.ratio,
        "wanted": one.wanted,
        "projected": not one.raw,
        "reached": bool(one.ratio > 0.8 * one.wanted),
    }
