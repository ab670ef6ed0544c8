"""Logs of cells as recordings again: joined where they follow each other."""

from pathlib import Path

import numpy as np
import pytest

from eps_hil.bus.codec import FrameEncoder
from eps_hil.bus.config import BusConfig, BusSetup
from eps_hil.bus.database import load_database
from eps_hil.bus.record import open_log
from eps_hil.programme.recordings import joined

ROOT = Path(__file__).parents[2]
DBC, SIGNALS = ROOT / "dbc" / "eps_rig.dbc", ROOT / "configs" / "eps_rig_signals.yaml"
SETUP = BusSetup(
    bus=BusConfig("virtual", "x"),
    dbc=(DBC,),
    signals=SIGNALS,
    model=ROOT / "configs" / "reference_rig.yaml",
)
START_NS = 1_700_000_000_000_000_000


@pytest.fixture
def logs(tmp_path: Path) -> list[Path]:
    """Three cells of half a second; the third a second later than the second ended."""
    database = load_database([DBC])
    state, force = (FrameEncoder(database, name) for name in ("EPS_MotorState", "RIG_State"))
    torque = FrameEncoder(database, "EPS_Torques")
    paths = []
    for number, begin_ms in enumerate((0, 500, 2000)):
        path = tmp_path / f"cell_{number}.log"
        log = open_log(path, "can0")
        for ms in range(begin_ms, begin_ms + 500):
            t_ns = START_NS + ms * 1_000_000
            log.write(
                [
                    state.frame({"MotorSpeed": ms / 100, "MotorAngle": 0.0}, t_ns),
                    torque.frame({"MotorTorque": 0.1, "TorsionBarTorque": 0.0}, t_ns),
                    force.frame({"RackForce": float(ms), "RackPosition": 0.0}, t_ns),
                ]
            )
        log.close()
        paths.append(path)
    return paths


def test_cells_without_a_gap_are_one_recording(logs: list[Path]) -> None:
    found = joined(logs, SETUP)
    assert list(found) == ["cell_0", "cell_2"]
    one = found["cell_0"]["rack_force_n"]
    assert len(one.t_ns) == pytest.approx(1000, abs=1)
    assert np.all(np.diff(one.t_ns) > 0)
    assert np.all(np.diff(one.value) == 1.0)
    assert len(found["cell_2"]["motor_speed_rad_s"].t_ns) == 500


def test_a_cell_that_was_run_again_later_costs_no_other_cell(logs: list[Path]) -> None:
    """After --resume it stands between older ones, which were all dropped as going back in time."""
    found = joined([logs[0], logs[2], logs[1]], SETUP)
    assert list(found) == ["cell_0", "cell_2", "cell_1"]
    assert [len(one["rack_force_n"].t_ns) for one in found.values()] == [500, 500, 500]


def test_one_log_is_itself(logs: list[Path]) -> None:
    assert list(joined(logs[2:], SETUP)) == ["cell_2"]
