"""Limits and a bus for machines that keep no time: what a loaded or emulated one can do.

The limits themselves are tested in test_guard.py, where the test is the clock.
"""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PATIENT: dict[str, float | None] = {
    "max_frame_gap_s": 0.05,
    "max_input_age_s": 0.1,
    "torque_response_s": 0.05,
    "max_torque_error_nm": 0.3,
    "ecu_status_timeout_s": 0.2,
    "heartbeat_timeout_s": 1.0,
    "motor_torque_frozen_s": None,
    "torque_sensor_frozen_s": None,
    "motor_speed_frozen_s": None,
    "rack_position_frozen_s": None,
}


def slow_dbc(folder: Path) -> Path:
    """The rig's DBC with its 1 ms messages every 5 ms, written into ``folder``."""
    dbc = (ROOT / "dbc" / "eps_rig.dbc").read_text()
    for can_id in (0x100, 0x101, 0x110):
        fast = f'"GenMsgCycleTime" BO_ {can_id} 1;'
        assert fast in dbc
        dbc = dbc.replace(fast, f'"GenMsgCycleTime" BO_ {can_id} 5;')
    file = folder / "slow.dbc"
    file.write_text(dbc)
    return file
