"""A model file with a law that a diagnosis wrote: every command that reads the file acts by it."""

import json
import os
import subprocess
import sys
import time
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eps_hil.bus.codec import FrameEncoder
from eps_hil.bus.database import load_database
from eps_hil.bus.port import open_port
from eps_hil.cli.main import main
from eps_hil.estimation.validity import Reason
from eps_hil.physics.model import Delays, Model, dump_model, load_model

ROOT = Path(__file__).parents[2]
PLAIN = ROOT / "configs" / "reference_rig.yaml"
LAW: Mapping[str, Any] = {
    "effect": "empirical", "form": "law", "where": "load", "how": "factor",
    "inputs": ["motor_angle_rad"], "memory": ["none"], "shapes": ["linear"], "size": 0.03,
    "range": {"motor_angle_rad": [-30.0, 30.0]}, "law": "F/i_APA · (1 + 0.03 · φ)",
}  # fmt: skip


@pytest.fixture
def learnt(tmp_path: Path) -> Path:
    """The model file with the law among its effects."""
    model = load_model(PLAIN)
    path = tmp_path / "learnt.yaml"
    path.write_text(dump_model(replace(model, effects=(LAW,))), encoding="utf-8")
    return path


@pytest.fixture
def driven(tmp_path: Path) -> Path:
    """Motor torque and rack force that carry the rotor some ten radians to and fro."""
    t = np.arange(6000) * 1e-3
    force = 400.0 * np.sin(1.3 * t)
    torque = force / 2513.0 + 0.13 * np.sin(4.0 * t)
    path = tmp_path / "driven.csv"
    np.savetxt(path, np.column_stack([t, torque, force]), delimiter=",", comments="",
               header="time_s,motor_torque_nm,rack_force_n", fmt="%.9g")  # fmt: skip
    return path


def simulated(model: Path, driven: Path) -> Path:
    out = driven.parent / f"{model.stem}.csv"
    assert (
        main(["simulate", "--model", str(model), "--inputs", str(driven), "--out", str(out)]) == 0
    )
    return out


def error_n(recording: Path, model: Path) -> float:
    summary = recording.parent / "summary.json"
    assert main(["estimate", str(recording), "--model", str(model), "--json", str(summary)]) == 0
    (one,) = json.loads(summary.read_text(encoding="utf-8"))["recordings"]
    return float(one["rack_force_error_n"]["rms_moving"])


def test_simulate_and_estimate_act_by_it(learnt: Path, driven: Path) -> None:
    with_it, without = (
        np.genfromtxt(simulated(one, driven), delimiter=",", names=True) for one in (learnt, PLAIN)
    )
    assert np.std(with_it["motor_speed_rad_s"] - without["motor_speed_rad_s"]) > 1.0
    recording = driven.parent / "learnt.csv"
    assert error_n(recording, learnt) < 20.0
    assert error_n(recording, PLAIN) > 3.0 * error_n(recording, learnt)


def test_export_holds_it(learnt: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "drive.fmu"
    assert main(["export", str(learnt), "--fmu", str(out)]) == 0
    assert "1 effect," in capsys.readouterr().out
    held = zipfile.ZipFile(out).read("resources/model.yaml").decode()
    assert "effect: empirical" in held
    assert "size: 0.03" in held


CHANNEL, OPTIONS = "239.74.163.79", {"port": 43179, "hop_limit": 0}
FRAMES = ("EPS_Torques", "RIG_State", "EPS_MotorState")
VALID = 2
SEEN_RAD = 6.0
HALF_FADED_RAD = SEEN_RAD + 0.1 * 2.0 * SEEN_RAD
"""From here on less than half of a law seen on ±SEEN_RAD is left."""


def weave(model: Model, seconds: float) -> list[dict[str, float]]:
    """A rig of other code that has ``LAW``, under a controller: its signals at 1 kHz."""
    friction, ratio, step = model.friction, model.rack_to_rotor_ratio_rad_per_m, 1e-4
    angle = speed = bristle = 0.0
    rows = []
    for k in range(round(seconds / step)):
        t = k * step
        force = 400.0 * np.sin(1.3 * t)
        wanted, rate = 9.0 * np.sin(2.0 * t), 18.0 * np.cos(2.0 * t)
        torque = force / ratio + 0.2 * (wanted - angle) + 5e-3 * (rate - speed)
        if k % 10 == 0:
            rows.append({
                "MotorTorque": torque, "TorsionBarTorque": 0.0, "RackForce": force,
                "MotorSpeed": speed, "MotorAngle": angle, "RackPosition": angle / ratio,
            })  # fmt: skip
        forth = friction.offset_pos_nm + friction.load_pos_nm_per_n * abs(force)
        back = friction.offset_neg_nm + friction.load_neg_nm_per_n * abs(force)
        bristle = min(max(bristle + friction.sigma0_nm_per_rad * speed * step, -back), forth)
        viscous = (
            friction.viscous_pos_nm_s_per_rad if speed > 0.0 else friction.viscous_neg_nm_s_per_rad
        )
        load = force / ratio * (1.0 + LAW["size"] * angle)
        speed += step / model.inertia_kg_m2 * (torque - load - bristle - viscous * speed)
        angle += step * speed
    return rows


def on_the_bus(
    config: Path, rows: Sequence[Mapping[str, float]]
) -> tuple[list[dict[str, float]], list[dict[str, float]]]:
    """What ``run`` publishes while ``rows`` are sent, each beside the row that it is about.

    Well inside of what was learnt, and well beyond. A row that is late is sent all the same, and
    those after it catch up; what came is read once all is sent.
    """
    database = load_database([ROOT / "dbc" / "eps_rig.dbc"])
    encoders = [FrameEncoder(database, name) for name in FRAMES]
    frames = [[encoder.frame(row) for encoder in encoders] for row in rows]
    service = subprocess.Popen(
        [sys.executable, "-m", "eps_hil.cli", "run", "--config", str(config)],
        stdout=subprocess.PIPE, text=True, env=os.environ | {"PYTHONUNBUFFERED": "1"},
    )  # fmt: skip
    port = open_port("udp_multicast", CHANNEL, fd=True, options=OPTIONS)
    came: list[Any] = []
    try:
        assert service.stdout is not None
        assert any(line == "READY\n" for line in service.stdout)
        start, start_ns = time.monotonic(), time.time_ns()
        for k, cycle in enumerate(frames):
            time.sleep(max(0.0, start + k * 1e-3 - time.monotonic()))
            for frame in cycle:
                port.send(frame)
            came += port.recv(0.0)
    finally:
        service.terminate()
        service.communicate(timeout=10)
        port.close()
    inside: list[dict[str, float]] = []
    beyond: list[dict[str, float]] = []
    for frame in came:
        if frame.can_id == 0x120:
            one = database.decode_message(0x120, frame.data, decode_choices=False)
            then = round((frame.t_ns - start_ns) * 1e-6 - float(one["EstimateAge"]))
            if not 0 <= then < len(rows):
                continue
            away = abs(rows[then]["MotorAngle"])
            if away < 0.9 * SEEN_RAD:
                inside.append({**one, **rows[then]})
            elif away > 1.1 * HALF_FADED_RAD:
                beyond.append({**one, **rows[then]})
    return inside, beyond


def valid(told: Sequence[Mapping[str, float]]) -> list[Mapping[str, float]]:
    return [one for one in told if one["EstimateStatus"] == VALID]


def asked(told: Sequence[Mapping[str, float]]) -> list[Mapping[str, float]]:
    """Beyond its range."""
    return [one for one in told if int(one["EstimateReason"]) & Reason.OUT_OF_RANGE]


@pytest.mark.slow
def test_the_service_acts_by_it_and_is_not_valid_beyond_what_was_learnt(tmp_path: Path) -> None:
    model = replace(load_model(PLAIN), delays_s=Delays())
    narrow = {**LAW, "range": {"motor_angle_rad": [-SEEN_RAD, SEEN_RAD]}}
    service, config = tmp_path / "service.yaml", tmp_path / "config.yaml"
    service.write_text(dump_model(replace(model, effects=(narrow,))), encoding="utf-8")
    config.write_text(
        f"bus: {{interface: udp_multicast, channel: {CHANNEL}, fd: true,\n"
        f"      options: {json.dumps(OPTIONS)}}}\n"
        f"dbc: {ROOT}/dbc/eps_rig.dbc\nsignals: {ROOT}/configs/eps_rig_signals.yaml\n"
        f"model: {service}\n",
        encoding="utf-8",
    )
    inside, beyond = on_the_bus(config, weave(model, 12.0))
    good = valid(inside)
    assert len(good) >= 100
    assert not asked(inside)
    left = [one["RackForceEstimate"] - one["RackForce"] for one in good]
    law = [LAW["size"] * one["MotorAngle"] * one["RackForce"] for one in good]
    assert np.std(left) < 0.3 * np.std(law)
    assert len(asked(beyond)) >= 100
    assert not valid(beyond)
