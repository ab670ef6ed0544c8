"""The real car's log on the live path: the service's core, and a bus with the service on it."""

import asyncio
import threading
from dataclasses import replace
from pathlib import Path

import pytest

from eps_hil.bus.config import BusConfig
from eps_hil.bus.frame import Frame
from eps_hil.bus.port import open_port
from eps_hil.bus.replay import ReplayReport, replay
from eps_hil.estimation import batch
from eps_hil.physics.model import load_model
from eps_hil.recordings.can_log import read_frames
from eps_hil.recordings.read import read_recording
from eps_hil.service.config import RuntimeConfig, load_config
from eps_hil.service.core import Status
from eps_hil.service.loop import Service
from eps_hil.service.setup import prepare

pytestmark = pytest.mark.real_data

ROOT = Path(__file__).parents[2]
CONFIG = ROOT / "configs" / "ford_gt350" / "run.yaml"


@pytest.fixture(scope="module")
def frames(ford_log: Path) -> list[Frame]:
    """Everything on the car's bus, in order."""
    return list(read_frames(ford_log))


def test_live_core_and_offline_estimate_agree(ford_log: Path, frames: list[Frame]) -> None:
    """Bit for bit, though the angle is dated by its counter and the torque by its stamp."""
    config = load_config(CONFIG)
    parts = prepare(config, CONFIG)
    live: dict[int, float] = {}
    for frame in frames:
        parts.core.on_frames([frame])
        latest = parts.core.latest
        if latest is not None and latest.valid:
            live[latest.t_ns] = latest.rack_force_n
    recording = read_recording(ford_log, dbc=config.dbc, signals=config.signals)
    offline = batch.estimate(
        recording.series,
        load_model(config.model),
        parts.estimator.settings,
        parts.decoder.period_s,
    )
    known = dict(zip(offline.t_ns.tolist(), offline.rack_force_n.tolist(), strict=True))
    # 2 687 angles, of which the first second is before the rotor has slid
    assert len(live) > 2_550
    assert live == {t: known[t] for t in live}


def test_foreign_traffic_is_no_second_transmitter(frames: list[Frame]) -> None:
    """No id of the car is one that the service sends."""
    parts = prepare(load_config(CONFIG), CONFIG)
    assert not set(parts.send_ids) & {frame.can_id for frame in frames}


@pytest.mark.slow
def test_the_service_publishes_kilonewtons_while_the_log_plays(frames: list[Frame]) -> None:
    """Four strokes at the log's own pace on a bus in this process, estimates read off the bus."""
    bus = BusConfig("virtual", "ford_gt350")
    config = load_config(CONFIG)
    # A busy machine makes holes; the waits after them have tests of their own.
    plausibility = replace(config.estimator.plausibility, unseen_s=0.0)
    config = replace(
        config,
        bus=bus,
        service=RuntimeConfig(realtime="off", start_wait_s=0.0),
        estimator=replace(config.estimator, plausibility=plausibility),
    )
    parts = prepare(config, CONFIG)
    parts.estimator.warm_up()
    begin_ns = frames[0].t_ns + 2_500_000_000
    part = [f for f in frames if begin_ns <= f.t_ns < begin_ns + 3_500_000_000]
    player = open_port(bus.interface, bus.channel)
    listener = open_port(bus.interface, bus.channel)
    ready = threading.Event()
    reports: list[ReplayReport] = []

    def play() -> None:
        ready.wait(10.0)
        reports.append(replay(part, player))

    thread = threading.Thread(target=play)
    thread.start()
    try:
        service = Service(parts, lambda line: ready.set() if line == "READY" else None)
        asyncio.run(service.run(duration_s=4.5))
        thread.join(10.0)
        heard = []
        while batch_of_frames := listener.recv(0.1):
            heard += batch_of_frames
    finally:
        player.close()
        listener.close()
    assert [report.sent for report in reports] == [len(part)]
    message = parts.database.get_message_by_name("EPSHIL_Estimate")
    published = [
        message.decode(frame.data, decode_choices=False)
        for frame in heard
        if frame.can_id == message.frame_id
    ]
    valid = [v["RackForceEstimate"] for v in published if v["EstimateStatus"] == Status.VALID]
    assert len(valid) > 250
    assert 2_000 < max(valid) < 10_000
    assert -10_000 < min(valid) < -2_000
