"""What is true when: the rig of a stretch that is restarted and stopped, one into the other."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np

from eps_hil.bus.frame import Frame
from eps_hil.oracle.faults.in_nodes import rig_restarted, rig_stopped
from eps_hil.oracle.faults.judge import fault_end
from eps_hil.oracle.faults.scene import Done, Scene
from eps_hil.oracle.faults.stretch import MS, Item, Stretch
from eps_hil.oracle.faults.traffic import T0_NS


def _scene() -> Scene:
    """Two seconds of a rig of which every item says its own time of the recording."""

    def between(since: int, until: int) -> list[Item]:
        return [Item(at, Frame(at, 1, at.to_bytes(8, "little"))) for at in range(since, until, MS)]

    start = T0_NS + 5_000 * MS
    stretch = Stretch(start, start + 2_000 * MS, between(start, start + 2_000 * MS))
    stretch.world.append((start, "one", 0))
    world = SimpleNamespace(recordings={"one": SimpleNamespace(between=between)})
    return Scene(cast(Any, world), stretch, np.random.default_rng(1))


def _told(scene: Scene) -> list[tuple[int, int]]:
    """(true time, time of the recording that the stretch says it was) of each item that is off."""
    said = [(i.at, scene.stretch.truth_of(i.at)[1]) for i in scene.stretch.items]
    real = [int.from_bytes(item.frame.data, "little") for item in scene.stretch.items]
    return [each for each, local in zip(said, real, strict=True) if each[1] != local]


def test_a_rig_that_is_stopped_while_it_restarts_restarts_later() -> None:
    scene = _scene()
    start = scene.stretch.start
    _, until = rig_restarted(scene, start + 100 * MS, start + 600 * MS)
    scene.done.append(Done("rig restarted", start + 100 * MS, until, ""))
    _, over = rig_stopped(scene, start + 400 * MS, start + 450 * MS)
    scene.done.append(Done("rig stopped", start + 400 * MS, over, ""))
    assert _told(scene) == []
    assert fault_end(scene) == until + 50 * MS


def test_a_restart_ends_what_was_to_come() -> None:
    scene = _scene()
    start = scene.stretch.start
    rig_restarted(scene, start + 100 * MS, start + 900 * MS)
    rig_restarted(scene, start + 200 * MS, start + 300 * MS)
    assert _told(scene) == []
    rig_stopped(scene, start + 700 * MS, start + 800 * MS)
    rig_stopped(scene, start + 750 * MS, start + 1_000 * MS)
    assert _told(scene) == []
