"""What shall be hidden: the kinds of cases, their plans, and the mix that a whole proof is.

Plans come from seeds alone, so that anybody can draw them again; development and proof draw from
seeds that never meet.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from eps_hil.proof.effects import ALIENS, CATALOGUED, NAMELESS, find
from eps_hil.proof.sizes import SIZES

LEVELS = (0.3, 0.6, 1.5)
"""Effect-to-noise ratios of the singles."""
STRONG, MASKED = 3.0, 0.6
TRIPLE = 1.5
LOUD = (1.5, 3.0, 8.0)
"""Of what has no name: large enough that a model of it is worth something."""
KINDS = (
    "singles",
    "pairs",
    "crowds",
    "decoys",
    "aliens",
    "poor",
    "missing",
    "twins",
    "unmeasured",
    "nameless",
    "beside",
    "triples",
    "rates",
    "sizes",
    "loads",
    "behind",
)
UNMEASURED = ("unmeasured", "loads")
"""Kinds without a load cell."""
LOADS = ("free_rack", "spring", "carried", "weight", "scrub")
"""What the motor drives where nobody measures it: programmes, and a mass that a free rack has."""
EVERY = (2, 5, 10)
"""Rows of the 1 kHz recordings of which one is kept: 500, 200 and 100 Hz."""
BEHIND = ("backlash", "belt_compliance")
"""What rotor and rack come apart by, with the friction on the rack."""
DECOYS = ("nothing", "noise_x3", "heavy_tails", "coarse_encoder", "parameters_off")
TWINS = (
    ("motor_torque_offset", "torque_sensor_offset", "never_free"),
    ("quadratic_drag", "viscous_friction", "one_speed"),
    ("torque_ripple", "cogging_torque", "one_torque"),
    ("torque_sensor_offset", "motor_torque_offset", "never_free"),
    ("friction_asymmetry", "motor_torque_offset", "never_free"),
)
"""(hidden, what it cannot be told from, in which manoeuvres it cannot)."""
MIX: Mapping[str, int] = {
    "singles": 405,
    "decoys": 300,
    "pairs": 108,
    "missing": 84,
    "aliens": 60,
    "crowds": 54,
    "unmeasured": 54,
    "beside": 30,
    "triples": 30,
    "twins": 30,
    "poor": 27,
    "loads": 60,
    "rates": 54,
    "sizes": 54,
    "behind": 20,
}
"""Cases of each kind in a full proof; every effect comes as a single at every level five times."""
QUICK: Mapping[str, int] = {
    "singles": 6,
    "decoys": 4,
    "pairs": 2,
    "missing": 1,
    "aliens": 1,
    "crowds": 1,
    "unmeasured": 1,
}
PROOF_SEEDS, MOST_SEED = 1_000_000, 998
_DISTRACTED, _ON_CAN = 10, 8
_AS_TABLES = (*UNMEASURED, "rates", "sizes")
_CARRIED_KG = 100.0, 400.0
_EMPTY = 4


@dataclass(frozen=True, slots=True)
class Plan:
    """What one case shall hold: effects with the effect-to-noise ratio that each shall have.

    ``programme``: the manoeuvres; ``can``: recordings as CAN logs; ``withheld``: effects that the
    diagnosis is told not to consider; ``twin``: what the hidden effect cannot be told from;
    ``every``: of how many rows one is kept; ``size``: of ``sizes.SIZES``; ``carried_kg``: on the
    rack; ``rubs_behind``: friction is on the rack.
    """

    kind: str
    seed: int
    wanted: tuple[tuple[str, float], ...]
    decoy: str = ""
    simple: bool = False
    programme: str = "training"
    can: bool = False
    withheld: tuple[str, ...] = ()
    twin: str = ""
    every: int = 1
    size: str = ""
    carried_kg: float = 0.0
    rubs_behind: bool = False


def first_seed(seed: int, *, proof: bool) -> int:
    """Seed of the first case of a run; ``ValueError`` where development and proof would meet."""
    if not 0 <= seed <= MOST_SEED:
        raise ValueError(f"a seed is at most {MOST_SEED}: beyond it is one of the other kind")
    return seed * 1000 + (PROOF_SEEDS if proof else 0)


def plans(
    kind: str, seed: int, count: int, *, simple: bool = False, proof: bool = False
) -> Iterator[Plan]:
    """``count`` plans of one of :data:`KINDS`, reproducible by ``seed``.

    Effects and levels take turns, so that every effect comes at every level as often as any.
    ``proof`` takes the seeds that development never sees.
    """
    first = first_seed(seed, proof=proof)
    rng = np.random.default_rng([first, KINDS.index(kind)])
    names = _names(kind)
    order = rng.permutation(len(names))
    for k in range(count):
        turn, place = divmod(k, len(names))
        name, level = names[order[place]], LEVELS[(place + turn) % len(LEVELS)]
        plan = Plan(kind, first + k, ((name, level),), simple=simple)
        yield _OF_KIND.get(kind, _single)(plan, k, rng)


def mixed(mix: Mapping[str, int], seed: int, *, proof: bool = False) -> list[Plan]:
    """The plans of a whole proof, evenly mixed: what comes first is a fair sample of all.

    One in eight is recorded over CAN. To one single or decoy in ten the diagnosis is told to leave
    out a family that has nothing to do with it, so that being told so says nothing.
    """
    placed = []
    for kind, count in mix.items():
        for k, plan in enumerate(plans(kind, seed, count, proof=proof)):
            rng = np.random.default_rng([plan.seed, KINDS.index(kind), 11])
            withheld = plan.withheld
            if kind in ("singles", "decoys") and k % _DISTRACTED == _DISTRACTED // 2:
                withheld = _unrelated(plan, rng)
            on_can = kind not in _AS_TABLES and k % _ON_CAN == _ON_CAN - 1
            placed.append(((k + 0.5) / count, replace(plan, withheld=withheld, can=on_can)))
    return [plan for _, plan in sorted(placed, key=lambda one: one[0])]


def near(name: str) -> set[str]:
    """An effect and its twins, whichever of the two names the other."""
    return {name, *find(name).twins, *(n for n, e in CATALOGUED.items() if name in e.twins)}


def lasting() -> list[str]:
    """Effects that no refit of the baseline's own parameters takes away."""
    return sorted(n for n, effect in CATALOGUED.items() if not effect.free)


def _names(kind: str) -> list[str]:
    if kind in ("aliens", "beside"):
        return list(ALIENS)
    if kind == "nameless":
        return list(NAMELESS)
    if kind == "missing":
        return [n for n in lasting() if CATALOGUED[n].kind != "parameter"]
    if kind == "twins":
        return [str(k) for k in range(len(TWINS))]
    if kind == "behind":
        return list(BEHIND)
    return list(CATALOGUED)


def _single(plan: Plan, _k: int, _rng: np.random.Generator) -> Plan:
    return plan


def _decoy(plan: Plan, k: int, _rng: np.random.Generator) -> Plan:
    return replace(plan, wanted=(), decoy=DECOYS[k % len(DECOYS)])


def _pair(plan: Plan, _k: int, rng: np.random.Generator) -> Plan:
    ((name, _),) = plan.wanted
    stranger = str(rng.choice(sorted(set(lasting()) - near(name))))
    return replace(plan, wanted=((stranger, STRONG), (name, MASKED)))


def _beside(plan: Plan, _k: int, rng: np.random.Generator) -> Plan:
    """A known effect, no twin of it, at :data:`MASKED` beside an alien at :data:`STRONG`."""
    ((alien, _),) = plan.wanted
    name = str(rng.choice(sorted(set(lasting()) - near(alien))))
    return replace(plan, wanted=((alien, STRONG), (name, MASKED)))


def _triple(plan: Plan, _k: int, rng: np.random.Generator) -> Plan:
    """Two more effects, none of the three a twin of another, each at :data:`TRIPLE`."""
    three = [name for name, _ in plan.wanted]
    while len(three) < 3:
        taken = set().union(*map(near, three))
        three.append(str(rng.choice(sorted(set(CATALOGUED) - taken))))
    return replace(plan, wanted=tuple((name, TRIPLE) for name in three))


def _crowd(plan: Plan, _k: int, rng: np.random.Generator) -> Plan:
    ((name, _),) = plan.wanted
    others = [n for n in rng.permutation(list(CATALOGUED)).tolist() if n != name][:10]
    return replace(plan, wanted=(*((other, 0.15) for other in others), (name, 1.5)))


def _louder(plan: Plan, _k: int, rng: np.random.Generator) -> Plan:
    """At 0.6 or 1.5 by lot: in turns, an effect would come at one of them only."""
    ((name, _),) = plan.wanted
    return replace(plan, wanted=((name, LEVELS[1 + int(rng.integers(2))]),))


def _loud(plan: Plan, k: int, _rng: np.random.Generator) -> Plan:
    ((name, _),) = plan.wanted
    return replace(plan, wanted=((name, LOUD[k % len(LOUD)]),))


def _poor(plan: Plan, _k: int, _rng: np.random.Generator) -> Plan:
    return replace(plan, programme="poor")


def _missing(plan: Plan, k: int, rng: np.random.Generator) -> Plan:
    louder = _louder(plan, k, rng)
    ((name, _),) = louder.wanted
    return replace(louder, withheld=tuple(sorted(near(name))))


def _twins(plan: Plan, k: int, _rng: np.random.Generator) -> Plan:
    ((place, _),) = plan.wanted
    name, twin, programme = TWINS[int(place)]
    return replace(plan, wanted=((name, LEVELS[1 + k % 2]),), twin=twin, programme=programme)


def _unmeasured(plan: Plan, k: int, _rng: np.random.Generator) -> Plan:
    """Every third holds nothing; half of them has a rack that nothing pushes."""
    ((name, _),) = plan.wanted
    wanted = () if k % 3 == 2 else ((name, LEVELS[1 + k % 2]),)
    return replace(plan, wanted=wanted, programme="free_rack" if k % 4 < 2 else "training")


def _loads(plan: Plan, k: int, rng: np.random.Generator) -> Plan:
    """Each form of load in turn; in each, every fourth case holds nothing."""
    turn, place = divmod(k, len(LOADS))
    load = LOADS[place]
    return replace(
        _some(plan, turn, rng),
        programme="free_rack" if load == "carried" else load,
        carried_kg=float(rng.uniform(*_CARRIED_KG)) if load == "carried" else 0.0,
        size="joint" if load == "weight" else "",
    )


def _rates(plan: Plan, k: int, rng: np.random.Generator) -> Plan:
    """A rate by lot: in turns, an effect would come at one of them only."""
    return replace(_some(plan, k, rng), every=EVERY[int(rng.integers(len(EVERY)))])


def _sizes(plan: Plan, k: int, rng: np.random.Generator) -> Plan:
    """A size by lot, too."""
    others = [name for name in SIZES if name]
    return replace(_some(plan, k, rng), size=others[int(rng.integers(len(others)))])


def _some(plan: Plan, turn: int, rng: np.random.Generator) -> Plan:
    """At 0.6 or 1.5; every fourth holds nothing."""
    plan = _louder(plan, turn, rng)
    return replace(plan, wanted=()) if turn % _EMPTY == _EMPTY - 1 else plan


def _behind(plan: Plan, k: int, _rng: np.random.Generator) -> Plan:
    """A gap or a soft belt at 1.5 or 3, the friction behind it."""
    ((name, _),) = plan.wanted
    return replace(plan, wanted=((name, (TRIPLE, STRONG)[k // 2 % 2]),), rubs_behind=True)


_OF_KIND: Mapping[str, Callable[[Plan, int, np.random.Generator], Plan]] = {
    "decoys": _decoy,
    "pairs": _pair,
    "crowds": _crowd,
    "aliens": _louder,
    "nameless": _loud,
    "beside": _beside,
    "triples": _triple,
    "poor": _poor,
    "missing": _missing,
    "twins": _twins,
    "unmeasured": _unmeasured,
    "loads": _loads,
    "rates": _rates,
    "sizes": _sizes,
    "behind": _behind,
}


def _unrelated(plan: Plan, rng: np.random.Generator) -> tuple[str, ...]:
    """A family that is neither hidden nor tolerated in this case."""
    kept = {other for name, _ in plan.wanted for other in near(name)}
    strangers = [n for n in lasting() if not near(n) & kept and CATALOGUED[n].kind != "parameter"]
    return tuple(sorted(near(str(rng.choice(strangers))) - kept))
