"""A verdict on each signal: what is said of it when it is missing, damaged, or cannot be."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import pytest

from eps_hil.bus.codec import FrameEncoder
from eps_hil.bus.frame import Frame
from eps_hil.errors import InputError
from eps_hil.estimation.stream import SIGNALS
from eps_hil.estimation.validity import Reason
from eps_hil.service.config import PublishConfig, ServiceConfig, load_config
from eps_hil.service.setup import Parts, describe, prepare
from eps_hil.service.verdict import NEEDED, SignalVerdict, signal_verdicts, verdict_values

from .conftest import DATABASE, ROOT, T0_NS

MS = 1_000_000
Change = Callable[[str, Mapping[str, float]], Mapping[str, float] | None]


@dataclass
class Traffic:
    """Frames of the rig into a core; ``change`` (message, values) -> other values, or none."""

    parts: Parts
    k: int = 0
    encoders: dict[str, FrameEncoder] = field(default_factory=dict)

    def run(self, milliseconds: int, change: Change = lambda _, values: values) -> None:
        for _ in range(milliseconds):
            phase = 2 * math.pi * 2.0 * self.k * 1e-3
            values = {
                "MotorTorque": 0.4 * math.sin(phase) + 1e-5 * (self.k % 7),
                "TorsionBarTorque": 0.1 + 1e-5 * (self.k % 5),
                "RackForce": 1000.0 * math.sin(phase),
                "RackPosition": 0.0,
                "MotorSpeed": 8.0 * math.cos(phase),
                "MotorAngle": 0.6366 * math.sin(phase),
            }
            for place, name in enumerate(("EPS_Torques", "RIG_State", "EPS_MotorState")):
                encoder = self.encoders.setdefault(name, FrameEncoder(DATABASE, name))
                frame = encoder.frame(values, T0_NS + self.k * MS + place * 120_000)
                told = change(name, values)
                if told is None:
                    continue
                if told is not values:
                    frame = self._damaged(frame, name, told)
                self.parts.core.on_frames([frame])
            self.k += 1

    @staticmethod
    def _damaged(frame: Frame, name: str, told: Mapping[str, float]) -> Frame:
        if "crc" in told:
            return replace(frame, data=bytes([frame.data[0] ^ 1]) + frame.data[1:])
        other = FrameEncoder(DATABASE, name)
        for _ in range(frame.data[1] + 1):  # the same counter
            made = other.frame(told, frame.t_ns)
        return made

    def codes(self, silent_at_ns: int | None = None) -> dict[str, SignalVerdict]:
        latest = self.parts.core.latest
        reason = Reason.NOT_STARTED if latest is None else latest.reason
        return dict(
            zip(SIGNALS, signal_verdicts(self.parts.estimator, reason, silent_at_ns), strict=True)
        )


@pytest.fixture
def traffic(parts: Parts) -> Traffic:
    return Traffic(parts)


def without(name: str) -> Change:
    return lambda message, values: None if message == name else values


def spoiled(name: str, **what: float) -> Change:
    return lambda message, values: {**values, **what} if message == name else values


def test_before_anything_came_and_when_all_is_well(traffic: Traffic) -> None:
    codes = traffic.codes()
    assert codes["motor_torque_nm"] is SignalVerdict.NEVER_SEEN
    assert codes["rack_force_n"] is SignalVerdict.NOT_USED
    traffic.run(400)
    assert set(traffic.codes().values()) == {SignalVerdict.FINE, SignalVerdict.NOT_USED}


@pytest.mark.parametrize(
    ("change", "names", "code"),
    [
        (without("EPS_Torques"), ["motor_torque_nm", "torque_sensor_nm"], SignalVerdict.MISSING),
        (
            spoiled("EPS_Torques", crc=1.0),
            ["motor_torque_nm", "torque_sensor_nm"],
            SignalVerdict.NOT_AVAILABLE,
        ),
        (
            spoiled("EPS_Torques", TorsionBarTorque=math.nan),
            ["torque_sensor_nm"],
            SignalVerdict.NOT_AVAILABLE,
        ),
        (spoiled("EPS_Torques", MotorTorque=8.3), ["motor_torque_nm"], SignalVerdict.OUT_OF_RANGE),
    ],
)
def test_the_signal_at_fault_is_named(
    traffic: Traffic, change: Change, names: list[str], code: SignalVerdict
) -> None:
    traffic.run(400)
    traffic.run(60 if code is SignalVerdict.MISSING else 15, change)
    codes = traffic.codes()
    assert {name: codes[name] for name in names} == dict.fromkeys(names, code)
    others = [codes[n] for n in SIGNALS[:4] if n not in names]
    assert set(others) <= {SignalVerdict.FINE, SignalVerdict.INCONSISTENT}
    traffic.run(400)
    assert set(traffic.codes().values()) == {SignalVerdict.FINE, SignalVerdict.NOT_USED}


def test_a_sync_frame_that_stopped(traffic: Traffic) -> None:
    traffic.run(400)
    traffic.run(200, without("EPS_MotorState"))
    codes = traffic.codes(T0_NS + traffic.k * MS)
    assert codes["motor_speed_rad_s"] is SignalVerdict.MISSING
    assert codes["motor_torque_nm"] is SignalVerdict.FINE


def test_every_reason_fits_and_the_labels_are_the_codes(traffic: Traffic) -> None:
    message = DATABASE.get_message_by_name("EPSHIL_Verdict")
    everything = Reason(sum(bit for bit in Reason))
    values = verdict_values(traffic.parts.estimator, everything)
    encoder = FrameEncoder(DATABASE, "EPSHIL_Verdict")
    told = message.decode(encoder.frame(values).data, decode_choices=False)
    assert told["EstimateReasons"] == int(everything)
    for name in NEEDED[:-1]:
        choices = message.get_signal_by_name(name).choices
        assert {k: str(v) for k, v in choices.items()} == {
            code.value: code.name.lower() for code in SignalVerdict
        }
    comment = message.get_signal_by_name("EstimateReasons").comment
    for bit in Reason:
        assert f"{bit.value} {bit.name.lower().replace('_', ' ')}" in comment  # type: ignore[union-attr]


def test_a_database_from_before_it_gets_none_unless_it_is_asked_for(
    tmp_path: Path, config: ServiceConfig
) -> None:
    text = (ROOT / "dbc" / "eps_rig.dbc").read_text()
    old = tmp_path / "old.dbc"
    old.write_text(text.replace("EPSHIL_Verdict", "Somebody_Elses"))
    parts = prepare(replace(config, dbc=(old,)), Path("c.yaml"))
    assert parts.verdict is None
    assert 0x121 not in parts.send_ids
    none = replace(config, publish=PublishConfig(verdict_message=None))
    assert prepare(none, Path("c.yaml")).verdict is None
    asked = replace(config, dbc=(old,), publish=PublishConfig(verdict_message="Verdicts"))
    with pytest.raises(InputError, match="has no message Verdicts"):
        prepare(asked, Path("c.yaml"))
    said = "\n".join(describe(prepare(config, Path("c.yaml"))))
    assert "send       0x121 EPSHIL_Verdict every 0.01 s" in said


def test_two_messages_of_one_name_are_refused(config_file: Path, config_text: str) -> None:
    config_file.write_text(config_text + "publish: {verdict_message: EPSHIL_Health}\n")
    with pytest.raises(InputError, match="are the same"):
        load_config(config_file)


def test_a_torque_that_comes_too_seldom_is_named(traffic: Traffic) -> None:
    """No sample is too old, and none is missing for long: only in the end are they too few."""
    traffic.run(400)

    def every_third(message: str, values: Mapping[str, float]) -> Mapping[str, float] | None:
        return None if message == "EPS_Torques" and traffic.k % 3 else values

    traffic.run(1500, every_third)
    latest = traffic.parts.core.latest
    assert latest is not None
    assert latest.reason & Reason.GAP
    codes = traffic.codes()
    assert codes["motor_torque_nm"] is codes["torque_sensor_nm"] is SignalVerdict.GAP
    assert codes["motor_speed_rad_s"] is SignalVerdict.FINE
    traffic.run(1500)
    assert set(traffic.codes().values()) == {SignalVerdict.FINE, SignalVerdict.NOT_USED}
