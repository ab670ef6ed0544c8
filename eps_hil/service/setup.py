"""From a configuration to parts that fit together, or one line that says why they do not.

Everything that can be refused is refused here, before the bus is opened.
"""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from eps_hil.bus.codec import FrameDecoder, FrameEncoder
from eps_hil.bus.commands import Commands, of_database, refuse_command
from eps_hil.bus.database import find_message, load_database, nearest
from eps_hil.bus.mapping import SignalMapping, load_mapping
from eps_hil.bus.signal_codec import WriteSignal
from eps_hil.errors import InputError
from eps_hil.estimation.settings import EstimatorSettings, at_pace, problem
from eps_hil.estimation.stream import SIGNALS, StreamEstimator
from eps_hil.estimation.validity import Reason
from eps_hil.physics.effects.catalogue import with_model_effects
from eps_hil.physics.effects.effect import Slot
from eps_hil.physics.model import Model, load_model
from eps_hil.service.adaptation_config import AdaptationConfig
from eps_hil.service.calibrated_model import effects_in
from eps_hil.service.config import VERDICT, ServiceConfig
from eps_hil.service.core import ServiceCore, Status
from eps_hil.service.friction_levels import FrictionLevelKeeper
from eps_hil.service.health import totals_modulo
from eps_hil.service.online_methods import OnlineErrorInjection, OnlineMethod, OnlineReversals
from eps_hil.service.verdict import NEEDED, signal_verdicts

_FORCE, _COARSEST_N = "RackForceEstimate", 20.0
"""The estimate's signal, and the most that one step of it may be."""
_STATUS = "EstimateStatus"
_PUBLISHED = (_FORCE, _STATUS)
"""What a message must have at least to carry an estimate."""
_HEALTH = ("StepRate",)
_LEVELS = ("LevelPositive", "LevelNegative")
_SUGGESTED = ("SuggestedPositive", "SuggestedNegative", "SuggestionKnown")

GATING = (
    "rack_position_m",
    "steering_wheel_angle_rad",
    "steering_wheel_speed_rad_s",
    "vehicle_speed_m_s",
    "lateral_acceleration_m_s2",
    "yaw_rate_rad_s",
)
"""Signals beside the estimator's that a calibration looks at, where they are mapped."""


@dataclass(frozen=True, slots=True)
class Parts:
    """A service that is ready for a bus. Encoders are None where nothing is sent."""

    config: ServiceConfig
    database: Any
    mapping: SignalMapping
    decoder: FrameDecoder
    estimator: StreamEstimator
    core: ServiceCore
    silent: FrameEncoder | None
    """The core's own encoder, for where nothing is estimated: a receiver's end-to-end check knows
    one counter of the message."""
    health: FrameEncoder | None
    levels: FrictionLevelKeeper
    level_frames: FrameEncoder | None
    suggestion_frames: FrameEncoder | None
    sync_period_s: float
    health_modulo: Mapping[str, int]
    """Where the totals of the health message begin again."""
    verdict: FrameEncoder | None
    """Of the verdict on each signal."""
    commands: Commands
    """By id: what the service must never send, whatever the file says."""

    @property
    def send_ids(self) -> tuple[int, ...]:
        """The only ids that the port will be allowed to send."""
        encoders = (
            self.silent, self.health, self.level_frames, self.suggestion_frames, self.verdict,
        )  # fmt: skip
        return tuple(e.can_id for e in encoders if e is not None)

    def warm_up(self) -> None:
        """Compile (or load) all machine code now, so that no frame waits for it."""
        from eps_hil.bus.live_kernels import Samples

        self.estimator.warm_up()
        estimator = self.estimator
        if self.levels.method is None:
            self.core.live = self.decoder.live(estimator.places, Samples(*estimator.waiting))
        if self.silent is not None:
            self.silent.warm_up()
        signal_verdicts(self.estimator, Reason.FINE)
        if self.levels.method is not None:
            self.levels.method.warm_up()


def prepare(config: ServiceConfig, file: str | Path) -> Parts:
    """Load, connect and check; ``file`` is the configuration's path, named in errors."""
    mapping = service_mapping(load_mapping(config.signals), _wanted(config))
    database = load_database(config.dbc, strict=mapping.strict)
    dbc_file = " + ".join(path.name for path in config.dbc)
    decoder = FrameDecoder(database, mapping, mapping_file=config.signals, dbc_file=dbc_file)
    commands = commands_of(config, database, mapping)
    encoders = _encoders(config, database, commands, file, dbc_file)
    send_ids = frozenset((e.can_id, e.extended) for e in encoders if e is not None)
    for can_id, _ in sorted(send_ids):
        if can_id in decoder.receive_ids:
            raise InputError(
                config.signals, f"id 0x{can_id:X}", "is both listened to and sent",
                f"publish under another message, or set publish.enabled: false in {file}",
            )  # fmt: skip
    estimator = make_estimator(config, mapping, decoder, file)
    levels = _level_keeper(config, decoder, estimator, file)
    judged = estimator.settings.plausibility.enabled
    wait_s = config.service.start_wait_s if judged else 0.0
    core = ServiceCore(decoder, estimator, encoders[0], send_ids, levels, start_wait_s=wait_s)
    sync_period_s = _sync_period_s(mapping, decoder)
    if config.service.no_input_after_s <= sync_period_s:
        raise InputError(
            file, "service.no_input_after_s",
            f"{config.service.no_input_after_s} s is no silence: the sync frame "
            f"{mapping.sync_message} comes every {sync_period_s} s", "set several cycles",
        )  # fmt: skip
    return Parts(
        config=config,
        database=database,
        mapping=mapping,
        decoder=decoder,
        estimator=estimator,
        core=core,
        silent=encoders[0],
        health=encoders[1],
        levels=levels,
        level_frames=encoders[2],
        suggestion_frames=encoders[3],
        verdict=encoders[4],
        sync_period_s=sync_period_s,
        health_modulo=totals_modulo(find_message(database, config.publish.health_message or "")),
        commands=commands,
    )


def commands_of(config: ServiceConfig, database: Any, mapping: SignalMapping) -> Commands:
    """Messages of the configuration's database that command something, by id."""
    torque = () if config.override is None else (config.override.command_message,)
    return of_database(database, torque=torque, marked=mapping.commands)


def _wanted(config: ServiceConfig) -> tuple[str, ...]:
    """Signals to decode: the gates of error injection look at more than the estimator does."""
    gated = config.adaptation is not None and config.adaptation.method == "error_injection"
    return (*SIGNALS, *GATING) if gated else SIGNALS


def _level_keeper(
    config: ServiceConfig, decoder: FrameDecoder, estimator: StreamEstimator, file: str | Path
) -> FrictionLevelKeeper:
    adaptation = config.adaptation or AdaptationConfig()
    model = with_model_effects(load_model(config.model))
    method: OnlineMethod | None = None
    if adaptation.method != "none" and adaptation.apply != "never":
        _check_torques(model, config.model)
    try:
        if adaptation.method == "reversals":
            settings = estimator.settings
            method = OnlineReversals(adaptation, model, settings, decoder.period_s)
        elif adaptation.method == "error_injection":
            method = OnlineErrorInjection(adaptation, model, decoder.period_s)
    except ValueError as error:
        raise InputError(file, "adaptation.method", str(error), "map the signal") from None
    return FrictionLevelKeeper(estimator, adaptation, method)


def service_mapping(mapping: SignalMapping, wanted: Collection[str] = SIGNALS) -> SignalMapping:
    """The part of a mapping that is ``wanted`` (by the estimator): one file serves recorders too.

    What is left out (vehicle signals, our own estimate) costs no decoding and is not received.
    """
    signals = {name: source for name, source in mapping.signals.items() if name in wanted}
    if not signals:
        return mapping  # the estimator will say what it misses
    carriers = {source.carrier for source in signals.values()} | {mapping.sync_message}
    messages = {name: rules for name, rules in mapping.messages.items() if name in carriers}
    return replace(mapping, signals=signals, messages=messages)


def _check_torques(model: Model, file: object) -> None:
    """What learns takes the torques as reported: what an effect corrects passes for friction."""
    corrected = effects_in(model, (Slot.MOTOR, Slot.SENSOR))
    if corrected:
        raise InputError(
            file, "model.effects",
            f"{', '.join(corrected)} changes a torque, which adaptation would learn as friction",
            "set adaptation.apply: never",
        )  # fmt: skip


Encoders = tuple[FrameEncoder | None, ...]


def _encoders(
    config: ServiceConfig, database: Any, commands: Commands, file: str | Path, dbc_file: str
) -> Encoders:
    """Of estimates, health, levels, suggestions, verdict; None for what is not sent."""
    publish, adaptation = config.publish, config.adaptation
    if not publish.enabled:
        return (None,) * 5

    def encoder(name: str | None, place: str, needed: tuple[str, ...]) -> FrameEncoder | None:
        if name is None:
            return None
        message = find_message(database, name)
        if message is None:
            raise InputError(
                file, place, f"{dbc_file} has no message {name}",
                nearest(name, (each.name for each in database.messages)),
            )  # fmt: skip
        refuse_command(commands, int(message.frame_id), file, "publish")
        missing = [each for each in needed if each not in message.signal_tree]
        if missing:
            raise InputError(
                file, place, f"message {name} has no signal {', '.join(missing)}",
                "see docs/reference-bus.md for what it must carry",
            )  # fmt: skip
        if message.is_fd and not config.bus.fd:
            raise InputError(file, place, f"{name} is a CAN FD message", "set bus.fd: true")
        made = FrameEncoder(database, name, dbc_file=dbc_file)
        if _FORCE in needed:
            most_n = config.estimator.plausibility.estimate_n
            _check_force(message.get_signal_by_name(_FORCE), most_n, dbc_file, name)
            _check_status(message.get_signal_by_name(_STATUS), dbc_file, name)
        return made

    verdict = publish.verdict_message
    if verdict == VERDICT and find_message(database, verdict) is None:
        verdict = None  # a database from before it
    told = (None, None) if adaptation is None else (
        encoder(adaptation.message, "adaptation.message", _LEVELS),
        encoder(adaptation.suggestion_message, "adaptation.suggestion_message", _SUGGESTED),
    )  # fmt: skip
    return (
        encoder(publish.message, "publish.message", _PUBLISHED),
        encoder(publish.health_message, "publish.health_message", _HEALTH),
        *told,
        encoder(verdict, "publish.verdict_message", NEEDED),
    )


def _check_force(signal: Any, most_n: float, dbc_file: str, message: str) -> None:
    """A valid estimate has to arrive as it was made: in newtons, and not clipped."""
    place = f"{message}.{signal.name}"
    if (signal.unit or "N").strip() != "N":
        raise InputError(
            dbc_file, place, f"is in {signal.unit}, but newtons are published", "make its unit N"
        )
    low, high = WriteSignal(signal).reach
    if low > -most_n or high < most_n:
        raise InputError(
            dbc_file, place,
            f"carries {low:g} to {high:g} N, and up to {most_n:g} N are believed either way",
            "widen it, or set estimator.plausibility.estimate_n",
        )  # fmt: skip
    if not signal.is_float and abs(float(signal.scale)) > _COARSEST_N:
        problem = f"has steps of {abs(float(signal.scale)):g} N, expected {_COARSEST_N:g} at most"
        raise InputError(dbc_file, place, problem, "give it a finer scale")


def _check_status(signal: Any, dbc_file: str, message: str) -> None:
    """What is not valid must not arrive as what is."""
    writer = WriteSignal(signal)
    for status in Status:
        said = writer.write(status)[0] * float(signal.scale) + float(signal.offset)
        if said != status:
            raise InputError(
                dbc_file, f"{message}.{signal.name}",
                f"would say {said:g} where the status is {status:d} ({status.name.lower()})",
                f"give it whole steps from 0 to {max(Status):d}",
            )  # fmt: skip


def make_estimator(
    config: ServiceConfig, mapping: SignalMapping, decoder: FrameDecoder, file: str | Path
) -> StreamEstimator:
    """The estimator of a configuration; :class:`InputError` names what it misses."""
    model = load_model(config.model)
    for name, source in mapping.signals.items():
        if source.carrier is not None and name not in decoder.period_s:
            raise InputError(
                config.dbc[0], source.carrier, f"has no cycle time, which {name} needs",
                f"add GenMsgCycleTime, or messages.{source.carrier}.cycle_time_s to "
                f"{config.signals}",
            )  # fmt: skip
    settings = derived_settings(config.estimator, mapping)
    if settings.memory_at_start is None:
        settings = replace(settings, memory_at_start="unknown")
    if wrong := problem(settings):
        raise InputError(file, "estimator.kind", wrong)
    if settings.quantity == "friction":
        raise InputError(
            file, "estimator.quantity", "'friction' gives no rack force, which is published",
            "record, and run eps-hil estimate --friction",
        )  # fmt: skip
    try:
        return StreamEstimator(model, settings, decoder.period_s)
    except ValueError as error:
        raise InputError(config.signals, "signals", str(error), "map the signal") from None


def derived_settings(settings: EstimatorSettings, mapping: SignalMapping) -> EstimatorSettings:
    """What the mapping says goes before: a derived speed's ``window_s``, a fast sync frame's cycle.

    One rule for the service and for whoever estimates from its logs.
    """
    return at_pace(settings, mapping.pace)


def _sync_period_s(mapping: SignalMapping, decoder: FrameDecoder) -> float:
    sync = mapping.sync_message
    return min(
        (decoder.period_s[n] for n, s in mapping.signals.items() if s.carrier == sync),
        default=1e-3,
    )


def describe(parts: Parts) -> Iterator[str]:
    """What the service listens to and what it will send, line by line."""
    config, mapping = parts.config, parts.mapping
    yield f"bus        {config.bus}"
    yield f"model      {config.model}"
    for message in _messages(parts):
        names = [n for n, s in mapping.signals.items() if s.carrier == message.name]
        sync = ", the estimator steps on it" if message.name == mapping.sync_message else ""
        yield (
            f"listen     0x{message.frame_id:X} {message.name} every {_cycle(mapping, message)}"
            f"{sync}: {', '.join(names)}"
        )
    for name, source in mapping.signals.items():
        if source.derived:
            yield f"derive     {name} from {source.derive_from}"
    if blind := parts.estimator.effects_without_angle:
        yield f"invalid    at all times: {', '.join(blind)} needs motor_angle_rad, not mapped"
    if unknown_s := parts.estimator.memory_unknown_s:
        yield (
            f"friction   unknown for {unknown_s:.0f} s: the model remembers (a motor's heat, say) "
            "what was before; if nothing is, estimator.memory_at_start: none"
        )
    sends = [
        (parts.silent, config.publish.message, "with every sync frame"),
        (
            parts.verdict,
            config.publish.verdict_message or "",
            f"every {config.publish.verdict_period_s} s",
        ),
        (
            parts.health,
            config.publish.health_message or "",
            f"every {config.publish.health_period_s} s",
        ),
    ]
    adaptation = config.adaptation
    if adaptation is not None:
        when = f"every {adaptation.period_s} s"
        sends += [
            (parts.level_frames, adaptation.message or "", when),
            (parts.suggestion_frames, adaptation.suggestion_message or "", when),
        ]
    for encoder, message_name, when in sends:
        if encoder is not None:
            yield f"send       0x{encoder.can_id:X} {message_name} {when}"
    if not parts.send_ids:
        yield "send       nothing (publish.enabled: false)"
    if adaptation is not None:
        yield f"adapt      {_words(adaptation)}"
    latency_ms = parts.estimator.latency_s * 1e3
    yield f"look-back  {latency_ms:.1f} ms from the sync frame back to the instant estimated"


def _words(adaptation: AdaptationConfig) -> str:
    method = adaptation.method.replace("_", " ")
    if adaptation.method == "none":
        return "levels only on the operator's word"
    if adaptation.apply == "never":
        return f"{method}: told and recorded, not applied"
    known = {"both_known": "both levels are", "sum_known": "their sum is"}[adaptation.apply]
    return f"{method}: applied where {known} known, within {adaptation.sanity_band:.0%}"


def _cycle(mapping: SignalMapping, message: Any) -> str:
    cycle_s = mapping.rules(message.name).cycle_s(message)
    return "so often" if cycle_s is None else f"{1e3 * cycle_s:g} ms"


def _messages(parts: Parts) -> list[Any]:
    carriers = {source.carrier for source in parts.mapping.signals.values()}
    found = [message for message in parts.database.messages if message.name in carriers]
    return sorted(found, key=lambda message: int(message.frame_id))
