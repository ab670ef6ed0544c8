"""What an empirical effect is called and how its law is written."""

from typing import Any

import pytest

from eps_hil.diagnosis.remainder.words import formula, resembles, sentence

ONE = {"effect": "empirical", "form": "law", "how": "sum", "memory": ["none"]}


def law(**values: Any) -> dict[str, Any]:
    return {**ONE, **values}


FOLD_BACK = law(
    form="dynamic", where="motor", how="factor", inputs=["motor_torque_nm"], memory=["heat"],
    shapes=["linear"], size=-0.31, memory_1=21.0,
)  # fmt: skip
DEAD_TIME = law(
    where="motor", inputs=["motor_torque_nm"], shapes=["saturating"], size=-0.02, width_1=0.05
)

LOST_WHERE_LOAD_DRIVES = law(
    where="rotor", inputs=["rack_force_n", "load_power_sign"], memory=["none", "none"],
    shapes=["linear", "above"], size=-5.3e-05, centre_2=0.0,
)  # fmt: skip


def test_a_law_is_written_out() -> None:
    assert formula(FOLD_BACK) == "T_em · (1 − 0.31 · h), 21 s · dh/dt = T_em² − h"
    assert formula(DEAD_TIME) == "T_em − 0.02 · tanh(T_em/0.05)"
    assert formula(LOST_WHERE_LOAD_DRIVES) == "T_f − 5.3e-05 · F · [F·ω < 0]"
    braking = {**LOST_WHERE_LOAD_DRIVES, "shapes": ["linear", "below"]}
    assert formula(braking) == "T_f − 5.3e-05 · F · [F·ω > 0]"


def test_what_is_less_than_nothing_is_taken_off() -> None:
    tanh = law(where="friction", how="factor", inputs=["abs_motor_speed_rad_s"],
               shapes=["gaussian"], size=-5.3, centre_1=-40.6, width_1=31.3)  # fmt: skip
    assert formula(tanh) == "T_fs · (1 − 5.3 · exp(−((|ω| + 40.6)/31.3)²))"
    wave = law(where="motor", inputs=["motor_angle_rad"], shapes=["sine"], size=0.0144,
               order_1=24.0, phase_1=-0.713)  # fmt: skip
    assert formula(wave) == "T_em + 0.0144 · sin(24·φ − 0.713)"


def test_a_map_has_no_law() -> None:
    table = law(where="rotor", form="map", inputs=["rack_position_m", "motor_speed_rad_s"],
                values=[[0.0]])  # fmt: skip
    assert formula(table) is None
    assert "by a map" in sentence(table)


def test_a_map_over_two_signals_is_like_nothing() -> None:
    """It may be any law of the two: iron losses came out as an inverter's dead time."""
    table = law(where="rotor", form="map", inputs=["motor_torque_nm", "abs_motor_speed_rad_s"],
                values=[[0.0]])  # fmt: skip
    assert resembles(table) == []


@pytest.mark.parametrize(
    ("entry", "what"),
    [
        (FOLD_BACK, "current fold-back"),
        (DEAD_TIME, "inverter dead time"),
        (law(where="motor", how="factor", inputs=["abs_motor_speed_rad_s"], shapes=["above"],
             size=-1e-3, centre_1=30.0), "field weakening"),
        (law(where="friction", inputs=["abs_torque_sensor_nm"], shapes=["linear"], size=0.02),
         "rack-guide friction"),
        (law(where="rotor", inputs=["motor_angle_rad"], memory=["hysteresis"], shapes=["linear"],
             size=0.03, memory_1=5.0), "hysteretic bushing (Bouc–Wen)"),
        (law(where="friction", inputs=["abs_motor_speed_rad_s"], memory=["lag"],
             shapes=["linear"], size=1e-3, memory_1=0.6), "velocity-memory friction"),
        (law(where="friction", how="factor", inputs=["abs_motor_speed_rad_s"], memory=["lag"],
             shapes=["saturating"], size=-0.4, width_1=20.0, memory_1=12.0), "grease that warms"),
        (law(where="motor", how="factor", inputs=["abs_motor_power_w"], shapes=["saturating"],
             size=-0.1, width_1=20.0), "iron losses of the motor"),
        (law(where="rotor", inputs=["rack_position_m", "motor_angle_rad"],
             memory=["none", "none"], shapes=["gaussian", "sine"], size=0.02, centre_1=0.0,
             width_1=0.004, order_2=5.0, phase_2=0.0), "damage in one place"),
        (LOST_WHERE_LOAD_DRIVES, "mesh efficiency, driving against driven"),
        (law(where="friction", inputs=["abs_rack_force_n", "load_power_sign"],
             memory=["none", "none"], shapes=["linear", "above"], size=5e-5, centre_2=0.0),
         "mesh efficiency, driving against driven"),
        (law(where="rotor", inputs=["motor_torque_nm"], shapes=["linear"], size=0.03),
         "motor that gives another share of what it reports"),
        (law(where="rotor", inputs=["torque_sensor_nm"], shapes=["linear"], size=0.03),
         "torsion bar that reads too much or too little"),
        (law(where="rotor", inputs=["rack_position_m"], shapes=["linear"], size=1.9), "spring"),
        (law(where="rotor", inputs=["motor_speed_rad_s"], shapes=["linear"], size=1e-4),
         "drag in proportion to speed"),
    ],
)  # fmt: skip
def test_known_families_get_their_name(entry: dict[str, Any], what: str) -> None:
    assert resembles(entry)[0]["what"] == what


@pytest.mark.parametrize(
    "other",
    [{"shapes": ["saturating"]}, {"memory": ["lag"]}, {"where": "friction"}, {"how": "factor"}],
)
def test_only_what_is_in_proportion_is_a_spring(other: dict[str, Any]) -> None:
    given = {"where": "rotor", "inputs": ["rack_position_m"], "shapes": ["linear"], "size": 1.9}
    assert "spring" not in {one["what"] for one in resembles(law(**{**given, **other}))}


def test_what_is_like_nothing_gets_no_name() -> None:
    assert resembles(law(where="load", how="factor", inputs=["time_s"], shapes=["linear"],
                         size=0.1)) == []  # fmt: skip
