"""Faults of the bus: frames that are missing, doubled, out of order, late, damaged or forged."""

from dataclasses import replace

from eps_hil.bus.frame import Frame
from eps_hil.oracle.faults.scene import ALL, ECU, LOAD_CELL, STATE, TORQUES, Kind, Scene, ms
from eps_hil.oracle.faults.stretch import MS, Item

_FRAME_NS = 120_000


def ecu_silent(scene: Scene, since: int, until: int) -> tuple[str, int]:
    """The ECU sends nothing."""
    scene.change(ECU, since, until, lambda item: None)
    return "both messages of the ECU are missing", until


def motor_state_silent(scene: Scene, since: int, until: int) -> tuple[str, int]:
    """One message, the sync frame, is missing."""
    scene.change((STATE,), since, until, lambda item: None)
    return f"{STATE} (the sync frame) is missing", until


def torques_silent(scene: Scene, since: int, until: int) -> tuple[str, int]:
    """One message, that of the torques, is missing."""
    scene.change((TORQUES,), since, until, lambda item: None)
    return f"{TORQUES} is missing", until


def rig_silent(scene: Scene, since: int, until: int) -> tuple[str, int]:
    """The load cell's message is missing."""
    scene.change((LOAD_CELL,), since, until, lambda item: None)
    return f"{LOAD_CELL} is missing", until


def bus_silent(scene: Scene, since: int, until: int) -> tuple[str, int]:
    """A short silence of the whole bus."""
    scene.change(ALL, since, until, lambda item: None)
    return "no frame at all", until


def gap_of_seconds(scene: Scene, since: int, until: int) -> tuple[str, int]:
    """A silence after which sample time jumps by more than a second."""
    scene.change(ALL, since, until, lambda item: None)
    return f"no frame at all for {ms(until - since)}", until


def frames_lost(scene: Scene, since: int, until: int) -> tuple[str, int]:
    """Single frames are lost at random."""
    names, share = scene.some(), scene.pick(0.01, 0.95)
    draw = scene.random.random
    scene.change(names, since, until, lambda item: None if draw() < share else item)
    return f"{share:.0%} of {', '.join(names)} lost", until


def frames_doubled(scene: Scene, since: int, until: int) -> tuple[str, int]:
    """Frames arrive twice, bit for bit the same."""
    names, share, random = scene.some(), scene.pick(0.05, 1.0), scene.random
    wait = int(scene.pick(0.1, 1.5) * MS)

    def double(item: Item) -> list[Item]:
        again = Item(item.at + wait, item.frame)
        return [item, again] if random.random() < share else [item]

    scene.change(names, since, until, double)
    return f"{share:.0%} of {', '.join(names)} twice, {ms(wait)} apart", until + wait


def frames_swapped(scene: Scene, since: int, until: int) -> tuple[str, int]:
    """Neighbours of one message change places."""
    names, share = scene.some(), scene.pick(0.05, 1.0)
    ids, random = scene.ids(names), scene.random
    before, within, after = scene.stretch.take(since, until)
    for can_id in sorted(ids):
        places = [k for k, item in enumerate(within) if item.frame.can_id == can_id]
        for one, other in zip(places[::2], places[1::2], strict=False):
            if random.random() < share:
                a, b = within[one], within[other]
                within[one] = Item(a.at, b.frame)
                within[other] = Item(b.at, a.frame)
    scene.stretch.items = before + within + after
    return f"{share:.0%} of the neighbours of {', '.join(names)} swapped", until


def late(
    scene: Scene, names: tuple[str, ...], since: int, until: int, wait: int
) -> tuple[str, int]:
    """A queue of ``wait``: nothing overtakes, and at its end it empties at the bus's speed."""
    free = {can_id: since for can_id in scene.ids(names)}

    def held(item: Item) -> Item:
        due = item.at + wait if item.at < until else item.at
        at = max(due, free[item.frame.can_id] + _FRAME_NS)
        free[item.frame.can_id] = at
        return Item(at, item.frame)

    scene.change(names, since, until + 4 * wait, held)
    return f"{', '.join(names)} {ms(wait)} late", until + 2 * wait


def one_message_late(scene: Scene, since: int, until: int) -> tuple[str, int]:
    """Frames of one message wait; the others do not."""
    names = (STATE,) if scene.random.random() < 0.4 else (TORQUES,)
    return late(scene, names, since, until, int(scene.pick(1, 150) * MS))


def torques_20_ms_late(scene: Scene, since: int, until: int) -> tuple[str, int]:
    """The row of the issue: 375 N off, and valid."""
    return late(scene, (TORQUES,), since, until, 20 * MS)


def all_frames_late(scene: Scene, since: int, until: int) -> tuple[str, int]:
    """The bus is blocked again and again; then all that waited comes in a burst."""
    block = int(scene.pick(1, 150) * MS)
    pause = int(scene.pick(0.3, 3.0) * block)
    free = [since]

    def held(item: Item) -> Item:
        into = (item.at - since) % (block + pause)
        opens = item.at - into + block if into < block and item.at < until else item.at
        at = max(opens, item.at, free[0] + _FRAME_NS)
        free[0] = at
        return Item(at, item.frame)

    scene.change(ALL, since, until + 4 * block, held)
    return f"the bus is blocked for {ms(block)} every {ms(block + pause)}", until + 2 * block


def crc_wrong(scene: Scene, since: int, until: int) -> tuple[str, int]:
    """A CRC that does not belong to the data."""
    names, share, random = scene.some(), scene.pick(0.02, 1.0), scene.random

    def spoil(item: Item) -> Item:
        if random.random() >= share:
            return item
        wrong = item.frame.data[0] ^ int(random.integers(1, 256))
        data = bytes((wrong,)) + item.frame.data[1:]
        return Item(item.at, replace(item.frame, data=data))

    scene.change(names, since, until, spoil)
    return f"{share:.0%} of {', '.join(names)} with a wrong CRC", until


def sync_crc_wrong(scene: Scene, since: int, until: int) -> tuple[str, int]:
    """Every sync frame is damaged."""

    def spoil(item: Item) -> Item:
        data = bytes((item.frame.data[0] ^ 0x5A,)) + item.frame.data[1:]
        return Item(item.at, replace(item.frame, data=data))

    scene.change((STATE,), since, until, spoil)
    return "every sync frame with a wrong CRC", until


def bits_flipped(scene: Scene, since: int, until: int) -> tuple[str, int]:
    """Bits turn over; one in 256 such frames has a right CRC all the same."""
    names, share, count = scene.some(), scene.pick(0.02, 1.0), int(scene.random.integers(1, 9))
    random = scene.random

    def flip(item: Item) -> Item:
        if random.random() >= share:
            return item
        number = int.from_bytes(item.frame.data, "little")
        for bit in random.integers(0, 64, count).tolist():
            number ^= 1 << bit
        return Item(item.at, replace(item.frame, data=number.to_bytes(8, "little")))

    scene.change(names, since, until, flip)
    return f"{count} bits flipped in {share:.0%} of {', '.join(names)}", until


def error_frames(scene: Scene, since: int, until: int) -> tuple[str, int]:
    """Error frames between good traffic."""
    stretch, random = scene.stretch, scene.random
    count = int(random.integers(1, 200))
    times = random.integers(since, until, count).tolist()
    made = [Item(at, Frame(at, 0x40, bytes(8), error=True)) for at in times]
    stretch.items = sorted(stretch.items + made, key=lambda item: item.at)
    return f"{count} error frames", until


def bus_off(scene: Scene, since: int, until: int) -> tuple[str, int]:
    """Silence between two error frames."""
    scene.change(ALL, since, until, lambda item: None)
    made = [Item(since, Frame(since, 0x40, bytes(8), error=True))]
    made.append(Item(until, Frame(until, 0x100, bytes(8), error=True)))
    stretch = scene.stretch
    stretch.items = sorted(stretch.items + made, key=lambda item: item.at)
    return "the controller is off the bus and restarts", until


def flood(scene: Scene, since: int, until: int) -> tuple[str, int]:
    """Foreign ids at the full load: ours wait for the wire, and some never get it."""
    share, random = scene.pick(0.2, 0.999), scene.random
    free = [since]
    lost = [0]
    slot = round(_FRAME_NS / (1.0 - share)) if share < 1.0 else MS

    def wait(item: Item) -> Item | None:
        at = max(item.at, free[0]) + int(random.exponential(slot)) // 4
        if at - item.at > 5 * MS:  # the sender's mailbox was overwritten by the next one
            lost[0] += 1
            return None
        free[0] = at + _FRAME_NS
        return Item(at, item.frame)

    scene.change(ALL, since, until, wait)
    made = []
    if random.random() < 0.1:  # mostly the kernel's filter keeps them away
        for at in range(since, until, _FRAME_NS):
            can_id = int(random.choice([0x10, 0x55, 0x7F, 0x3AB]))
            made.append(Item(at, Frame(at, can_id, random.bytes(8))))
    stretch = scene.stretch
    stretch.items = sorted(stretch.items + made, key=lambda item: item.at)
    return f"foreign ids take {share:.1%} of the bus, {lost[0]} frames of ours lost", until + 5 * MS


def second_sender_of_our_id(scene: Scene, since: int, until: int) -> tuple[str, int]:
    """Another service publishes too."""
    layout = scene.world.layouts[scene.world.parts.config.publish.message]
    period = int(scene.pick(1, 20) * MS)
    stretch, random = scene.stretch, scene.random
    made: list[Item] = []
    for at in range(since, until, period):
        data = layout.with_raw(bytes(8), Counter=len(made) % 16, EstimateStatus=2,
                               RackForceEstimate=int(random.integers(-5000, 5000)))  # fmt: skip
        made.append(Item(at, Frame(at, layout.can_id, data)))
    stretch.items = sorted(stretch.items + made, key=lambda item: item.at)
    return f"somebody else sends our estimate's id every {ms(period)}", made[-1].at


KINDS = (
    Kind(ecu_silent, 5, 1500), Kind(motor_state_silent, 5, 1500), Kind(torques_silent, 5, 1500),
    Kind(rig_silent, 5, 1500), Kind(bus_silent, 5, 1000), Kind(gap_of_seconds, 1001, 3000),
    Kind(frames_lost, 20, 1000), Kind(frames_doubled, 20, 1000), Kind(frames_swapped, 20, 1000),
    Kind(one_message_late, 20, 1000), Kind(torques_20_ms_late, 200, 1000),
    Kind(all_frames_late, 20, 1000), Kind(crc_wrong, 5, 1000), Kind(sync_crc_wrong, 5, 1000),
    Kind(bits_flipped, 5, 1000), Kind(error_frames, 20, 1000), Kind(bus_off, 100, 1500),
    Kind(flood, 50, 1000), Kind(second_sender_of_our_id, 20, 500),
)  # fmt: skip
