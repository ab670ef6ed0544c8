"""The files of a recording, one after the other: rotation, fsync, a full disk, a clock set back.

One part is open at a time. A disk that refuses ends the part at its last whole state; frames that
come then are counted as lost, and the next part begins when there is room again. A clock that was
set back begins a new part, too: a log whose time goes back is refused by who reads it, and no
format has a stamp before its first.
"""

import contextlib
import os
import re
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from eps_hil.bus.frame import Frame
from eps_hil.bus.record import LogFile, check_target, open_log
from eps_hil.bus.record_counts import CounterField, Counts, Key
from eps_hil.bus.record_sidecar import clock_now, sidecar_path, sync_folder, write_sidecar
from eps_hil.errors import EpsHilError, InputError

FLUSH_S = 0.5
SYNC_S = 1.0
ROOM_BYTES = 4 << 20
"""So much room there must be before a recording goes on after a full disk."""
_BACK_NS = 500_000_000
"""A channel's stamps that go back by more: its clock was set. Less, readers put in order."""
_NEVER_NS = -(2**63)

Describe = Callable[[Counts], Mapping[str, Any]]


@dataclass(frozen=True, slots=True)
class Target:
    """Where to write. ``rotate_bytes``, ``rotate_s``: a new part after so much (None: never)."""

    path: Path
    rotate_bytes: int | None = None
    rotate_s: float | None = None
    overwrite: bool = False

    @property
    def rotates(self) -> bool:
        """Whether there will be several parts, all of them numbered."""
        return self.rotate_bytes is not None or self.rotate_s is not None

    def part(self, number: int) -> Path:
        """``bus.log``, ``bus_0002.log``; with rotation ``bus_0001.log``, ``bus_0002.log``..."""
        if number == 1 and not self.rotates:
            return self.path
        return self.path.with_name(f"{self.path.stem}_{number:04d}{self.path.suffix}")

    def check(self) -> None:
        """:class:`InputError` unless every part may be made; nothing is touched."""
        check_target(self.path, overwrite=self.overwrite or self.rotates)
        if not self.overwrite and (old := self._old()):
            remedy = "choose another name, or add --overwrite"
            raise InputError(old[0], "", "exists already", remedy)

    def clear(self) -> None:
        """Remove the parts of an earlier recording of this name (``overwrite``)."""
        for old in self._old():
            old.unlink()
            sidecar_path(old).unlink(missing_ok=True)

    def _old(self) -> list[Path]:
        pattern = re.compile(rf"{re.escape(self.path.stem)}_\d{{4,}}{re.escape(self.path.suffix)}")
        folder = self.path.parent
        numbered = sorted(each for each in folder.iterdir() if pattern.fullmatch(each.name))
        return [*([] if self.rotates else self._single()), *numbered]

    def _single(self) -> list[Path]:
        with contextlib.suppress(OSError):
            return [self.path] if self.path.stat().st_size else []
        return []


class Parts:
    """Writes tagged frames; ``describe`` adds what only the recorder knows to the sidecar."""

    def __init__(
        self,
        target: Target,
        channels: Sequence[str],
        counters: Mapping[Key, CounterField],
        describe: Describe,
        say: Callable[[str], None],
    ) -> None:
        """Make the first part; :class:`InputError` if that cannot be."""
        self._target, self._channels, self._counters = target, channels, counters
        self._describe, self._say = describe, say
        self.paths: list[Path] = []
        self.frames = 0
        """In all parts that are closed, and in the open one."""
        self.lost = 0
        """Frames that a full disk kept out."""
        self._log: LogFile | None = None
        self._begun_s = self._flushed_s = self._synced_s = self._next_try_s = 0.0
        self._counts = Counts(len(channels), counters)
        self._unsure: list[list[Frame]] = [[] for _ in channels]  # written since the last flush
        self._newest_ns = [_NEVER_NS] * len(channels)  # stamps in this part
        target.check()
        if target.overwrite:
            target.clear()
        self._number = 0
        self._begin()

    @property
    def full(self) -> bool:
        """Whether the disk refuses at the moment."""
        return self._log is None

    def write(self, channel: int, frames: Sequence[Frame]) -> None:
        """Append, or count as lost; a new part where the channel's clock was set back."""
        since, newest_ns = 0, self._newest_ns
        for k, frame in enumerate(frames):
            back_ns = newest_ns[channel] - frame.t_ns
            if back_ns > _BACK_NS:
                self._append(channel, frames[since:k])
                since = k
                self._begin_anew(channel, back_ns)
            newest_ns[channel] = max(newest_ns[channel], frame.t_ns)
        self._append(channel, frames[since:])

    def _begin_anew(self, channel: int, back_ns: int) -> None:
        if self._log is None:
            self._newest_ns[:] = [_NEVER_NS] * len(self._channels)
            return
        self._rotate("ended: the clock was set back")
        if self._log is not None:
            said = f"the clock went back by {back_ns * 1e-9:.6g} s"
            self._say(f"record     {self._channels[channel]}: {said}; goes on in {self.paths[-1]}")

    def _append(self, channel: int, frames: Sequence[Frame]) -> None:
        if not frames:
            return
        if self._due(time.monotonic()):
            self._rotate()
        if self._log is None:
            self._lose(channel, len(frames))
            return
        try:
            self._log.write(frames, channel)
        except OSError as error:
            self._unsure[channel] += frames
            self._refused(error)
            return
        self._unsure[channel] += frames

    def tick(self) -> None:
        """Called several times a second: flush, fsync and sidecar, a new try after a full disk."""
        now_s = time.monotonic()
        if self._log is None:
            if now_s >= self._next_try_s:
                self._next_try_s = now_s + SYNC_S
                self._try_again()
            return
        try:
            if now_s - self._synced_s >= SYNC_S:
                self._synced_s = self._flushed_s = now_s
                self._log.sync()
                self._sure()
                self._tell(None)
            elif now_s - self._flushed_s >= FLUSH_S:
                self._flushed_s = now_s
                self._log.flush()
                self._sure()
        except OSError as error:
            self._refused(error)

    def close(self) -> None:
        """Complete the last part."""
        if self._log is None:
            return
        try:
            self._end("closed")
        except OSError as error:
            self._refused(error)

    def _due(self, now_s: float) -> bool:
        target, log = self._target, self._log
        if log is None or not self._counts.frames:
            return False
        by_size = target.rotate_bytes is not None and log.size_bytes >= target.rotate_bytes
        return by_size or (target.rotate_s is not None and now_s - self._begun_s >= target.rotate_s)

    def _rotate(self, state: str = "rotated") -> None:
        self._newest_ns[:] = [_NEVER_NS] * len(self._channels)
        try:
            self._end(state)
            self._begin()
        except OSError as error:
            self._refused(error)
        except InputError as error:  # the next part cannot be made
            self._say(f"record     {error}; frames are counted as lost until it can")
            self._counts = Counts(len(self._channels), self._counters)  # of what is lost now
            self._next_try_s = time.monotonic() + SYNC_S

    def _begin(self) -> None:
        path = self._target.part(self._number + 1)
        self._log = open_log(path, self._channels, overwrite=self._target.overwrite)
        self._number += 1
        self.paths.append(path)
        self._begun_s = self._flushed_s = self._synced_s = time.monotonic()
        self._started = clock_now()
        lost, self._counts = self._counts, Counts(len(self._channels), self._counters)
        if lost.frames == 0:  # what was lost between two parts is told by the next one
            for now, before in zip(self._counts.channels, lost.channels, strict=True):
                now.lost_on_full_disk = before.lost_on_full_disk
        with contextlib.suppress(OSError):
            sync_folder(path.parent)
            self._tell(None)

    def _end(self, state: str) -> None:
        log = self._log
        assert log is not None
        log.close()
        self._log = None
        self._sure()
        self._tell(state)

    def _sure(self) -> None:
        for channel, frames in enumerate(self._unsure):
            self.frames += len(frames)
            self._counts.take(channel, frames)
            frames.clear()

    def _lose(self, channel: int, count: int) -> None:
        self.lost += count
        self._counts.channels[channel].lost_on_full_disk += count

    def _refused(self, error: OSError) -> None:
        """The disk refuses: this part ends where it was last whole."""
        log, self._log = self._log, None
        if log is not None:
            with contextlib.suppress(OSError):
                log.cut_back()
        lost = sum(map(len, self._unsure))
        for channel, frames in enumerate(self._unsure):
            self._lose(channel, len(frames))
            frames.clear()
        self._say(
            f"record     {self.paths[-1]}: cannot write on: {error.strerror}; it holds "
            f"{self._counts.frames} frames and is readable, {lost} more are lost so far; "
            "recording goes on when there is room"
        )
        with contextlib.suppress(OSError):
            self._tell(f"ended: {error.strerror}")
        self._counts = Counts(len(self._channels), self._counters)
        self._next_try_s = time.monotonic() + SYNC_S

    def _try_again(self) -> None:
        try:
            room = os.statvfs(self._target.path.parent)
            if room.f_bavail * room.f_frsize < ROOM_BYTES:
                return
            lost = self.lost
            self._begin()
        except (OSError, EpsHilError):
            return
        self._say(f"record     room again: goes on in {self.paths[-1]}; {lost} frames lost so far")

    def _tell(self, state: str | None) -> None:
        """Replace the sidecar; ``state`` None: it is still being written."""
        now = clock_now()
        content = {
            "log": self.paths[-1].name,
            "part": self._number,
            "state": state or "recording",
            "started": self._started,
            "updated": now,
            "ended": now["utc"] if state else None,
            "frames": self._counts.frames,
            **self._describe(self._counts),
        }
        write_sidecar(sidecar_path(self.paths[-1]), content)
