"""Which bus a verb works on: from ``--config``, or from ``--interface`` and ``--channel``."""

import signal
from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from typing import Any

from eps_hil.bus.commands import OWN
from eps_hil.bus.config import BusConfig
from eps_hil.bus.port import Port, open_port
from eps_hil.errors import InputError

DEFAULT_CHANNELS = {"socketcan": "vcan0", "udp_multicast": "239.74.163.2"}


def choose_bus(
    config: Path | None,
    interface: str | None,
    channel: str | None,
    option: Sequence[str],
    fd: bool,
) -> BusConfig:
    """Which bus is meant; what the command line says beats the file."""
    options: dict[str, Any] = {}
    reconnect = True
    if config is not None:
        from eps_hil import yaml_file

        bus = yaml_file.load(config, BusConfig, section="bus")
        if interface in {None, bus.interface}:
            interface, channel = bus.interface, channel or bus.channel
            options, fd, reconnect = dict(bus.options), fd or bus.fd, bus.reconnect
    if interface is None:
        raise InputError(
            "--interface", "", "is missing", "name one (socketcan, udp_multicast, ...) or --config"
        )
    channel = channel or DEFAULT_CHANNELS.get(interface)
    if channel is None:
        raise InputError("--channel", "", "is missing", f"{interface} needs one")
    options |= parse_options(option)
    fd = fd or interface == "udp_multicast"
    return BusConfig(interface, channel, fd, options, reconnect)


def open_bus(
    bus: BusConfig,
    *,
    receive_ids: Sequence[int] | None = None,
    send_ids: Sequence[int] | None = None,
    never_send_ids: Collection[int] = tuple(OWN),
) -> Port:
    """The opened port; :class:`~eps_hil.errors.BusError` if it cannot be."""
    return open_port(
        bus.interface,
        bus.channel,
        fd=bus.fd,
        receive_ids=receive_ids,
        send_ids=send_ids,
        never_send_ids=never_send_ids,
        options=bus.options,
    )


def parse_options(words: Sequence[str]) -> dict[str, Any]:
    """``port=43113`` and the like -> keyword arguments of the interface."""
    import yaml

    from eps_hil import yaml_file

    options: dict[str, Any] = {}
    for word in words:
        key, equals, value = word.partition("=")
        if not equals or not key.isidentifier():
            raise InputError("--option", word, "is not an option", "write KEY=VALUE")
        try:
            options[key] = yaml_file.parse(value)
        except yaml.YAMLError:
            options[key] = value
    return options


def ending_signals() -> tuple[signal.Signals, ...]:
    """What ends a verb: SIGINT, SIGTERM, and the SIGHUP of a lost terminal or ssh connection.

    Not SIGHUP for a program that was started to outlive its terminal (nohup).
    """
    ending = signal.SIGINT, signal.SIGTERM
    outlives = signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    return ending if outlives else (*ending, signal.SIGHUP)


def stop_on_signals() -> Callable[[], bool]:
    """A question that each of :func:`ending_signals` answers with yes; a second one of the same
    kind ends the program, but for SIGHUP: where a terminal goes, shell and kernel send one each."""
    asked: list[int] = []

    def ask(number: int, frame: object) -> None:
        asked.append(number)
        if number != signal.SIGHUP:
            signal.signal(number, signal.SIG_DFL)

    for number in ending_signals():
        signal.signal(number, ask)
    return lambda: bool(asked)


def end_on_signals() -> None:
    """Each of :func:`ending_signals` ends the program at once, also amid the compiler."""
    for number in ending_signals():
        signal.signal(number, signal.SIG_DFL)
