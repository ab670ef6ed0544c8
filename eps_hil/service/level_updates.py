"""What surrounds the friction levels of a running service: the operator's word, journal, bus.

None of it is in the path of a frame. The operator's word is SIGUSR1: the model file that the
service was started with is read again (beside the loop), and its k0± are taken over while it runs.
"""

import asyncio
import math
import os
import sys
import time
from collections import deque
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from eps_hil.bus.frame import Frame
from eps_hil.errors import InputError
from eps_hil.estimation.levels import FrictionLevels
from eps_hil.physics.effects.catalogue import with_model_effects
from eps_hil.physics.model import Model, load_model
from eps_hil.service.friction_levels import FrictionLevelKeeper, LevelEvent
from eps_hil.service.journal import Journal
from eps_hil.service.online_methods import with_levels
from eps_hil.service.setup import Parts

_PERIOD_S = 0.2
_WAITING_MAX = 10_000
"""Events that wait for a disk that is full; of more than that the oldest are lost."""
_SWITCH_S = 5e-4
"""How soon a thread that reads a file gives way to the loop (Python's own: 5 ms)."""

Say = Callable[[str], None]


def levels_of(model: Model) -> FrictionLevels:
    """k0± as the estimator takes them, with the model's effects worked in."""
    friction = with_model_effects(model).friction
    return FrictionLevels(friction.offset_pos_nm, friction.offset_neg_nm)


class LevelUpdates:
    """One run's; ``journal`` None: events are said and published, not kept.

    :class:`InputError` at once for a journal that cannot be written, where there will be one.
    """

    def __init__(self, parts: Parts, say: Say, journal: Path | None = None) -> None:
        self._parts, self._say = parts, say
        self._keeper: FrictionLevelKeeper = parts.levels
        self._model = load_model(parts.config.model)
        self._path, self._journal = journal, Journal(None)
        if parts.config.adaptation is not None:
            self._journal = Journal(journal)
        self._told: tuple[str, str] | None = None
        self._waiting: deque[dict[str, Any]] = deque(maxlen=_WAITING_MAX)
        self._refused = False

    def hint(self) -> str:
        """How an operator gives new levels."""
        return f"levels     kill -USR1 {os.getpid()} takes k0+ and k0- anew from the model file"

    async def reread(self) -> None:
        """The model file once more; whatever is wrong with it is said, and nothing changes."""
        before = sys.getswitchinterval()
        sys.setswitchinterval(_SWITCH_S)
        try:
            model = await asyncio.to_thread(load_model, self._parts.config.model)
        except InputError as error:
            self._say(f"levels     not taken: {error}")
            return
        finally:
            sys.setswitchinterval(before)
        self._keeper.operator(levels_of(model))
        own = FrictionLevels(self._model.friction.offset_pos_nm, self._model.friction.offset_neg_nm)
        if with_levels(model, own) != self._model:
            self._say(
                "levels     the model file differs in more than k0+ and k0-: restart for that"
            )

    async def keep(self) -> None:
        """Say and write what happens until cancelled; the rest is written then."""
        writing: asyncio.Future[None] | None = None
        try:
            while True:
                await asyncio.sleep(_PERIOD_S)
                writing = asyncio.ensure_future(asyncio.to_thread(self._write, self._fresh()))
                await asyncio.shield(writing)
        finally:
            if writing is not None:  # a thread goes on, and two would write one entry twice
                await asyncio.gather(writing, return_exceptions=True)
            self._write(self._fresh())
            self._journal.close()

    def frames(self) -> list[Frame]:
        """What is published about levels, now."""
        made = []
        if self._parts.level_frames is not None:
            made.append(self._parts.level_frames.frame(self._keeper.level_values()))
        if self._parts.suggestion_frames is not None:
            made.append(self._parts.suggestion_frames.frame(self._keeper.suggestion_values()))
        return made

    @property
    def period_s(self) -> float:
        """How often; infinite where nothing is published about levels."""
        parts, adaptation = self._parts, self._parts.config.adaptation
        told = parts.level_frames is not None or parts.suggestion_frames is not None
        return adaptation.period_s if told and adaptation is not None else math.inf

    def _fresh(self) -> Sequence[LevelEvent]:
        events = self._keeper.take_events()
        for event in events:
            kind = event.fate, event.source
            if event.fate == "taken" or kind != self._told:
                self._say(f"levels     {event}")
            self._told = kind
        return events

    def _write(self, events: Sequence[LevelEvent]) -> None:
        utc = datetime.fromtimestamp(time.time(), UTC).isoformat(timespec="milliseconds")
        self._waiting += [{"utc": utc, **event.as_json()} for event in events]
        if not self._waiting or self._path is None:
            self._waiting.clear()
            return
        if self._journal.closed:
            try:
                self._journal = Journal(self._path)
            except InputError as error:
                self._path = None
                self._say(f"levels     no journal is kept: {error}")
                return
        try:
            while self._waiting:
                self._journal.note(self._waiting[0])
                self._waiting.popleft()
        except OSError as error:
            if not self._refused:
                self._say(f"levels     {self._path}: cannot be written: {error.strerror}")
            self._refused = True
            return
        if self._refused:
            self._refused = False
            self._say(f"levels     {self._path}: written again")
