"""2 and 4 kHz: the simulated rig, the decoder and the core, frame by frame and step by step."""

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import yaml

from eps_hil.bus.database import load_database
from eps_hil.bus.frame import Frame
from eps_hil.bus.mapping import load_mapping
from eps_hil.errors import InputError
from eps_hil.estimation.batch import lanes
from eps_hil.estimation.settings import EstimatorSettings
from eps_hil.rig.config import load_rig_setup
from eps_hil.rig.frames import schedule
from eps_hil.rig.process import RigSimulation
from eps_hil.service.config import load_config
from eps_hil.service.setup import derived_settings, describe, prepare

from .conftest import decoded

ROOT = Path(__file__).parents[2]
RATES = (1_000, 2_000, 4_000)
FAST = ("EPS_MotorState", "EPS_Torques", "RIG_State")
T0_NS = 1_790_000_000_000_000_000
SYNC_ID = 0x100


def mapping_at(rate_hz: float, folder: Path) -> Path:
    mapping = yaml.safe_load((ROOT / "configs" / "eps_rig_signals.yaml").read_text())
    for name in FAST:
        mapping["messages"][name]["cycle_time_s"] = 1 / rate_hz
    path = folder / "signals.yaml"
    path.write_text(yaml.safe_dump(mapping))
    return path


def config_at(rate_hz: float, folder: Path) -> Path:
    path = folder / "c.yaml"
    path.write_text(f"""bus: {{interface: virtual, channel: rates}}
dbc: [{ROOT}/dbc/eps_rig.dbc]
signals: {mapping_at(rate_hz, folder)}
model: {ROOT}/configs/reference_rig.yaml
service: {{realtime: off}}
rig: {{manoeuvre: weave}}
""")
    return path


@dataclass
class Drive:
    """``seconds`` of the rig, stamped with some jitter; the first instant is 0 s."""

    config: Path
    rate_hz: int
    seconds: float

    @cached_property
    def frames(self) -> list[Frame]:
        rig = RigSimulation(load_rig_setup(self.config))
        rng = np.random.default_rng(2)
        found = []
        for tick in range(round(self.seconds * self.rate_hz)):
            at = T0_NS + tick * rig.tick_ns + 20_000 + int(rng.exponential(20_000))
            for place, frame in enumerate(rig.step(at)):
                found.append(replace(frame, t_ns=at + place * 15_000))
        return found

    @cached_property
    def live(self) -> "Live":
        """The service's core over all frames, one by one."""
        parts = prepare(load_config(self.config), self.config)
        parts.core.record = []
        answers, cell = 0, list[tuple[int, float]]()
        for frame in self.frames:
            answers += len(parts.core.on_frames([frame]))
            told = parts.core.load_cell
            if told and (not cell or told[-1] != cell[-1]):
                cell.append(told[-1])
        return Live(parts, parts.core.record, answers, cell)


class Live(NamedTuple):
    parts: Any
    record: list[Any]
    answers: int
    load_cell: list[tuple[int, float]]


@pytest.fixture(
    scope="module",
    params=[*(pytest.param(hertz, marks=pytest.mark.slow) for hertz in (1_000, 2_000)), 4_000],
)
def drive(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Drive:
    folder = tmp_path_factory.mktemp("drive")
    seconds = min(6.0, 16_000 / request.param)
    return Drive(config_at(request.param, folder), request.param, seconds)


def test_every_sync_frame_is_answered_by_a_step_of_its_own(drive: Drive) -> None:
    parts = drive.live.parts
    assert parts.core.steps == drive.live.answers == drive.seconds * drive.rate_hz
    assert parts.core.repeated == 0
    assert not {name: n for name, n in parts.decoder.faults.items() if n}
    instants = [estimate.t_ns for _, estimate in drive.live.record]
    assert np.unique(np.diff(instants)).tolist() == [1_000_000_000 // drive.rate_hz]
    assert parts.core.valid_steps > 0.8 * parts.core.steps
    assert parts.sync_period_s == 1 / drive.rate_hz
    said = "\n".join(describe(parts))
    assert f"EPS_MotorState every {1e3 / drive.rate_hz:g} ms, the estimator steps on it" in said


def test_the_estimate_is_that_of_the_load_cell_at_any_rate(drive: Drive) -> None:
    t_ns, force_n = zip(*drive.live.load_cell, strict=True)
    good = [each for _, each in drive.live.record if each.valid]
    there = np.interp([each.t_ns for each in good], t_ns, force_n)
    error = np.array([each.rack_force_n for each in good]) - there
    assert np.ptp(there) > 500
    assert np.sqrt(np.mean(error**2)) < 45


def test_live_and_batch_agree_bit_for_bit(drive: Drive) -> None:
    frames = drive.frames[: 9 * drive.rate_hz]
    config = load_config(drive.config)
    live = prepare(config, drive.config)
    live.core.record = []
    for since in range(0, len(frames), 7):
        live.core.on_frames(frames[since : since + 7])
    replayed = prepare(config, drive.config)
    trace = replayed.estimator.run(lanes(decoded(replayed.decoder, frames)))
    ours = [each for _, each in live.core.record]
    assert [each.t_ns for each in ours] == trace.t_ns.tolist()
    assert [each.rack_force_n for each in ours] == trace.rack_force_n.tolist()
    # which signals the very first frames lacked goes by their order on the bus
    assert [int(each.reason) for each in ours[8:]] == trace.reason[8:].tolist()


def test_the_rig_sends_slow_messages_as_often_as_ever(drive: Drive) -> None:
    seconds, count = drive.seconds, dict[int, int]()
    for frame in drive.frames:
        count[frame.can_id] = count.get(frame.can_id, 0) + 1
    assert count[SYNC_ID] == seconds * drive.rate_hz
    assert count[0x200] == seconds * 100  # EPS_SteeringWheel, 10 ms
    assert count[0x300] == seconds * 10  # EPS_Temperature, 100 ms


def test_the_plant_is_the_same_plant_at_any_rate(tmp_path: Path) -> None:
    """The ECU samples more often, and nothing else is different."""

    def angle(rate_hz: int) -> list[float]:
        folder = tmp_path / str(rate_hz)
        folder.mkdir()
        rig = RigSimulation(load_rig_setup(config_at(rate_hz, folder)))
        found = []
        for tick in range(3 * rate_hz):
            rig.step(tick * rig.tick_ns)
            if tick % (rate_hz // 1_000) == 0:
                found.append(float(rig._truth[3]))
        return found

    slow, fast = np.array(angle(1_000)), np.array(angle(4_000))
    assert np.ptp(slow) > 1.0
    assert np.max(np.abs(fast - slow)) < 0.02 * np.ptp(slow)


@pytest.mark.parametrize(("cycle_s", "step_s"), [(1 / 3000, 1 / 3000), (5e-5, 1e-4), (0.01, 1e-3)])
def test_the_step_follows_the_sync_frame(tmp_path: Path, cycle_s: float, step_s: float) -> None:
    mapping = load_mapping(mapping_at(1 / cycle_s, tmp_path))
    assert derived_settings(EstimatorSettings(), mapping).step_s == pytest.approx(step_s)


def test_cycle_times_that_do_not_go_together_are_refused(tmp_path: Path) -> None:
    mapping = load_mapping(mapping_at(3_000, tmp_path))
    with pytest.raises(InputError, match=r"cycle_time_s.*cannot keep these cycle times"):
        schedule(load_database([ROOT / "dbc" / "eps_rig.dbc"]), mapping)
