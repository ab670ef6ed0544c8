"""A menu of rig tests for the next experiment: the manoeuvre files, and variants of them.

Each is simulated on the rig without a bus, so that a diagnosis can see what the test would tell
before anybody runs it, and can be written as a manoeuvre file that the rig runs.
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from eps_hil import yaml_file
from eps_hil.physics.model import Model
from eps_hil.rig.assumed_chain import assumed_chain
from eps_hil.rig.manoeuvre import FOLDER, Manoeuvre
from eps_hil.rig.offline import simulate_recording
from eps_hil.series import Series

FILES = ("sine_sweep", "weave", "dwell", "constant_speed_preload", "steps")
_ROBOT = {"stiffness_nm_per_rad": 400.0, "damping_nm_s_per_rad": 12.0}
_HOLDS_S = (0.1, 0.3, 1.0, 3.0, 10.0)


def _slow_reversals() -> dict[str, Any]:
    turns = [
        {"duration_s": 4.0 / hz, "driver": {
            **_ROBOT, "angle_rad": {"sine": {"amplitude": 1.0, "frequency_hz": hz, "fade_s": 0.5}}}}
        for hz in (0.1, 0.2, 0.4)
    ]  # fmt: skip
    return {"description": "slow reversals at three speeds, no load", "segments": turns}


def _hold_series() -> dict[str, Any]:
    """Rests of growing length, each ended by the same slow turn out and back."""
    turn = {
        "points": [
            [0.0, 0.0],
            [0.3, 1.5],
            [1.0, 1.5],
            [1.3, 0.0],
            [1.6, -1.5],
            [2.3, -1.5],
            [2.6, 0.0],
        ]
    }
    segments = []
    for hold in _HOLDS_S:
        segments.append({"duration_s": hold, "driver": dict(_ROBOT)})
        segments.append({"duration_s": 2.6, "driver": {**_ROBOT, "speed_rad_s": turn}})
    return {"description": "holds of 0.1 s to 10 s before each break-away", "segments": segments}


def _speeds(preloads: list[float]) -> dict[str, Any]:
    grid = {
        "wheel_speeds_rad_s": [0.1, 0.3, 1.0, 3.0], "preloads_n": preloads, "travel_rad": 1.0,
        "change_s": 1.0, "turn_s": 0.2,
    }  # fmt: skip
    motor = {"preload_compensation": 1.0}
    segment = {"constant_speed_grid": grid, "driver": dict(_ROBOT), "motor": motor}
    return {"description": "constant speeds both ways", "segments": [segment]}


def _long_travel() -> dict[str, Any]:
    driver = {
        **_ROBOT,
        "angle_rad": {"sine": {"amplitude": 6.0, "frequency_hz": 0.1, "fade_s": 1.0}},
    }
    return {
        "description": "the whole travel, slowly, twice each way",
        "segments": [{"duration_s": 20.0, "driver": driver}],
    }


def _fast_load() -> dict[str, Any]:
    load = {"sweep": {"amplitude": 900.0, "from_hz": 0.5, "to_hz": 7.0, "fade_s": 0.5}}
    motor = {"stiffness_nm_per_rad": 0.06, "damping_nm_s_per_rad": 4.0e-4}
    return {
        "description": "rack force swept to 7 Hz against a stiff motor",
        "segments": [{"duration_s": 20.0, "rack_force_n": load, "motor": motor}],
    }


def _motor_off() -> dict[str, Any]:
    """The rig moves the rack; hands and motor are off, so both torque sensors should read none."""
    way = {"sine": {"amplitude": 0.02, "frequency_hz": 0.5, "fade_s": 1.0}}
    rig = {"stiffness_n_per_m": 200e3, "damping_n_s_per_m": 20e3, "position_m": way}
    return {
        "description": "the rig moves the rack, hands off the wheel and motor off",
        "segments": [{"duration_s": 20.0, "rig": rig, "driver": "hands_off"}],
    }


VARIANTS: Mapping[str, Callable[[], dict[str, Any]]] = {
    "slow_reversals": _slow_reversals,
    "hold_series": _hold_series,
    "speeds_without_load": lambda: _speeds([0.0]),
    "speeds_under_load": lambda: _speeds([0.0, 1500.0, -1500.0]),
    "long_travel": _long_travel,
    "fast_load": _fast_load,
    "motor_off": _motor_off,
}


def contents() -> dict[str, dict[str, Any]]:
    """Each test of the menu as the content of its manoeuvre file."""
    found = {name: dict(yaml_file.read(FOLDER / f"{name}.yaml")["manoeuvre"]) for name in FILES}
    for name, make in VARIANTS.items():
        found[name] = {"name": name, **make()}
    return found


def menu(
    model: Model,
    on_progress: Callable[[float], None] | None = None,
    names: Sequence[str] | None = None,
) -> dict[str, dict[str, Series]]:
    """Each test's simulated recording on the rig that ``model`` describes, by name.

    ``names`` picks some of the menu.
    """
    chain = assumed_chain(model)
    made = {}
    every = {name: one for name, one in contents().items() if names is None or name in names}
    for k, (name, content) in enumerate(every.items()):
        manoeuvre = yaml_file.validate(f"{name}.yaml", content, Manoeuvre, section="manoeuvre")
        columns = dict(simulate_recording(model, chain, manoeuvre, order=2).columns)
        t_ns = np.round(columns.pop("time_s") * 1e9).astype(np.int64)
        made[name] = {signal: Series(t_ns, values) for signal, values in columns.items()}
        if on_progress:
            on_progress((k + 1) / len(every))
    return made


def write(name: str, why: str, path: Path) -> None:
    """The test as a manoeuvre file for ``eps-hil rig --manoeuvre``; ``why`` heads it."""
    content = contents()[name]
    text = yaml.safe_dump({"manoeuvre": content}, sort_keys=False, allow_unicode=True)
    path.write_text(f"# {why}\n{text}", encoding="utf-8")
