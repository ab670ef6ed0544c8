"""Healthy traffic of the simulated rig, recorded once, and what a service publishes from it.

The frames are those of a bus (database, counters, CRCs), with the stamps that a bus gives: later
than the millisecond by the frames before them and by some jitter. The reference of every fault is
what the service's core publishes from these very frames, read by the harness's own reader. Cores
are kept every half second, so that a fault in mid manoeuvre needs no run-up.
"""

import copy
from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from eps_hil.bus.database import find_message
from eps_hil.bus.frame import Frame
from eps_hil.examples import CONFIGS
from eps_hil.oracle.faults.payload import Layout
from eps_hil.oracle.faults.stretch import MS, Item
from eps_hil.rig.config import load_rig_setup
from eps_hil.rig.process import RigSimulation
from eps_hil.service.config import load_config
from eps_hil.service.core import ServiceCore
from eps_hil.service.setup import prepare

CONFIG = CONFIGS / "demo_udp.yaml"
T0_NS = 1_790_000_000_000_000_000
KEEP_MS = 500
_FRAME_NS = 120_000
_JITTER_NS = 40_000
VALID = 2

Floats = npt.NDArray[np.float64]
Int64 = npt.NDArray[np.int64]


class Published(NamedTuple):
    """One estimate frame as a receiver has it: when (true time) and what it says."""

    at: int
    force_n: float
    status: int
    reason: int
    age_ms: float
    good: bool
    counter: int

    @property
    def instant(self) -> int:
        """The physical instant that it claims to speak of, in true time."""
        return self.at - round(self.age_ms * 1e6)


class Reader:
    """Reads estimate frames by the database, with none of the service's code."""

    def __init__(self, message: Any) -> None:
        self._layout = Layout.of(message)
        fields = self._layout.fields
        self._force, self._age = fields["RackForceEstimate"], fields["EstimateAge"]
        self._status, self._reason = fields["EstimateStatus"], fields["EstimateReason"]
        self._counter = fields["Counter"]
        self.can_id = self._layout.can_id

    def read(self, at: int, frame: Frame) -> Published:
        """The frame as it left the service at true time ``at``."""
        number = int.from_bytes(frame.data, "little")
        return Published(
            at,
            self._force.value(number),
            self._status.raw(number),
            self._reason.raw(number),
            self._age.value(number),
            self._layout.crc_of(frame.data) == frame.data[0],
            self._counter.raw(number),
        )


@dataclass(frozen=True, slots=True)
class Healthy:
    """One recording: ``items`` in order, and per millisecond (n,) what was true.

    ``instants`` (true ns), ``force_n`` and ``valid`` (m,) are what the service published;
    ``angle_rad`` (n,) is the rotor's angle as the bus shows it, smoothed over 20 ms.
    """

    name: str
    items: Sequence[Item]
    instants: Int64
    force_n: Floats
    valid: npt.NDArray[np.bool_]
    angle_rad: Floats
    cores: dict[int, ServiceCore]

    @property
    def length_ms(self) -> int:
        """Duration."""
        return len(self.angle_rad)

    def between(self, since: int, until: int) -> list[Item]:
        """Items that were sent within [since, until) of the recording's time, ns."""
        first = bisect_left(self.items, since, key=lambda item: item.at)
        last = bisect_left(self.items, until, key=lambda item: item.at)
        return list(self.items[first:last])


class World:
    """Everything that the cases share: the recordings, a fresh core, the layouts of the frames."""

    def __init__(
        self,
        manoeuvres: Sequence[tuple[str, int]],
        config: Path = CONFIG,
        kind: Literal["observer", "bristle_filter"] = "observer",
    ) -> None:
        """``manoeuvres``: (name, seconds) of each recording; ``kind``: the estimator's."""
        asked = load_config(config)
        self.parts = prepare(replace(asked, estimator=replace(asked.estimator, kind=kind)), config)
        self.parts.warm_up()
        parts = self.parts
        self.memo = {id(each): each for each in (parts.database, *parts.database.messages)}
        publish = find_message(parts.database, parts.config.publish.message)
        assert publish is not None
        self.reader = Reader(publish)
        self.layouts = {
            message.name: Layout.of(message)
            for message in parts.database.messages
            if message.frame_id in parts.decoder.receive_ids or message is publish
        }
        self.sync_id = parts.decoder.sync_id
        self.recordings = {
            name: self._record(config, name, seconds, seed)
            for seed, (name, seconds) in enumerate(manoeuvres)
        }

    def fresh(self) -> ServiceCore:
        """The core of a service that has just been started."""
        return self.copy(self.parts.core)

    def copy(self, core: ServiceCore) -> ServiceCore:
        """A core in the same state, sharing nothing that changes."""
        return copy.deepcopy(core, dict(self.memo))

    def by_id(self, can_id: int) -> Layout | None:
        """Layout of a message that the service listens to."""
        return next((each for each in self.layouts.values() if each.can_id == can_id), None)

    def _record(self, config: Path, name: str, seconds: int, seed: int) -> Healthy:
        setup = load_rig_setup(config, name)
        rig = RigSimulation(replace(setup, rig=replace(setup.rig, seed=seed)))
        ids, random = set(self.parts.decoder.receive_ids), np.random.default_rng(seed)
        items: list[Item] = []
        angle = np.zeros(seconds * 1000)
        state = self.layouts["EPS_MotorState"]
        jitter = random.integers(0, _JITTER_NS, (seconds * 1000, 16))
        for k in range(seconds * 1000):
            now = T0_NS + k * MS
            for place, frame in enumerate(rig.step(now)):
                at = now + (place + 1) * _FRAME_NS + int(jitter[k, place])
                if frame.can_id in ids:  # the kernel's filter leaves out the others
                    items.append(Item(at, replace(frame, t_ns=at)))
                if frame.can_id == state.can_id:
                    angle[k] = state.value(frame.data, "MotorAngle")
        smooth = np.convolve(np.pad(angle, (10, 9), mode="edge"), np.full(20, 0.05), "valid")
        return self._reference(name, items, smooth)

    def _reference(self, name: str, items: list[Item], angle: Floats) -> Healthy:
        core, sent = self.fresh(), []
        cores, next_ms = {}, KEEP_MS
        for item in items:
            if item.at >= T0_NS + next_ms * MS:
                cores[next_ms] = self.copy(core)
                next_ms += KEEP_MS
            sent += [self.reader.read(item.at, f) for f in deliver(core, [item.frame], item.at)]
        return Healthy(
            name,
            items,
            np.array([each.instant for each in sent], np.int64),
            np.array([each.force_n for each in sent]),
            np.array([each.status == VALID for each in sent]),
            angle,
            cores,
        )


def deliver(core: ServiceCore, frames: Sequence[Frame], wall_ns: int) -> list[Frame]:
    """Hand a batch to the core as the loop does, at ``wall_ns`` of the service's clock."""
    return core.on_frames(frames, lambda: wall_ns)
