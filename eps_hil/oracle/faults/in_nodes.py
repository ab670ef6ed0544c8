"""Faults of the nodes that send: wrong values under a right CRC, counters, restarts, a second ECU.

Also what becomes of the service's own process and clock.
"""

from collections.abc import Callable
from dataclasses import replace

from eps_hil.oracle.faults.payload import Layout
from eps_hil.oracle.faults.scene import ECU, STATE, TORQUES, Kind, Scene
from eps_hil.oracle.faults.stretch import MS, Item
from eps_hil.oracle.faults.traffic import T0_NS

SIGNALS = (
    (TORQUES, "MotorTorque"),
    (TORQUES, "TorsionBarTorque"),
    (STATE, "MotorSpeed"),
    (STATE, "MotorAngle"),
)


def _values(
    scene: Scene, name: str, since: int, until: int, change: Callable[[Layout, bytes], bytes]
) -> None:
    layout = scene.layout(name)

    def one(item: Item) -> Item:
        return Item(item.at, replace(item.frame, data=change(layout, item.frame.data)))

    scene.change((name,), since, until, one)


def _constant(scene: Scene, name: str, signal: str, since: int, until: int, value: float) -> None:
    raw = round(value / scene.layout(name).fields[signal].scale)
    _values(scene, name, since, until, lambda lay, data: lay.with_raw(data, **{signal: raw}))


def motor_torque_reads_8_nm(scene: Scene, since: int, until: int) -> tuple[str, int]:
    """Within the signal's range, and ten times what the motor gave."""
    value = 8.0 * scene.sign()
    _constant(scene, TORQUES, "MotorTorque", since, until, value)
    return f"the motor torque reads {value} Nm", until


def signal_off_scale(scene: Scene, since: int, until: int) -> tuple[str, int]:
    """A constant, far from anything that was measured."""
    name, signal = SIGNALS[int(scene.random.integers(len(SIGNALS)))]
    field = scene.layout(name).fields[signal]
    raw = scene.sign() * round((field.mask >> 1) * scene.pick(0.2, 1.0))
    _constant(scene, name, signal, since, until, raw * field.scale)
    return f"{signal} reads {raw * field.scale:.4g}", until


def signal_not_available(scene: Scene, since: int, until: int) -> tuple[str, int]:
    """The sender says so."""
    name, signal = SIGNALS[int(scene.random.integers(len(SIGNALS)))]
    field = scene.layout(name).fields[signal]
    _constant(scene, name, signal, since, until, field.not_available * field.scale)
    return f"{signal} is 'not available'", until


def _stuck(scene: Scene, name: str, signals: tuple[str, ...], since: int, until: int) -> None:
    held: dict[str, int] = {}

    def hold(layout: Layout, data: bytes) -> bytes:
        for signal in signals:
            held.setdefault(signal, layout.raw(data, signal))
        return layout.with_raw(data, **held)

    _values(scene, name, since, until, hold)


def torques_frozen(scene: Scene, since: int, until: int) -> tuple[str, int]:
    """Old data in frames that are new by counter and CRC."""
    _stuck(scene, TORQUES, ("MotorTorque", "TorsionBarTorque"), since, until)
    return "both torques stand still, counter and CRC run on", until


def signal_frozen(scene: Scene, since: int, until: int) -> tuple[str, int]:
    """One signal stands still."""
    name, signal = SIGNALS[int(scene.random.integers(len(SIGNALS)))]
    _stuck(scene, name, (signal,), since, until)
    return f"{signal} stands still, counter and CRC run on", until


def motor_state_frozen(scene: Scene, since: int, until: int) -> tuple[str, int]:
    """The resolver's values stand still."""
    _stuck(scene, STATE, ("MotorSpeed", "MotorAngle"), since, until)
    return "speed and angle stand still, counter and CRC run on", until


def offset_on_a_signal(scene: Scene, since: int, until: int) -> tuple[str, int]:
    """A step and back; what it may be: see docs/safety.md on offsets that stay."""
    name, signal = SIGNALS[int(scene.random.integers(len(SIGNALS)))]
    most = {"MotorTorque": 3.0, "TorsionBarTorque": 10.0, "MotorSpeed": 40.0, "MotorAngle": 20.0}
    least = {"MotorTorque": 0.15, "TorsionBarTorque": 3.0, "MotorSpeed": 1.0, "MotorAngle": 0.05}
    offset = scene.sign() * scene.pick(least[signal], most[signal])
    by = round(offset / scene.layout(name).fields[signal].scale)

    def shift(layout: Layout, data: bytes) -> bytes:
        return layout.with_raw(data, **{signal: layout.raw(data, signal) + by})

    _values(scene, name, since, until, shift)
    return f"{signal} reads {offset:.3g} too much", until


def torque_values_late(scene: Scene, since: int, until: int) -> tuple[str, int]:
    """The ECU sends old torques under new counters: nothing on the bus looks late."""
    return torques_of_before(scene, since, until, int(scene.pick(10, 60)))


def torques_of_before(scene: Scene, since: int, until: int, late: int) -> tuple[str, int]:
    """The same, by ``late`` ms."""
    layout = scene.layout(TORQUES)
    old: list[bytes] = []

    def older(lay: Layout, data: bytes) -> bytes:
        old.append(data)
        was = old[max(len(old) - 1 - late, 0)]
        return layout.with_raw(
            data,
            MotorTorque=lay.raw(was, "MotorTorque"),
            TorsionBarTorque=lay.raw(was, "TorsionBarTorque"),
        )

    _values(scene, TORQUES, since, until, older)
    return f"torques of {late} ms ago under new counters", until


def counter_stuck(scene: Scene, since: int, until: int) -> tuple[str, int]:
    """The counter stands still."""
    names = scene.some()
    for name in names:
        if scene.random.random() < 0.9:
            _stuck(scene, name, ("Counter",), since, until)
    return f"counters of {', '.join(names)} stand still, data and CRC run on", until


def counter_jumps(scene: Scene, since: int, until: int) -> tuple[str, int]:
    """By a step each frame, at random, or once: then it stays where it jumped to."""
    names, how, random = scene.some(), int(scene.random.integers(3)), scene.random
    step = int(random.integers(2, 255))
    last = scene.stretch.end if how == 2 else until
    for name in names:
        count = [0]

        def jump(layout: Layout, data: bytes, count: list[int] = count) -> bytes:
            count[0] += 1
            by = (step, int(random.integers(256)), step)[how] * (count[0] if how == 0 else 1)
            return layout.with_raw(data, Counter=(layout.raw(data, "Counter") + by) % 256)

        _values(scene, name, since, last, jump)
    words = (f"by {step} more each frame", "at random", f"once by {step}")[how]
    return f"counters of {', '.join(names)} jump {words}", since if how == 2 else until


def second_ecu(scene: Scene, since: int, until: int) -> tuple[str, int]:
    """Another node sends the ECU's ids with other values, with the same counters or its own."""
    names, random = scene.some()[:2], scene.random
    wait, own = int(scene.random.integers(30_000, 600_000)), int(random.integers(0, 2) * 97)
    torque = scene.sign() * scene.pick(0.1, 3.0)
    speed = scene.sign() * scene.pick(1.0, 20.0)
    first = random.random() < 0.5

    def both(item: Item) -> list[Item]:
        layout = scene.world.by_id(item.frame.can_id)
        assert layout is not None
        raws = {"Counter": (layout.raw(item.frame.data, "Counter") + own) % 256}
        for signal, by in (("MotorTorque", torque), ("MotorSpeed", speed)):
            if signal in layout.fields:
                own_value = layout.fields[signal].scale
                raws[signal] = layout.raw(item.frame.data, signal) + round(by / own_value)
        other = replace(item.frame, data=layout.with_raw(item.frame.data, **raws))
        if first:
            return [Item(item.at, other), Item(item.at + wait, item.frame)]
        return [item, Item(item.at + wait, other)]

    scene.change(names, since, until, both)
    counters = "counters of its own" if own else "the same counters"
    where = "before" if first else "after"
    return (
        f"a second sender of {', '.join(names)} {where} the first, {counters}, "
        f"{torque:+.2g} Nm, {speed:+.2g} rad/s", until,
    )  # fmt: skip


def ecu_restarted(scene: Scene, since: int, until: int) -> tuple[str, int]:
    """Silent, then counters from 0 in another phase of the millisecond; the angle may be 0 too."""
    scene.change(ECU, since, until, lambda item: None)
    shift, zero = int(scene.random.integers(0, MS)), scene.random.random() < 0.5
    counters: dict[int, int] = {}
    zeros: list[int] = []

    def anew(item: Item) -> Item:
        layout = scene.world.by_id(item.frame.can_id)
        assert layout is not None
        data = item.frame.data
        counter = layout.raw(data, "Counter")
        raws = {"Counter": (counter - counters.setdefault(item.frame.can_id, counter)) % 256}
        if zero and "MotorAngle" in layout.fields:
            angle = layout.raw(data, "MotorAngle")
            if angle != layout.fields["MotorAngle"].not_available:  # that is no angle to begin from
                zeros[:] = zeros or [angle]
                raws["MotorAngle"] = angle - zeros[0]
        return Item(item.at + shift, replace(item.frame, data=layout.with_raw(data, **raws)))

    scene.change(ECU, until, scene.stretch.end, anew)
    # What is sampled is the rig's; a recording cannot be sampled anew, so its time moves along.
    scene.stretch.angle_lost |= zero
    scene.stretch.pause(until, shift)
    return (
        f"the ECU is off and begins anew, {shift / MS:.2f} ms out of phase"
        + (", its angle from zero" if zero else ""), until,
    )  # fmt: skip


def rig_restarted(scene: Scene, since: int, until: int) -> tuple[str, int]:
    """Rig and ECU end; another manoeuvre begins, with counters and angle from the start."""
    stretch = scene.stretch
    names = list(scene.world.recordings)
    name = names[int(scene.random.integers(len(names)))]
    until += int(scene.random.integers(0, MS))
    shift = until - T0_NS
    begun = scene.world.recordings[name].between(T0_NS, T0_NS + stretch.end - until)
    before, _, _ = stretch.take(since, since)
    stretch.items = before + [Item(item.at + shift, item.frame) for item in begun]
    stretch.begin_anew(since, until, name, shift)
    stretch.angle_lost = True
    return f"the rig ends and begins anew with manoeuvre {name}", until


def rig_stopped(scene: Scene, since: int, until: int) -> tuple[str, int]:
    """SIGSTOP of the rig: its time stands still and goes on, counters and all."""
    stretch, wait = scene.stretch, until - since
    before, _, after = stretch.take(since, since)
    moved = [Item(item.at + wait, item.frame) for item in after]
    stretch.items = [item for item in before + moved if item.at < stretch.end]
    stretch.pause(since, wait)
    return "the rig's process is stopped and goes on", until


def service_restarted(scene: Scene, since: int, until: int) -> tuple[str, int]:
    """A new process that knows nothing; what came meanwhile is lost."""
    scene.stretch.restarts.append((since, until))
    scene.stretch.angle_lost = True
    return "the service is killed and started anew", until


def service_stopped(scene: Scene, since: int, until: int) -> tuple[str, int]:
    """The process is stopped; what came meanwhile waits in the socket."""
    scene.stretch.stops.append((since, until))
    return "SIGSTOP of the service: a batch waits for it", until


def estimates_not_sent(scene: Scene, since: int, until: int) -> tuple[str, int]:
    """The send queue is full."""
    scene.stretch.deaf.append((since, until))
    return "ENOBUFS: the estimates do not get out", until


def clock_step(scene: Scene, since: int, until: int) -> tuple[str, int]:
    """Somebody sets the clock."""
    step = scene.sign() * int(scene.pick(1, 10_000) * MS)
    scene.stretch.set_clock(since, step)
    return f"the wall clock is set by {step / MS:+.1f} ms", since


def clock_step_half_second_back(scene: Scene, since: int, until: int) -> tuple[str, int]:
    """The row of the issue: 538 N off, and valid."""
    scene.stretch.set_clock(since, -500 * MS)
    return "the wall clock is set by -500 ms", since


def clock_drift(scene: Scene, since: int, until: int) -> tuple[str, int]:
    """The clock is slewed."""
    ppm = scene.sign() * scene.pick(50, 300)
    scene.stretch.set_clock(since, ppm=ppm)
    scene.stretch.set_clock(until, ppm=0.0)
    return f"the wall clock runs {ppm:+.0f} ppm", until


KINDS = (
    Kind(motor_torque_reads_8_nm, 2, 1000), Kind(signal_off_scale, 2, 1000),
    Kind(signal_not_available, 2, 1000), Kind(torques_frozen, 20, 1000),
    Kind(signal_frozen, 20, 1000), Kind(motor_state_frozen, 20, 1000),
    Kind(offset_on_a_signal, 20, 1000), Kind(torque_values_late, 200, 1000),
    Kind(counter_stuck, 5, 1000), Kind(counter_jumps, 5, 1000), Kind(second_ecu, 20, 1000),
    Kind(ecu_restarted, 20, 2000), Kind(rig_restarted, 20, 2000), Kind(rig_stopped, 5, 2000),
    Kind(service_restarted, 20, 2000), Kind(service_stopped, 5, 2500),
    Kind(estimates_not_sent, 1, 500), Kind(clock_step, 1, 1),
    Kind(clock_step_half_second_back, 1, 1), Kind(clock_drift, 200, 2000),
)  # fmt: skip
