"""From a configuration to the parts of an override session, or one line that says why not."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from eps_hil.bus import e2e
from eps_hil.bus.codec import FrameDecoder, FrameEncoder, crc_rule, rules_of
from eps_hil.bus.commands import Commands, refuse_command
from eps_hil.bus.database import find_message, load_database, nearest
from eps_hil.bus.frame import Frame
from eps_hil.bus.mapping import MessageRules, SignalMapping, load_mapping
from eps_hil.bus.message_decoder import MessageDecoder
from eps_hil.bus.protection import CounterCheck
from eps_hil.bus.signal_codec import ReadSignal
from eps_hil.errors import InputError
from eps_hil.estimation.stream import SIGNALS, StreamEstimator
from eps_hil.physics.model import Model, load_model
from eps_hil.service.command_check import check_command
from eps_hil.service.config import OverrideConfig, ServiceConfig
from eps_hil.service.guard import Command
from eps_hil.service.input_check import check_inputs
from eps_hil.service.setup import GATING, commands_of, make_estimator, service_mapping

_NEEDED = ("motor_torque_nm", "torque_sensor_nm", "motor_speed_rad_s")


class CommandEncoder:
    """Commands to frames of the command message, with the DBC's or an E2E profile's protection."""

    def __init__(self, database: Any, config: OverrideConfig, dbc_file: str) -> None:
        self._config = config
        self._frames = FrameEncoder(database, config.command_message, dbc_file=dbc_file)
        self.can_id, self.extended = self._frames.can_id, self._frames.extended
        length = int(find_message(database, config.command_message).length)  # type: ignore[union-attr]
        self._e2e = None if config.e2e is None else e2e.E2eProtector(config.e2e, length)

    def frame(self, command: Command) -> Frame:
        """The next frame; the counter goes up by one."""
        config = self._config
        frame = self._frames.frame(
            {
                config.torque_signal: command.torque_nm / config.torque_scale,
                config.request_signal: config.enable_value
                if command.enable
                else config.release_value,
            }
        )
        if self._e2e is None:
            return frame
        data = self._e2e.protect(frame.data)
        return Frame(0, frame.can_id, data, extended=frame.extended, fd=frame.fd)


class StatusReader:
    """The ECU's own word on the override: the value of one signal, CRC and counter checked."""

    def __init__(
        self, message: Any, signal: Any, dbc_file: str, rules: MessageRules | None = None
    ) -> None:
        rules = rules or rules_of(message)
        self.can_id, self.extended = int(message.frame_id), bool(message.is_extended_frame)
        faults = dict.fromkeys(
            ("crc", "counter", "length", "lost_frames", "not_decodable", "not_available",
             "out_of_range", "clock_restarts", "second_sender", "not_trusted"), 0,
        )  # fmt: skip
        self._decoder = MessageDecoder(message, [ReadSignal(signal, "state", 1.0, 0.0)], faults)
        for each in message.signals:
            if each.name == rules.crc:
                self._decoder.crc = crc_rule(message, each, rules, dbc_file, message.name)
            elif each.name == rules.counter:
                self._decoder.counter = each.name
                self._decoder.check = CounterCheck(rules.counter_values(each))

    def read(self, frame: Frame) -> float | None:
        """The value (NaN: damaged); None where the frame is another's or a repeated one."""
        if (frame.can_id, frame.extended) != (self.can_id, self.extended):
            return None
        samples = self._decoder.decode(frame)
        return samples[0].value if samples else None


@dataclass(frozen=True, slots=True)
class OverrideParts:
    """What a session on a bus needs; ``position_per_rad``: 0 where the rack position is measured,
    else rack metres per radian of the rotor."""

    config: ServiceConfig
    override: OverrideConfig
    model: Model
    mapping: SignalMapping
    decoder: FrameDecoder
    estimator: StreamEstimator
    command: CommandEncoder
    state: FrameEncoder | None
    status: StatusReader | None
    position_per_rad: float
    never_send_ids: tuple[int, ...]
    """Every command but the one that the guard judges."""

    @property
    def send_ids(self) -> tuple[int, ...]:
        """The only ids that the port will be allowed to send."""
        return tuple(e.can_id for e in (self.command, self.state) if e is not None)

    @property
    def receive_ids(self) -> tuple[int, ...]:
        """Inputs, the ECU's status, and our own ids, to notice another sender."""
        status = () if self.status is None else (self.status.can_id,)
        return tuple(sorted({*self.decoder.receive_ids, *status, *self.send_ids}))


def prepare_override(config: ServiceConfig, file: str | Path) -> OverrideParts:
    """Load, connect and check; ``file`` is the configuration's path, named in errors."""
    if config.override is None:
        raise InputError(
            file, "override", "block is missing, so no torque may ever be commanded",
            "state all limits there: docs/safety.md",
        )  # fmt: skip
    if config.override.e2e is not None:
        e2e.check(file)
    if config.bus.options.get("hardware_stamps"):
        raise InputError(
            file, "bus.options.hardware_stamps", "another clock cannot tell how old an input is",
            "leave it out for the torque override",
        )  # fmt: skip
    whole = load_mapping(config.signals)
    mapping = service_mapping(whole, (*SIGNALS, *GATING))
    database = load_database(config.dbc, strict=mapping.strict)
    dbc_file = " + ".join(path.name for path in config.dbc)
    decoder = FrameDecoder(database, mapping, mapping_file=config.signals, dbc_file=dbc_file)
    commands = commands_of(config, database, mapping)
    _check_messages(config, database, commands, file, dbc_file)
    override = config.override
    command = CommandEncoder(database, override, dbc_file)
    state = override.state_message and FrameEncoder(
        database, override.state_message, dbc_file=dbc_file
    )
    others = {can_id: one for can_id, one in commands.items() if can_id != command.can_id}
    model = load_model(config.model)
    check_inputs(mapping, database, model, config.signals)
    check_command(
        override,
        find_message(database, override.command_message),
        CommandEncoder(database, override, dbc_file).frame,
        model.sensor_to_rotor,
        file,
        dbc_file,
    )
    position = _position(mapping, model, config)
    _check_ages(mapping, decoder, override, file, position > 0)
    return OverrideParts(
        config=config,
        override=override,
        model=model,
        mapping=mapping,
        decoder=decoder,
        estimator=make_estimator(config, mapping, decoder, file),
        command=command,
        state=state or None,
        status=_status(database, override, whole, file, dbc_file),
        position_per_rad=position,
        never_send_ids=tuple(others),
    )


def _check_messages(
    config: ServiceConfig, database: Any, commands: Commands, file: object, dbc_file: str
) -> None:
    override = config.override
    assert override is not None
    wanted = {
        "command_message": (override.torque_signal, override.request_signal),
        "state_message": ("State",),
        "status_message": (override.status_signal,),
    }
    for field, signals in wanted.items():
        name = getattr(override, field)
        if name is None:
            continue
        message = find_message(database, name)
        if message is None:
            raise InputError(
                file, f"override.{field}", f"{dbc_file} has no message {name}",
                nearest(name, (each.name for each in database.messages)),
            )  # fmt: skip
        if field == "state_message":
            refuse_command(commands, int(message.frame_id), file, f"override.{field}")
        missing = [each for each in signals if each not in message.signal_tree]
        if missing:
            raise InputError(
                file, f"override.{field}", f"{name} has no signal {', '.join(missing)}",
                nearest(missing[0], message.signal_tree),
            )  # fmt: skip
        if message.is_fd and not config.bus.fd:
            raise InputError(file, f"override.{field}", "is a CAN FD message", "set bus.fd: true")


def _position(mapping: SignalMapping, model: Model, config: ServiceConfig) -> float:
    for name in _NEEDED:
        if name not in mapping.signals or mapping.signals[name].derived:
            raise InputError(
                config.signals, f"signals.{name}", "is not mapped, and the torque guard needs it",
                "map it",
            )  # fmt: skip
    if mapping.signals["motor_torque_nm"].supply_power is not None:
        raise InputError(
            config.signals, "signals.motor_torque_nm",
            "is calculated from supply_power, and the torque guard needs the torque that the ECU "
            "reports", "map a reported torque or current",
        )  # fmt: skip
    if "rack_position_m" in mapping.signals:
        return 0.0
    if "motor_angle_rad" in mapping.signals:
        return 1.0 / model.rack_to_rotor_ratio_rad_per_m
    raise InputError(
        config.signals, "signals.rack_position_m",
        "is not mapped, nor motor_angle_rad in its place; the torque guard needs one of them",
        "map one",
    )  # fmt: skip


def _check_ages(
    mapping: SignalMapping,
    decoder: FrameDecoder,
    override: OverrideConfig,
    file: object,
    by_angle: bool,
) -> None:
    """An input that comes less often than it may be old would trip at once."""
    allowed_s = override.limits.max_input_age_s
    for name in (*_NEEDED, "motor_angle_rad" if by_angle else "rack_position_m"):
        period_s = decoder.period_s.get(name, 0.0)
        if allowed_s <= period_s:
            raise InputError(
                file, "override.limits.max_input_age_s",
                f"{allowed_s:g} s is not longer than the cycle of {name} ({period_s:g} s)",
                "allow several cycles",
            )  # fmt: skip


def _status(
    database: Any,
    override: OverrideConfig,
    mapping: SignalMapping,
    file: object,
    dbc_file: str,
) -> StatusReader | None:
    if override.status_message is None:
        return None
    message = find_message(database, override.status_message)
    assert message is not None
    signal = message.get_signal_by_name(override.status_signal)
    period_s = (message.cycle_time or 0) / 1e3
    if override.limits.ecu_status_timeout_s <= period_s:
        raise InputError(
            file, "override.limits.ecu_status_timeout_s",
            f"is not longer than the cycle of {message.name} ({period_s:g} s)",
            "allow several cycles",
        )  # fmt: skip
    return StatusReader(message, signal, dbc_file, mapping.messages.get(message.name))
