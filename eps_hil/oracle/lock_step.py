"""A recorded CAN log through the service's own core, frame by frame, and what it then publishes.

No bus and no clock: the core's output depends on nothing but the frames (``service/core.py``), so
this is what a live service with that model would have sent. The published frames are decoded as
any receiver would decode them, and compared with the load cell of the same log.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from eps_hil.bus.codec import FrameDecoder
from eps_hil.bus.database import find_message
from eps_hil.bus.frame import Frame
from eps_hil.bus.mapping import SignalMapping, load_mapping
from eps_hil.bus.replay import read_log
from eps_hil.errors import InputError
from eps_hil.estimation.score import Score, score
from eps_hil.estimation.stream import Trace
from eps_hil.physics.model import load_model
from eps_hil.recordings.read import read_recording
from eps_hil.series import Series
from eps_hil.service.config import ServiceConfig
from eps_hil.service.setup import prepare


@dataclass(frozen=True, slots=True)
class Published:
    """What a service sent: its frames, and its estimates at the physical instants they speak of."""

    frames: Sequence[Frame]
    trace: Trace


def publish(log: Path, config: ServiceConfig, config_file: Path, model: Path) -> Published:
    """Replay ``log`` through a service with ``model``; the frames that it would have published.

    They are stamped with the arrival of the sync frame that each answers. What a service published
    while the log was recorded is left out: another transmitter of its ids makes no estimate valid.
    """
    parts = prepare(replace(config, model=model), config_file)
    if not parts.send_ids:
        raise InputError(config_file, "publish.enabled", "is false: nothing would be published")
    parts.estimator.warm_up()
    ours = frozenset(parts.send_ids)
    frames = [
        replace(sent, t_ns=frame.t_ns)
        for frame in read_log(log)
        if frame.can_id not in ours
        for sent in parts.core.on_frames([frame])
    ]
    return Published(frames, _decoded(frames, config, parts.database))


def _decoded(frames: Sequence[Frame], config: ServiceConfig, database: object) -> Trace:
    """The frames as a receiver reads them: value, status and age; CRC and counter are checked."""
    name = config.publish.message
    message = find_message(database, name)
    assert message is not None
    whole = load_mapping(config.signals)
    source = {k: s for k, s in whole.signals.items() if s.carrier == name}
    decoder = FrameDecoder(
        database,
        SignalMapping(
            signals=source,
            messages={k: m for k, m in whole.messages.items() if k == name},
            sync=name,
        ),
    )
    stamps, force, friction, reason = [], [], [], []
    for frame in frames:
        if not decoder.decode(frame):
            continue
        values = message.decode(frame.data, decode_choices=False)
        if values.get("EstimateStatus") not in (1, 2):  # off or invalid: no value to go by
            continue
        stamps.append(frame.t_ns - round(float(values.get("EstimateAge", 0.0)) * 1e6))
        force.append(float(values["RackForceEstimate"]))
        friction.append(float(values.get("FrictionTorque", np.nan)))
        reason.append(int(values.get("EstimateReason", 0)))
    return Trace(
        np.array(stamps, dtype=np.int64),
        np.array(force, dtype=np.float64),
        np.array(friction, dtype=np.float64),
        np.array(reason, dtype=np.int64),
    )


def load_cell(log: Path, config: ServiceConfig) -> Mapping[str, Series]:
    """The log's own signals; :class:`InputError` where the load cell is not among them."""
    recording = read_recording(log, dbc=config.dbc, signals=config.signals, gaps="mark")
    if "rack_force_n" not in recording.series:
        raise InputError(log, "rack_force_n", "is not in the log", "record or map the load cell")
    return recording.series


def compare(
    log: Path, config: ServiceConfig, config_file: Path, models: Mapping[str, Path]
) -> dict[str, Score]:
    """Error of what a service with each model would have published; the first decides moving."""
    series = load_cell(log, config)
    nominal = load_model(next(iter(models.values())))
    found = {}
    for name, path in models.items():
        trace = publish(log, config, config_file, path).trace
        one = score(trace, series, nominal)
        if one is None or not one.rows:
            raise InputError(log, "", f"no valid estimate with {path}", "take a longer log")
        found[name] = one
    return found
