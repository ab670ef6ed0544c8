"""What the service refuses before it opens a bus, and what it says that it will do."""

import re
from dataclasses import fields, replace
from pathlib import Path

import pytest
import yaml

from eps_hil.bus.commands import Command, Kind
from eps_hil.bus.config import BusConfig
from eps_hil.bus.frame import Frame
from eps_hil.errors import BusError, InputError
from eps_hil.service.config import PublishConfig, RuntimeConfig, ServiceConfig, load_config
from eps_hil.service.loop import open_for
from eps_hil.service.setup import Parts, describe, prepare

from .conftest import MAPPING, ROOT


def refused(tmp_path: Path, text: str) -> str:
    path = tmp_path / "c.yaml"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        prepare(load_config(path), path)
    return str(caught.value)


def mapped(tmp_path: Path, text: str, old: str, new: str) -> str:
    """The configuration with a mapping of its own, in which ``old`` is ``new``."""
    source = (ROOT / "configs" / "eps_rig_signals.yaml").read_text()
    assert old in source
    (tmp_path / "s.yaml").write_text(source.replace(old, new))
    return text.replace(f"{ROOT}/configs/eps_rig_signals.yaml", "s.yaml")


def test_says_what_it_listens_to_and_sends(parts: Parts) -> None:
    said = "\n".join(describe(parts))
    assert "listen     0x100 EPS_MotorState every 1 ms, the estimator steps on it" in said
    assert "0x101 EPS_Torques every 1 ms: motor_torque_nm, torque_sensor_nm" in said
    assert "send       0x120 EPSHIL_Estimate with every sync frame" in said
    assert "send       0x400 EPSHIL_Health every 0.1 s" in said
    assert f"{parts.estimator.latency_s * 1e3:.1f} ms" in said


def test_says_which_effects_lack_the_angle(tmp_path: Path, config_text: str) -> None:
    angle = "  motor_angle_rad: {message: EPS_MotorState, signal: MotorAngle}\n"
    text = mapped(tmp_path, config_text, angle, "")
    model = (ROOT / "configs" / "reference_rig.yaml").read_text()
    spring = "effects: [{effect: unmodelled_spring, stiffness_nm_per_rad: 0.002}]"
    (tmp_path / "m.yaml").write_text(model.replace("effects: []", spring))
    path = tmp_path / "c.yaml"
    path.write_text(text.replace(f"{ROOT}/configs/reference_rig.yaml", "m.yaml"))
    said = "\n".join(describe(prepare(load_config(path), path)))
    assert "invalid    at all times: unmodelled_spring needs motor_angle_rad" in said


def test_reads_only_what_the_estimator_needs(parts: Parts) -> None:
    assert "rack_force_estimate_n" in MAPPING.signals  # for recorders, of the same file
    assert parts.decoder.receive_ids == (0x100, 0x101, 0x110)
    assert parts.send_ids == (0x120, 0x400, 0x121)


def test_listen_only(config_file: Path, config_text: str) -> None:
    config_file.write_text(config_text + "publish: {enabled: false, message: Nonsense}\n")
    parts = prepare(load_config(config_file), config_file)
    assert parts.send_ids == ()
    assert "send       nothing" in "\n".join(describe(parts))


def test_what_gives_no_rack_force_is_not_run(tmp_path: Path, config_text: str) -> None:
    said = refused(tmp_path, config_text + "estimator: {quantity: friction}\n")
    assert "estimator.quantity" in said
    assert "estimate --friction" in said


def test_publish_message_must_be_in_the_dbc(tmp_path: Path, config_text: str) -> None:
    said = refused(tmp_path, config_text + "publish: {message: EPSHIL_Estimat}\n")
    assert "c.yaml: publish.message: eps_rig.dbc has no message EPSHIL_Estimat" in said
    assert "EPSHIL_Estimate" in said


def test_publish_message_must_be_able_to_carry_an_estimate(
    tmp_path: Path, config_text: str
) -> None:
    said = refused(tmp_path, config_text + "publish: {message: VEH_Motion}\n")
    assert "VEH_Motion has no signal RackForceEstimate, EstimateStatus" in said


def test_never_sends_an_id_that_it_listens_to(tmp_path: Path, config_text: str) -> None:
    text = mapped(
        tmp_path,
        config_text,
        "rack_force_n: {message: RIG_State, signal: RackForce}",
        "rack_force_n: {message: EPSHIL_Estimate, signal: RackForceEstimate}",
    )
    assert "id 0x120: is both listened to and sent" in refused(tmp_path, text)
    path = tmp_path / "c.yaml"
    path.write_text(text + "publish: {enabled: false}\n")
    assert prepare(load_config(path), path).send_ids == ()


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("MotorTorque}", "MotorTorqe}", "nearest: MotorTorque"),
        ("motor_torque_nm: {message: EPS_Torques, signal: MotorTorque}", "", "motor_torque_nm"),
    ],
)
def test_mapping_that_does_not_fit(
    tmp_path: Path, config_text: str, old: str, new: str, said: str
) -> None:
    text = mapped(tmp_path, config_text, old, new)
    refusal = refused(tmp_path, text)
    assert said in refusal
    assert "s.yaml" in refusal


def test_a_message_without_a_cycle_time_is_refused(tmp_path: Path, config_text: str) -> None:
    dbc = (ROOT / "dbc" / "eps_rig.dbc").read_text()
    line = 'BA_ "GenMsgCycleTime" BO_ 272 1;\n'
    assert line in dbc
    (tmp_path / "a.dbc").write_text(dbc.replace(line, ""))
    text = mapped(tmp_path, config_text, ", clock: counter", "")
    said = refused(tmp_path, text.replace(f"{ROOT}/dbc/eps_rig.dbc", "a.dbc"))
    assert "a.dbc: RIG_State: has no cycle time, which rack_force_n needs" in said


@pytest.mark.parametrize("apply", ["never", "both_known"])
def test_levels_are_not_learnt_out_of_what_an_effect_corrects(
    tmp_path: Path, config_text: str, apply: str
) -> None:
    """25 mNm of a wrong motor torque are 63 N in k0, and that on top of the effect."""
    model = (ROOT / "configs" / "reference_rig.yaml").read_text()
    effect = "  effects: [{effect: motor_torque_offset, offset_nm: 0.025}]"
    (tmp_path / "m.yaml").write_text(re.sub("^  effects:.*$", effect, model, flags=re.M))
    text = config_text.replace(f"{ROOT}/configs/reference_rig.yaml", "m.yaml")
    text += f"adaptation: {{method: reversals, apply: {apply}}}\n"
    if apply == "never":
        (tmp_path / "c.yaml").write_text(text)
        assert prepare(load_config(tmp_path / "c.yaml"), "c.yaml").send_ids
        return
    said = refused(tmp_path, text)
    assert "m.yaml: model.effects: motor_torque_offset changes a torque, which adaptation" in said


_FORCE = 'RackForceEstimate : 38|18@1- (0.2,0) [-26214.2|26214.2] "N"'


@pytest.mark.parametrize(
    ("signal", "said"),
    [
        ('38|18@1- (0.001,0) [-131|131] "kN"', "is in kN, but newtons are published; make its"),
        ('38|18@1- (0.2,0) [-8000|26214] "N"', "carries -8000 to 26214 N, and up to 15000 N are"),
        ('38|18@1+ (0.2,0) [0|0] "N"', "carries 0 to 52428.6 N, and up to 15000 N are believed"),
        ('38|18@1- (200,0) [-26214200|26214200] "N"', "has steps of 200 N, expected 20 at most"),
        ('38|18@1- (0,0) [-26214200|26214200] "N"', "has factor 0"),
    ],
)
def test_a_force_that_would_arrive_as_another_is_refused(
    tmp_path: Path, config_text: str, signal: str, said: str
) -> None:
    text = (ROOT / "dbc" / "eps_rig.dbc").read_text()
    assert _FORCE in text
    (tmp_path / "a.dbc").write_text(text.replace(_FORCE, f"RackForceEstimate : {signal}"))
    told = refused(tmp_path, config_text.replace(f"{ROOT}/dbc/eps_rig.dbc", "a.dbc"))
    assert "EPSHIL_Estimate.RackForceEstimate: " in told
    assert said in told


@pytest.mark.parametrize(
    ("signal", "said"),
    [
        ("12|1@1+ (1,0) [0|1]", "would say 1 where the status is 2 (valid)"),
        ("12|2@1+ (1,0) [0|2]", "would say 2 where the status is 3 (invalid)"),
        ("12|2@1+ (2,0) [0|6]", "would say 0 where the status is 1 (settling)"),
    ],
)
def test_a_status_that_would_arrive_as_another_is_refused(
    tmp_path: Path, config_text: str, signal: str, said: str
) -> None:
    text, usual = (ROOT / "dbc" / "eps_rig.dbc").read_text(), "12|2@1+ (1,0) [0|3]"
    assert f"EstimateStatus : {usual}" in text
    text = text.replace(f"EstimateStatus : {usual}", f"EstimateStatus : {signal}")
    (tmp_path / "a.dbc").write_text(text)
    told = refused(tmp_path, config_text.replace(f"{ROOT}/dbc/eps_rig.dbc", "a.dbc"))
    assert f"EPSHIL_Estimate.EstimateStatus: {said}" in told


def test_a_narrower_force_is_published_where_no_more_is_believed(
    tmp_path: Path, config_text: str
) -> None:
    text = (ROOT / "dbc" / "eps_rig.dbc").read_text()
    narrow = 'RackForceEstimate : 38|18@1- (0.1,0) [-12000|12000] ""'
    (tmp_path / "a.dbc").write_text(text.replace(_FORCE, narrow))
    path = tmp_path / "c.yaml"
    text = config_text.replace(f"{ROOT}/dbc/eps_rig.dbc", "a.dbc")
    path.write_text(text + "estimator: {plausibility: {estimate_n: 12000}}\n")
    assert prepare(load_config(path), path).send_ids[0] == 0x120


def test_a_derived_speed_is_derived_over_the_window_of_the_mapping(
    tmp_path: Path, config_text: str
) -> None:
    text = mapped(
        tmp_path,
        config_text,
        "motor_speed_rad_s: {message: EPS_MotorState, signal: MotorSpeed}",
        "motor_speed_rad_s: {derive_from: motor_angle_rad, window_s: 0.03}",
    )
    path = tmp_path / "c.yaml"
    path.write_text(text)
    parts = prepare(load_config(path), path)
    assert parts.estimator.settings.speed_window_s == 0.03
    assert "derive     motor_speed_rad_s from motor_angle_rad" in "\n".join(describe(parts))
    assert parts.core.decoder.sync.__self__.sync_id == 0x100  # type: ignore[attr-defined]


@pytest.mark.parametrize("message", ["EPSHIL_TorqueOverride", "RIG_Command"])
def test_a_command_is_nothing_to_publish(tmp_path: Path, config_text: str, message: str) -> None:
    """Health or levels under a command's name would move a motor that nobody armed."""
    text = config_text + f"publish: {{health_message: {message}}}\n"
    said = refused(tmp_path, text)
    assert f"c.yaml: publish: {message} commands a" in said
    assert "only an armed override or a programme sends that" in said


_BENCH = """VERSION ""
BU_: ADAS
BO_ 288 ADAS_SteeringRequest: 8 ADAS
 SG_ TorqueRequest : 0|16@1- (0.001,0) [-10|10] "Nm" Vector__XXX
"""


def test_an_estimate_is_not_sent_by_the_id_of_a_request(tmp_path: Path, config_text: str) -> None:
    """Of a bench whose ADAS sends no torque at the moment: nobody was heard, and it was ours."""
    (tmp_path / "bench.dbc").write_text(_BENCH)
    both = f"[bench.dbc, {ROOT}/dbc/eps_rig.dbc]"
    text = re.sub(r"^dbc: .*$", f"dbc: {both}", config_text, flags=re.M)
    assert both in text
    said = refused(tmp_path, text)
    assert "EPSHIL_Estimate: would be sent by id 0x120, which is also that of ADAS_Steer" in said


def test_health_is_told_by_a_message_for_it_alone(tmp_path: Path, config_text: str) -> None:
    """Any message of the database would do, and went out with zeros in all of its signals."""
    text = config_text + "publish: {health_message: EPS_Temperature}\n"
    assert "message EPS_Temperature has no signal StepRate" in refused(tmp_path, text)


def test_a_message_that_the_mapping_marks_is_nothing_to_publish(
    tmp_path: Path, config_text: str
) -> None:
    text = mapped(tmp_path, config_text, "signals:\n", "commands: [EPSHIL_Estimate]\nsignals:\n")
    assert "EPSHIL_Estimate commands a set-point" in refused(tmp_path, text)


def test_the_service_port_would_refuse_a_command_too(config: ServiceConfig, parts: Parts) -> None:
    port = open_for(parts)
    with pytest.raises(BusError, match="0x80 commands a torque or a rig"):
        port.send(Frame(0, 0x80, bytes(8)))
    port.close()
    with pytest.raises(BusError, match="0x120 commands"):
        open_for(replace(parts, commands={0x120: Command(0x120, "X", Kind.TORQUE)}))


def test_silence_must_be_longer_than_a_cycle(tmp_path: Path, config_text: str) -> None:
    text = config_text.replace("realtime: off", "no_input_after_s: 0.001")
    assert "EPS_MotorState comes every 0.001 s" in refused(tmp_path, text)


def test_the_document_names_every_key() -> None:
    """Their defaults: tests/docs/test_pages.py."""
    document = (ROOT / "docs" / "reference-config.md").read_text(encoding="utf-8")
    found = re.search(r"```yaml\n(.*?)```", document, re.DOTALL)
    assert found is not None
    shown = yaml.safe_load(found[1])
    for block, kind in (("bus", BusConfig), ("publish", PublishConfig), ("service", RuntimeConfig)):
        assert shown[block].keys() == {each.name for each in fields(kind)}


@pytest.mark.parametrize("name", ["demo_udp.yaml", "demo_vcan.yaml"])
def test_shipped_configurations_are_good(name: str) -> None:
    path = ROOT / "configs" / name
    assert prepare(load_config(path), path).send_ids == (0x120, 0x400, 0x121)
