"""The simulated rig and ECU as a process of its own, in real time on a bus.

It sends as the ECU, so it listens first: where somebody sends what it would, it does not begin, and
it ends where somebody does later. It keeps nothing: killed at any moment it leaves a bus that has
simply gone silent. What it knows and a real rig does not (true friction, true speed) stays inside.
"""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from eps_hil.board import Notice
from eps_hil.bus.commands import of_database, refuse_command
from eps_hil.bus.config import describe_ids
from eps_hil.bus.database import find_message, load_database
from eps_hil.bus.frame import Frame
from eps_hil.bus.live_senders import LISTEN_S, LiveSenders
from eps_hil.bus.mapping import load_mapping
from eps_hil.bus.port import Port, open_port
from eps_hil.bus.reconnecting_port import ReconnectingPort
from eps_hil.rig.command import RIG_COMMAND, RigControl, SetPointReader
from eps_hil.rig.config import RigSetup
from eps_hil.rig.ecu import COMMAND, CommandReader, Override
from eps_hil.rig.frames import frames_of, schedule
from eps_hil.rig.plant import TRUE_SIGNALS, Plant
from eps_hil.rig.realtime import Lateness, Pacer, settle
from eps_hil.rig.reported import Losses, drifts_ppm
from eps_hil.rig.sensors import REPORTED, Sensors, SensorSettings

_STOP_MS = 20
_WHEEL_ANGLE = TRUE_SIGNALS.index("steering_wheel_angle_rad")


@dataclass(frozen=True, slots=True)
class RigReport:
    """Counts at the end of a run."""

    simulated_s: float
    frames_sent: int
    send_dropped: int
    commands: int
    bad_commands: int
    timeouts: int
    clipped: int
    overruns: int
    caught_up_ms: float
    lateness: Lateness


class RigSimulation:
    """Plant, sensors, ECU and frames, one tick per call (:mod:`frames`); no bus and no clock."""

    def __init__(self, setup: RigSetup) -> None:
        files = ", ".join(str(path) for path in setup.bus.dbc)
        mapping = load_mapping(setup.bus.signals)
        database = load_database(setup.bus.dbc, strict=mapping.strict)
        plan = schedule(database, mapping, dbc_file=files)
        self.messages, self.per_ms, self.tick_ns = plan.messages, plan.per_ms, plan.tick_ns
        step_s = 1e-3 / self.per_ms
        never = of_database(database, marked=mapping.commands)
        for each in self.messages:
            refuse_command(never, each.encoder.can_id, setup.bus.signals, "signals")
        self.never_send_ids = tuple(never)
        command = find_message(database, COMMAND)
        self.reader = None if command is None else CommandReader(command)
        set_points = find_message(database, RIG_COMMAND)
        self.set_points = None if set_points is None else SetPointReader(set_points)
        self.control = RigControl(
            round(setup.rig.command_timeout_s * 1e9), setup.rig.motor_share, step_s
        )
        limit_nm = setup.chain.motor_torque_limit_nm
        self.override = Override(round(setup.rig.override_timeout_s * 1e9), limit_nm)
        # The encoder rounds to the DBC's steps, so the sensors need not.
        sensors: SensorSettings = replace(setup.rig.sensors, quantise=False)
        table = setup.manoeuvre.table()
        self._plant = Plant(setup.model, setup.chain, setup.rig.order, table, self.per_ms)
        drifts = drifts_ppm(setup.reported)
        self._sensors = Sensors(
            setup.model, sensors, setup.rig.seed, drifts_ppm=drifts, step_s=step_s
        )
        model_file, ticks = setup.rig.model or setup.bus.model, self._plant.rows * self.per_ms
        self._losses = Losses(model_file, setup.reported, self.messages, ticks, setup.rig.seed)
        self._truth, self._reported = np.zeros(len(TRUE_SIGNALS)), np.zeros(len(REPORTED))
        self._values = {"motor_temperature_degc": setup.rig.motor_temperature_degc}
        self.ticks = 0
        self.commands = self.bad_commands = 0

    @property
    def rows(self) -> int:
        """Milliseconds in one round of the manoeuvre."""
        return self._plant.rows

    @property
    def listens_to(self) -> tuple[int, ...]:
        """Ids of the frames that :meth:`hear` takes."""
        readers = (self.reader, self.set_points)
        return tuple(reader.can_id for reader in readers if reader is not None)

    def hear(self, frame: Frame, now_ns: int) -> None:
        """Take one received frame; anything but our two commands is not ours."""
        if frame.own or frame.error or frame.remote:
            return
        if self.set_points is not None and frame.can_id == self.set_points.can_id:
            wheel_rad = float(self._truth[_WHEEL_ANGLE])
            self.control.hear(self.set_points.read(frame), now_ns, wheel_rad)
            return
        if self.reader is None or frame.can_id != self.reader.can_id:
            return
        command = self.reader.read(frame)
        self.commands += 1
        self.bad_commands += command is None
        self.override.hear(command, now_ns)

    def step(self, now_ns: int, *, stopping: bool = False) -> list[Frame]:
        """Frames of this tick; then the plant moves on. ``stopping``: zero motor torque."""
        torque_nm = 0.0 if stopping else self.override.torque_nm(now_ns)
        self._plant.step(self._truth, torque_nm, self.control.rows(now_ns))
        self._sensors.step(self._truth, self._reported)
        self._values.update(zip(REPORTED, self._reported.tolist(), strict=True))
        applied = torque_nm if torque_nm is not None else self._values["motor_torque_nm"]
        status = self.override.status(applied)
        frames = frames_of(self.messages, self.ticks, self._values, status)
        kept = [one for one in frames if not self._losses.lost(self.ticks, one.can_id)]
        self.ticks += 1
        return kept

    @property
    def clipped(self) -> int:
        """Values that did not fit into their signal."""
        return sum(message.encoder.clipped for message in self.messages)


class Rig:
    """A rig on a bus; :meth:`run` returns when it is done or :meth:`stop` was called."""

    def __init__(self, setup: RigSetup, say: Callable[[str], None] = lambda _: None) -> None:
        self._setup, self._say = setup, say
        self._simulation = RigSimulation(setup)
        self._stop = False
        bus = setup.bus.bus
        sent = sorted(message.encoder.can_id for message in self._simulation.messages)
        self._heard = self._simulation.listens_to
        self._sent = tuple(sent)

        def opener() -> Port:
            return open_port(
                bus.interface,
                bus.channel,
                fd=bus.fd,
                receive_ids=(*self._heard, *self._sent),
                send_ids=self._sent,
                never_send_ids=self._simulation.never_send_ids,
                options=bus.options,
            )

        self._port = ReconnectingPort(opener, say, name=str(bus)) if bus.reconnect else opener()
        encoders = [message.encoder for message in self._simulation.messages]
        self._live = LiveSenders(
            self._port,
            [(each.can_id, each.extended) for each in encoders],
            lambda _: "simulate on a bus of its own",
        )

    def stop(self) -> None:
        """End after the present tick (callable from a signal handler)."""
        self._stop = True

    def run(
        self,
        *,
        duration_s: float = math.inf,
        loop: bool = False,
        loaded: Callable[[], None] = lambda: None,
    ) -> RigReport:
        """Run in real time for one manoeuvre, ``duration_s``, or (``loop``) until stopped.

        ``loaded`` is called once, when the code is compiled and before anything is sent.
        :class:`BusError` where somebody else sends one of the rig's ids.
        """
        simulation = self._simulation
        per_ms = simulation.per_ms
        limit_ms = math.inf if loop else simulation.rows
        limit_ms = min(limit_ms, duration_s * 1000)
        self._announce(limit_ms)
        notice = Notice("rig", str(self._setup.bus.bus), "simulated rig")
        notice.put(text="loads its code (the first time it is compiled, which takes minutes)")
        self._warm_up()
        notice.end()
        loaded()
        self._say(f"timing: {settle(self._setup.rig.realtime)}")
        try:
            while self._port.recv(0.0):
                pass  # of before the code was there
            self._live.listen(LISTEN_S)
            self._say("READY")
            while frames := self._port.recv(0.0):  # commands of before READY are out of date
                self._live.hear(frames)
            pacer = Pacer(simulation.tick_ns)
            while not self._stop and simulation.ticks < limit_ms * per_ms:
                due = pacer.wait()
                self._receive()
                for _ in range(due):
                    if simulation.ticks < limit_ms * per_ms:  # what is caught up ends there too
                        self._send(time.monotonic_ns(), stopping=False)
            for _ in range(_STOP_MS * per_ms):  # let listeners see the torque go
                pacer.wait()
                self._send(time.monotonic_ns(), stopping=True)
        finally:
            self._port.close()
        return self._report(pacer)

    def _receive(self) -> None:
        frames = self._port.recv(0.0)
        self._live.hear(frames)
        for frame in frames:
            self._simulation.hear(frame, time.monotonic_ns())

    def _send(self, now_ns: int, *, stopping: bool) -> None:
        for frame in self._simulation.step(now_ns, stopping=stopping):
            self._port.send(frame)

    def _warm_up(self) -> None:
        """Compile and touch everything before the first deadline, on a rig of its own."""
        twin = RigSimulation(self._setup)
        for _ in range(120):
            twin.step(0)

    def _announce(self, limit_ms: float) -> None:
        setup, messages = self._setup, self._simulation.messages
        length = "until stopped" if math.isinf(limit_ms) else f"{limit_ms / 1000:g} s"
        self._say(f"rig on {setup.bus.bus}: {setup.manoeuvre.name}, {length}")
        masses = "1 mass" if setup.rig.order == 1 else f"{setup.rig.order} masses"
        held = [str(each["effect"]) for each in (*setup.model.effects, *setup.reported)]
        added = f", effects: {', '.join(held)}" if held else ""
        self._say(f"plant: {masses}, seed {setup.rig.seed}{added}")
        for message in messages:
            can_id = f"0x{message.encoder.can_id:X}"
            self._say(f"sends {can_id} {message.name} every {1e3 * message.cycle_s:g} ms")
        self._say(f"listens to {describe_ids(self._heard)} (override, set-points)")

    def _report(self, pacer: Pacer) -> RigReport:
        simulation, counts = self._simulation, self._port.counts
        return RigReport(
            simulated_s=simulation.ticks / simulation.per_ms / 1000,
            frames_sent=counts.sent,
            send_dropped=counts.send_dropped,
            commands=simulation.commands,
            bad_commands=simulation.bad_commands,
            timeouts=simulation.override.timeouts,
            clipped=simulation.clipped,
            overruns=pacer.overruns,
            caught_up_ms=pacer.caught_up / simulation.per_ms,
            lateness=pacer.lateness,
        )
