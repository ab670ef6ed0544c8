"""One case from its seed: which stretch, which faults, and the verdict."""

from collections.abc import Mapping, Sequence

import numpy as np

from eps_hil.oracle.faults import in_nodes, on_bus
from eps_hil.oracle.faults.drive import drive
from eps_hil.oracle.faults.judge import BACK_NS, WRONG_N, Outcome, errors, fault_end, judge
from eps_hil.oracle.faults.scene import ALL, Done, Kind, Scene
from eps_hil.oracle.faults.stretch import MS, Stretch
from eps_hil.oracle.faults.traffic import KEEP_MS, T0_NS, VALID, Published, World

KINDS: Mapping[str, Kind] = {kind.name: kind for kind in (*on_bus.KINDS, *in_nodes.KINDS)}
NO_FAULT = "no fault"
_RUN_UP_MS = 1_500
_QUIET_NS = 700 * MS
_ROOM_MS = 2_400
_SEQUENCE_MS = 700
"""A fault within a sequence is no longer, unless its kind cannot be shorter."""


def cases(count: int, seed: int) -> list[int]:
    """Seeds of the cases of one run."""
    return [seed * 1_000_003 + k for k in range(count)]


def single(world: World, name: str, seed: int) -> Outcome:
    """One fault of a kind by its name (or :data:`NO_FAULT`) at a random moment."""
    random = np.random.default_rng(seed)
    return run(world, [] if name == NO_FAULT else [KINDS[name]], seed, random)


def torques_late(world: World, late_ms: int, seed: int) -> Outcome:
    """Torques of ``late_ms`` ago under new counters, at a random moment."""

    def torque_values_late(scene: Scene, since: int, until: int) -> tuple[str, int]:
        return in_nodes.torques_of_before(scene, since, until, late_ms)

    return run(world, [Kind(torque_values_late, 200, 1000)], seed, np.random.default_rng(seed))


def everything_late(world: World, late_ms: int, seed: int) -> Outcome:
    """All frames ``late_ms`` later from a random moment on, as by a gateway; nothing is lost."""

    def gateway_late(scene: Scene, since: int, until: int) -> tuple[str, int]:
        return on_bus.late(scene, ALL, since, until, late_ms * MS)

    return run(world, [Kind(gateway_late, 1000, 3000)], seed, np.random.default_rng(seed))


def sequence(world: World, seed: int) -> Outcome:
    """Two to five faults of random kinds, one after the other or into each other."""
    random = np.random.default_rng(seed)
    names = list(KINDS)
    drawn = [KINDS[names[k]] for k in random.integers(0, len(names), random.integers(2, 6))]
    return run(world, drawn, seed, random)


def run(world: World, kinds: Sequence[Kind], seed: int, random: np.random.Generator) -> Outcome:
    """Draw a stretch and the faults' times, do the faults, drive the core, judge."""
    spans = _spans(kinds, random)
    scene = _scene(world, spans, random)
    for kind, since, until in spans:
        begin, end = scene.stretch.start + since, scene.stretch.start + until
        words, over = kind.make(scene, begin, end)
        scene.done.append(Done(kind.name, begin, max(over, begin), words))
    scene.stretch.end = min(scene.stretch.end, fault_end(scene) + _ROOM_MS * MS)
    scene.stretch.items = [i for i in scene.stretch.items if i.at < scene.stretch.end]
    recording = world.recordings[scene.stretch.world[0][1]]
    core = world.copy(recording.cores[(scene.stretch.start - T0_NS) // MS])
    # Most cases end when all has been well for a while; some go on to see that it stays so.
    early = random.random() < 0.8
    stopped_at = [scene.stretch.end]

    def enough(sent: list[Published], now: int) -> bool:
        if not early or now < fault_end(scene) + _QUIET_NS:
            return False
        tail = [each for each in sent[-800:] if each.at > now - _QUIET_NS]
        well = len(tail) > 0.95 * _QUIET_NS / MS and all(e.status == VALID for e in tail)
        if not well:
            return False
        off = np.abs(errors(scene, tail))
        known = off[np.isfinite(off)]
        if len(known) and float(np.max(known)) < WRONG_N / 5:
            stopped_at[0] = now
            return True
        return False

    return judge(scene, seed, drive(world, core, scene.stretch, enough), stopped_at[0])


def _spans(kinds: Sequence[Kind], random: np.random.Generator) -> list[tuple[Kind, int, int]]:
    """(kind, since, until) in ns from the stretch's start; a fault may begin within another."""
    at = int(random.uniform(50, 550) * MS)
    spans = []
    for kind in kinds:
        most = (
            kind.most_ms if len(kinds) == 1 else max(kind.least_ms, min(kind.most_ms, _SEQUENCE_MS))
        )
        length = int(np.exp(random.uniform(np.log(kind.least_ms), np.log(most))) * MS)
        spans.append((kind, at, at + length))
        if random.random() < 0.25:
            at += int(random.uniform(0, 1) * length)
        else:
            at += length + int(np.exp(random.uniform(np.log(1), np.log(600))) * MS)
    return spans


def _scene(
    world: World, spans: Sequence[tuple[Kind, int, int]], random: np.random.Generator
) -> Scene:
    names = list(world.recordings)
    length = max((until for _, _, until in spans), default=600 * MS) // MS + 1_000 + _ROOM_MS
    while True:
        recording = world.recordings[names[int(random.integers(len(names)))]]
        room = (recording.length_ms - _RUN_UP_MS - length) // KEEP_MS
        if room > 0:
            break
    start = T0_NS + (_RUN_UP_MS + KEEP_MS * int(random.integers(room))) * MS
    end = start + int(length) * MS
    stretch = Stretch(start, end, recording.between(start, end))
    stretch.world.append((start, recording.name, 0))
    return Scene(world, stretch, random)


__all__ = ["BACK_NS", "KINDS", "NO_FAULT", "cases", "run", "sequence", "single"]
