"""A stretch of traffic through a service's core in lock-step: what it then puts on the bus.

The loop is imitated where it matters: frames reach the core in batches that end with the sync
frame, a process that does not run leaves its frames in the socket (as many as fit) and takes them
in batches afterwards, and a killed one loses them. ``now`` is the service's wall clock.
"""

from collections.abc import Callable, Iterator

from eps_hil.bus.frame import Frame, frame_of
from eps_hil.oracle.faults.stretch import MS, Item, Stretch
from eps_hil.oracle.faults.traffic import Published, World, deliver
from eps_hil.service.core import ServiceCore

_BATCH_FRAMES = 1_024  # what a port hands over at once
_BUFFER_FRAMES = 5_000  # what a receive buffer of 4 MiB holds
_HANDLED_NS = 60_000  # from a frame's arrival to the answer on the bus

Enough = Callable[[list[Published], int], bool]


def drive(
    world: World, core: ServiceCore, stretch: Stretch, enough: Enough | None = None
) -> list[Published]:
    """Everything that the service publishes; ``enough`` (asked now and then) ends it early."""
    sent: list[Published] = []
    restarts = sorted(stretch.restarts)
    asked = stretch.start
    for now, batch in batches(stretch, world.sync_id):
        while restarts and now >= restarts[0][1]:
            core = world.fresh()
            restarts.pop(0)
        frames = [_stamped(item, stretch) for item in batch]
        for answer in deliver(core, frames, stretch.wall(now)):
            if not any(since <= now < until for since, until in stretch.deaf):
                sent.append(world.reader.read(now, answer))
        if enough is not None and now - asked > 100 * MS:
            asked = now
            if enough(sent, now):
                break
    return sent


def batches(stretch: Stretch, sync_id: int | None) -> Iterator[tuple[int, list[Item]]]:
    """(true time of delivery, batch) as a loop would be woken."""
    waiting: list[Item] = []
    queue: list[Item] = []
    stopped = sorted(stretch.stops)
    for item in stretch.items:
        if any(since <= item.at < until for since, until in stretch.restarts):
            waiting, queue = [], []
            continue
        if queue and not _within(stopped, item.at):
            yield from _drained(queue, _end_of(stopped, queue[-1].at))
            queue = []
        if _within(stopped, item.at):
            queue += waiting if len(queue) < _BUFFER_FRAMES else []
            waiting = []
            if len(queue) < _BUFFER_FRAMES:
                queue.append(item)
            continue
        if waiting and item.at - waiting[0].at > MS:
            yield waiting[-1].at + _HANDLED_NS, waiting
            waiting = []
        waiting.append(item)
        if item.frame.can_id == sync_id:
            yield item.at + _HANDLED_NS, waiting
            waiting = []
    if waiting:
        yield waiting[-1].at + _HANDLED_NS, waiting


def _drained(queue: list[Item], at: int) -> Iterator[tuple[int, list[Item]]]:
    for k in range(0, len(queue), _BATCH_FRAMES):
        yield at + (k // _BATCH_FRAMES + 1) * _HANDLED_NS, queue[k : k + _BATCH_FRAMES]


def _within(spans: list[tuple[int, int]], at: int) -> bool:
    return any(since <= at < until for since, until in spans)


def _end_of(spans: list[tuple[int, int]], at: int) -> int:
    """When the process runs again that was stopped at ``at``; spans may overlap."""
    while _within(spans, at):
        at = max(until for since, until in spans if since <= at < until)
    return at


def _stamped(item: Item, stretch: Stretch) -> Frame:
    """The frame with the stamp of the service's wall clock at its arrival."""
    t_ns = stretch.wall(item.at) if stretch.clock else item.at
    f = item.frame
    if f.t_ns == t_ns:
        return f
    return frame_of(t_ns, f.can_id, f.data, f.extended, f.fd, f.error, f.own, f.remote, f.brs)
