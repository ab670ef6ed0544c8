"""A log's estimates are as little valid as those that the service's core makes of its frames."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest

import eps_hil
from eps_hil.bus.frame import Frame
from eps_hil.estimation import batch
from eps_hil.estimation.validity import Reason
from eps_hil.examples import CONFIGS
from eps_hil.recordings import log_signals
from eps_hil.rig.config import load_rig_setup
from eps_hil.rig.process import RigSimulation
from eps_hil.service.config import load_config
from eps_hil.service.setup import prepare

CONFIG = CONFIGS / "demo_udp.yaml"
MS = 1_000_000
T0_NS = 1_790_000_000_000_000_000


@pytest.fixture(scope="module")
def frames() -> list[Frame]:
    """Five seconds of the rig."""
    rig, made = RigSimulation(load_rig_setup(CONFIG, "weave")), []
    for k in range(5000):
        now = T0_NS + k * MS
        for place, frame in enumerate(rig.step(now)):
            made.append(replace(frame, t_ns=now + (place + 1) * 120_000))
    return made


Played = tuple[Path, dict[int, Reason]]


@pytest.fixture(scope="module")
def played(
    frames: list[Frame], tmp_path_factory: pytest.TempPathFactory
) -> Callable[[float], Played]:
    """The frames as a log whose stamps jump in the fourth second; what the core says of them."""

    @cache
    def at(by_ms: float) -> Played:
        asked = load_config(CONFIG)
        parts = prepare(replace(asked, service=replace(asked.service, start_wait_s=0.0)), CONFIG)
        live: dict[int, Reason] = {}
        log = tmp_path_factory.mktemp("played") / "paused.log"
        with log.open("w") as lines:
            for each in frames:
                if each.can_id not in parts.decoder.receive_ids:
                    continue
                late = round(by_ms * MS) if each.t_ns > T0_NS + 4000 * MS else 0
                frame = replace(each, t_ns=each.t_ns + late)
                parts.core.on_frames([frame])
                if parts.core.latest is not None:
                    live[parts.core.latest.t_ns] = parts.core.latest.reason
                stamp = f"({frame.t_ns // 10**9}.{frame.t_ns % 10**9 // 1000:06d})"
                lines.write(f"{stamp} can0 {frame.can_id:03X}#{frame.data.hex().upper()}\n")
        return log, live

    return at


@pytest.mark.parametrize(
    ("by_ms", "one_by_one", "stretch"),
    [
        (0.0, False, batch.STRETCH),
        (8.8, False, batch.STRETCH),
        pytest.param(30.0, False, batch.STRETCH, marks=pytest.mark.slow),
        (8.8, True, batch.STRETCH),
        (0.0, False, 700),
        (8.8, False, 4001),
        (30.0, False, 13),
    ],
)
def test_what_waited_is_told_of_a_log_too(
    played: Callable[[float], Played],
    by_ms: float,
    one_by_one: bool,
    stretch: int,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked, (log, live) = load_config(CONFIG), played(by_ms)
    if one_by_one:
        monkeypatch.setattr(log_signals, "_columns", lambda *_: None)
    read = eps_hil.load(log, dbc=asked.dbc, signals=asked.signals)
    assert asked.model is not None
    monkeypatch.setattr(batch, "STRETCH", stretch)
    trace = eps_hil.estimate(read, str(asked.model), asked.estimator).trace
    said = {t: Reason(int(bits)) for t, bits in zip(trace.t_ns.tolist(), trace.reason, strict=True)}
    same = [t for t in said if t in live]
    assert len(same) > 4900
    assert [live[t] & Reason.STALE for t in same] == [said[t] & Reason.STALE for t in same]
    stale = sum(bool(said[t] & Reason.STALE) for t in said)
    assert stale == 0 if by_ms == 0.0 else stale > 3
