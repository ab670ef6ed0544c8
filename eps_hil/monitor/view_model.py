"""Frames in, figures out: what the monitor knows, without I/O and without a clock."""

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from eps_hil.bus.codec import FrameDecoder
from eps_hil.bus.database import load_database
from eps_hil.bus.frame import Frame
from eps_hil.bus.load import frame_bits
from eps_hil.bus.mapping import SignalMapping, load_mapping
from eps_hil.bus.port import BusState, PortCounts
from eps_hil.estimation.stream import SIGNALS
from eps_hil.estimation.validity import Reason, words
from eps_hil.monitor.alarm import Alarms, Limits
from eps_hil.monitor.figures import BusFigures, EstimateFigures, Figures, SignalFigures
from eps_hil.monitor.meters import RateMeter, SignalTrack
from eps_hil.monitor.residual import Residual, Window, warm_up
from eps_hil.monitor.told import Told, told_of
from eps_hil.physics.model import Model, load_model
from eps_hil.service.adaptation_config import AdaptationConfig
from eps_hil.service.config import ServiceConfig
from eps_hil.service.core import Status
from eps_hil.service.verdict import NEEDED
from eps_hil.signals import CANONICAL

_SILENT_S = 0.25
_NO_COUNTS = PortCounts()
_NOT_YET = Residual(why_not="the residual's code is being loaded; the first time, compiled")
_OURS = "EPSHIL_"
_ECU_STATUS, _OVERRIDE = "EPS_OverrideStatus", "EPSHIL_OverrideState"


class Ear(Protocol):
    """Hears every sample and estimate that a :class:`Monitor` takes, in their order."""

    def sample(self, name: str, t_ns: int, value: float) -> None:
        """One sample of a mapped signal; NaN is one that the frame's checks refused."""

    def estimate(self, t_ns: int, age_ns: int | None, force_n: float, friction_nm: float) -> None:
        """A published estimate by its frame's stamp; NaN where it is not valid."""


class Monitor:
    """Everything that is kept. ``bitrate``: of the bus, bit/s, where it is known.

    The stamps of the frames are the only time it knows; :meth:`figures` is asked for an instant of
    the same clock.
    """

    def __init__(
        self,
        config: ServiceConfig,
        limits: Limits,
        *,
        window_s: float = 4.0,
        bitrate: float | None = None,
        ear: Ear | None = None,
    ) -> None:
        mapping = load_mapping(config.signals)
        database = load_database(config.dbc, strict=mapping.strict)
        self.model: Model = load_model(config.model)
        self._name = str(config.bus)
        self._estimate = told_of(database, config.publish.message)
        self._others = _others(database, config)
        self._decoder = FrameDecoder(
            database, _without(mapping, config.publish.message),
            mapping_file=config.signals, dbc_file=" + ".join(path.name for path in config.dbc),
        )  # fmt: skip
        verdict = config.publish.verdict_message
        self._verdict = next((told for told in self._others if told.name == verdict), None)
        self._by_key = {told.key: told for told in self._others}
        self._signals = {
            name: SignalTrack(self._decoder.period_s.get(name))
            for name, source in mapping.signals.items()
            if source.carrier not in {None, config.publish.message}
        }
        self._window, self._alarms = Window(self.model, window_s), Alarms(limits)
        self._frames, self._bits, self._bitrate = RateMeter(), RateMeter(), bitrate
        self._ear = ear
        self.changes: list[tuple[str, bool]] = []
        """Alarms that the last :meth:`figures` saw go on or off."""

    def warm_up(self) -> None:
        """Load or compile the code of the residual now, so that no view waits for it."""
        warm_up(self.model)

    def take(self, frames: Iterable[Frame]) -> None:
        """Frames in the order in which they came."""
        for frame in frames:
            if frame.error:
                continue
            self._frames.add(frame.t_ns)
            self._bits.add(frame.t_ns, frame_bits(frame))
            if frame.remote:
                continue
            key = (frame.can_id, frame.extended)
            if self._estimate is not None and key == self._estimate.key:
                self._take_estimate(self._estimate, frame)
            elif key in self._by_key:
                self._by_key[key].take(frame)
            for name, t_ns, value in self._decoder.decode(frame):
                track = self._signals.get(name)
                if track is not None:
                    track.take(t_ns, value)
                self._window.take(name, t_ns, value)
                if self._ear is not None:
                    self._ear.sample(name, t_ns, value)

    def _take_estimate(self, told: Told, frame: Frame) -> None:
        if not told.take(frame):
            return
        values = told.numbers()
        age_ms = values.get("EstimateAge", math.nan)
        force = values.get("RackForceEstimate", math.nan)
        valid = values.get("EstimateStatus") == Status.VALID and math.isfinite(age_ms + force)
        friction = values.get("FrictionTorque", math.nan)
        if self._ear is not None:
            age_ns = round(age_ms * 1e6) if math.isfinite(age_ms) else None
            heard = (force, friction) if valid else (math.nan, math.nan)
            self._ear.estimate(frame.t_ns, age_ns, *heard)
        if not valid:
            return
        self._window.estimate(
            frame.t_ns - round(age_ms * 1e6), force, friction,
            int(values.get("EstimateReason", 0)),
        )  # fmt: skip

    @property
    def balance(self) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float64]] | None:
        """Torque balance of the last figures' window (instants, N at the rack), if any."""
        return self._window.balance

    def figures(
        self,
        now_ns: int,
        counts: PortCounts = _NO_COUNTS,
        state: BusState = BusState.UNKNOWN,
        *,
        loading: bool = False,
    ) -> Figures:
        """What there is to show at ``now_ns``; alarms are judged here.

        ``loading``: without the residual, for :meth:`warm_up` is not done.
        """
        residual = _NOT_YET if loading else self._window.residual(now_ns)
        self.changes = self._alarms.update(now_ns, residual.by_name())
        return Figures(
            now_ns,
            self._bus(now_ns, counts, state),
            tuple(self._signal(name, track, now_ns) for name, track in self._signals.items()),
            self._estimate_figures(now_ns),
            residual,
            self._alarms.limits,
            self._alarms.on,
            self._alarms.pending,
            {
                told.name: {"age_s": told.age_s(now_ns), **told.values()}
                for told in self._others
                if told.t_ns is not None
            },
        )

    def _bus(self, now_ns: int, counts: PortCounts, state: BusState) -> BusFigures:
        bits = self._bits.per_s(now_ns)
        faults = self._decoder.faults
        told = [each for each in (self._estimate, *self._others) if each is not None]
        return BusFigures(
            self._name, str(state), self._frames.per_s(now_ns), bits / 1e3,
            bits / self._bitrate if self._bitrate else None,
            faults["lost_frames"], counts.lost_in_kernel,
            faults["crc"] + faults["length"] + sum(each.bad for each in told),
            counts.error_frames,
        )  # fmt: skip

    def _signal(self, name: str, track: SignalTrack, now_ns: int) -> SignalFigures:
        return SignalFigures(
            name, CANONICAL[name].unit, track.value, track.age_s(now_ns),
            track.rate_hz(now_ns), track.verdict(now_ns), track.bad,
            self._service_says(name, now_ns),
        )  # fmt: skip

    @property
    def has_load_cell(self) -> bool:
        """Whether there is anything to hold rig and model against."""
        return "rack_force_n" in self._signals

    def _service_says(self, name: str, now_ns: int) -> str:
        """Of a signal that the estimator reads, in the words of the DBC's labels."""
        told = self._verdict
        if told is None or name not in SIGNALS or told.age_s(now_ns) > _SILENT_S:
            return ""
        return str(told.values().get(NEEDED[SIGNALS.index(name)], "")).replace("_", " ")

    def _estimate_figures(self, now_ns: int) -> EstimateFigures:
        cell = self._signals.get("rack_force_n")
        cell_n = math.nan if cell is None else cell.value
        told, nan = self._estimate, math.nan
        if told is None:
            return EstimateFigures("not in the DBC", "", nan, nan, nan, 0.0, cell_n)
        if told.age_s(now_ns) > _SILENT_S:
            never = "no frame yet" if told.t_ns is None else "the service has stopped sending"
            return EstimateFigures("silent", never, nan, nan, nan, 0.0, cell_n)
        values = told.numbers()
        status = Status(int(values.get("EstimateStatus", 0)))
        return EstimateFigures(
            status.name.lower(), words(Reason(int(values.get("EstimateReason", 0)))),
            values.get("RackForceEstimate", nan), values.get("FrictionTorque", nan),
            values.get("EstimateAge", nan), told.rate_hz(now_ns), cell_n,
        )  # fmt: skip


def _others(database: Any, config: ServiceConfig) -> tuple[Told, ...]:
    """Health, override (the service's state and the ECU's), friction levels, suggestions.

    And whatever else of the project's own name (``EPSHIL_...``) the database holds.
    """
    adaptation = config.adaptation or AdaptationConfig()
    override = config.override
    names = (
        config.publish.verdict_message,
        config.publish.health_message,
        _OVERRIDE if override is None else override.state_message,
        _ECU_STATUS if override is None else override.status_message,
        adaptation.message,
        adaptation.suggestion_message,
        *sorted(m.name for m in database.messages if m.name.startswith(_OURS)),
    )
    found = (told_of(database, name) for name in dict.fromkeys(names))
    return tuple(told for told in found if told is not None and told.name != config.publish.message)


def _without(mapping: SignalMapping, message: str) -> SignalMapping:
    """The mapping less the service's own estimate, which is read as a whole message."""
    signals = {n: s for n, s in mapping.signals.items() if s.carrier != message}
    rules = {name: each for name, each in mapping.messages.items() if name != message}
    return replace(mapping, signals=signals, messages=rules)
