"""What other people's tools find in the files: asammdf, pyarrow, the MCAP library."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eps_hil.bus.frame import Frame
from eps_hil.errors import InputError
from eps_hil.recordings.can_log import read_frames, read_tagged_frames
from eps_hil.recordings.conversion import convert
from eps_hil.recordings.read import read_recording
from eps_hil.recordings.write import write_series
from eps_hil.series import Series
from eps_hil.signals import CANONICAL

LogWriter = Callable[[str, list[Frame]], Path]

ROOT = Path(__file__).parents[2]
DBC = ROOT / "dbc" / "eps_rig.dbc"
SIGNALS = ROOT / "configs" / "eps_rig_signals.yaml"

asammdf = pytest.importorskip("asammdf")


def test_asammdf_extracts_the_same_signals_from_bus_logging(
    tmp_path: Path, write_log: LogWriter, rig_frames: list[Frame]
) -> None:
    log, raw = write_log("a.log", rig_frames), tmp_path / "a.mf4"
    said: list[str] = []
    assert convert(log, raw, dbc=[DBC], say_written=said.append) == ()
    assert said == [f"{len(rig_frames)} frames, as bus logging,"]
    ours = read_recording(log, dbc=[DBC], signals=SIGNALS).series
    for name, one in read_recording(raw, dbc=[DBC], signals=SIGNALS).series.items():
        np.testing.assert_array_equal(one.t_ns, ours[name].t_ns)
        np.testing.assert_array_equal(one.value, ours[name].value)
    with asammdf.MDF(raw) as mdf:
        assert [one.file_name for one in mdf.attachments] == ["eps_rig.dbc"]
        assert mdf.groups[0].channel_group.acq_name == "CAN"
        found = mdf.extract_bus_logging({"CAN": [(str(DBC), 0)]})
        start_s = mdf.header.start_time.timestamp()
        for name, theirs, can_id in (
            ("rack_force_n", "RackForce", 0x110),
            ("rack_position_m", "RackPosition", 0x110),
            ("motor_torque_nm", "MotorTorque", 0x101),
            ("torque_sensor_nm", "TorsionBarTorque", 0x101),
            ("motor_speed_rad_s", "MotorSpeed", 0x100),
        ):
            signal = found.get(theirs)
            np.testing.assert_allclose(signal.samples, ours[name].value, atol=1e-9)
            frames = [frame.t_ns * 1e-9 for frame in rig_frames if frame.can_id == can_id]
            np.testing.assert_allclose(signal.timestamps + start_s, frames, rtol=0, atol=1e-6)


def test_bus_logging_keeps_every_frame(tmp_path: Path) -> None:
    lines = (
        "(1757617431.821276) can0 123#DEADBEEF R\n"
        "(1757617431.821277) can1 00000123# T\n"
        "(1757617431.900001) can0 123##1" + "1A" * 48 + " R\n"
        "(1757617432.000000) can0 123#R R\n"
    )
    log, raw = tmp_path / "a.log", tmp_path / "a.mf4"
    log.write_text(lines)
    convert(log, raw)
    before = list(read_tagged_frames(log))
    after = list(read_tagged_frames(raw))
    assert [frame for _, frame in after] == [frame for _, frame in before]
    assert [name for name, _ in after] == ["1", "2", "1", "1"]
    with asammdf.MDF(raw) as mdf:
        comment = mdf.groups[0].channel_group.comment
    assert "bus channel 1: can0" in comment
    with pytest.raises(InputError, match=r"leave out --rate, or give --signals"):
        convert(log, tmp_path / "b.mf4", rate_hz=100.0)


def test_a_log_longer_than_one_part_is_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, write_log: LogWriter, rig_frames: list[Frame]
) -> None:
    monkeypatch.setattr("eps_hil.recordings.mf4_bus._CHUNK", 100)
    convert(write_log("a.log", rig_frames), tmp_path / "a.mf4")
    assert list(read_frames(tmp_path / "a.mf4")) == rig_frames


def test_mf4_signals_say_what_they_are_and_which_samples_are_bad(
    tmp_path: Path, write_log: LogWriter, rig_frames: list[Frame]
) -> None:
    frames = list(rig_frames)
    position = [i for i, frame in enumerate(frames) if frame.can_id == 0x101][150]
    frames[position] = replace(frames[position], data=bytes(8))  # wrong CRC
    log, target = write_log("a.log", frames), tmp_path / "a.mf4"
    notes = convert(log, target, dbc=[DBC], signals=SIGNALS)
    assert notes[-1] == (
        "bad samples of motor_torque_nm, torque_sensor_nm are marked by their invalidation bits"
    )
    with asammdf.MDF(target) as mdf:
        groups = {group.channel_group.acq_name: group for group in mdf.groups}
        assert set(groups) == {
            "EPS_MotorState",
            "EPS_Torques",
            "RIG_State",
            "EPS_SteeringWheel",
        }
        torque = mdf.get("motor_torque_nm", ignore_invalidation_bits=True)
        assert np.flatnonzero(torque.invalidation_bits).tolist() == [150]
        assert len(mdf.get("motor_torque_nm").samples) == len(torque.samples) - 1
        force = mdf.get("rack_force_n")
        assert force.invalidation_bits is None
        assert (force.unit, force.comment) == ("N", CANONICAL["rack_force_n"].description)
        assert (force.source.name, force.source.bus_type) == ("RIG_State", 2)
        assert "from a.log" in mdf.header.comment
    with pytest.raises(InputError, match=r"sample 151, channel motor_torque_nm: is NaN"):
        read_recording(target)
    direct = read_recording(log, dbc=[DBC], signals=SIGNALS).series
    for name, one in read_recording(target, gaps="mark").series.items():
        np.testing.assert_array_equal(one.t_ns, direct[name].t_ns)
        np.testing.assert_array_equal(one.value, direct[name].value)


def test_an_estimate_that_is_told_not_to_hold_is_no_bad_sample(tmp_path: Path) -> None:
    t_ns = np.arange(5, dtype=np.int64) * 1_000_000
    series = {
        "rack_force_estimate_n": Series(t_ns, np.array([1.0, np.nan, np.nan, 4.0, 5.0])),
        "valid": Series(t_ns, np.array([1.0, 0.0, 0.0, 1.0, 1.0])),
    }
    write_series(tmp_path / "a.mf4", series)
    back = read_recording(tmp_path / "a.mf4").series["rack_force_estimate_n"]
    np.testing.assert_array_equal(back.value, series["rack_force_estimate_n"].value)


def test_mcap_holds_every_sample_under_its_schema(
    tmp_path: Path, write_log: LogWriter, rig_frames: list[Frame]
) -> None:
    reader = pytest.importorskip("mcap.reader")
    jsonschema = pytest.importorskip("jsonschema")
    log, target = write_log("a.log", rig_frames), tmp_path / "a.mcap"
    convert(log, target, dbc=[DBC], signals=SIGNALS)
    found: dict[str, list[tuple[int, float]]] = {}
    with target.open("rb") as file:
        content = reader.make_reader(file, validate_crcs=True)
        summary = content.get_summary()
        (schema,) = summary.schemas.values()
        (channel,) = summary.channels.values()
        told = json.loads(schema.data)
        jsonschema.Draft202012Validator.check_schema(told)
        check = jsonschema.Draft202012Validator({**told, "additionalProperties": False})
        for _, _, message in content.iter_messages():
            values: dict[str, Any] = json.loads(message.data)
            check.validate(values)
            assert message.log_time == message.publish_time
            values.pop("loops", None)
            for name, value in values.items():
                found.setdefault(name, []).append((message.log_time, value))
    assert (channel.topic, channel.message_encoding, schema.encoding) == (
        "/eps_hil", "json", "jsonschema"
    )  # fmt: skip
    assert channel.metadata["rack_force_n"] == "N"
    assert "CAN message RIG_State" in told["properties"]["rack_force_n"]["description"]
    direct = read_recording(log, dbc=[DBC], signals=SIGNALS).series
    assert set(found) == set(direct)
    for name, one in direct.items():
        assert found[name] == list(zip(one.t_ns.tolist(), one.value.tolist(), strict=True))


def test_mcap_of_one_rate_has_loops_of_force_over_position(
    tmp_path: Path, write_log: LogWriter, rig_frames: list[Frame]
) -> None:
    """PlotJuggler draws one over the other only where both have the same stamps."""
    reader = pytest.importorskip("mcap.reader")
    log, target = write_log("a.log", rig_frames), tmp_path / "a.mcap"
    convert(log, target, dbc=[DBC], signals=SIGNALS, rate_hz=1000.0)
    with target.open("rb") as file:
        rows = [json.loads(m.data) for _, _, m in reader.make_reader(file).iter_messages()]
    assert len(rows) > 250
    for each in rows:
        loop = each["loops"]["load_cell"]
        assert loop == {name: each[name] for name in ("rack_position_m", "rack_force_n")}


def test_mcap_has_no_word_for_a_bad_sample(tmp_path: Path) -> None:
    """JSON has no NaN, and a reader may stop at one."""
    reader = pytest.importorskip("mcap.reader")
    t_ns = np.arange(3, dtype=np.int64)
    write_series(tmp_path / "a.mcap", {"rack_force_n": Series(t_ns, np.array([1.0, np.nan, 3.0]))})
    with (tmp_path / "a.mcap").open("rb") as file:
        data = [m.data for _, _, m in reader.make_reader(file).iter_messages()]
    assert data == [b'{"rack_force_n": 1.0}', b'{"rack_force_n": 3.0}']


def test_parquet_columns_say_their_unit(tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    (tmp_path / "a.csv").write_text("time_s,rack_force_n,motor_speed_rad_s\n0,1,2\n1,3,4\n")
    convert(tmp_path / "a.csv", tmp_path / "a.parquet")
    schema = parquet.read_schema(tmp_path / "a.parquet")
    units = {field.name: field.metadata[b"unit"].decode() for field in schema}
    assert units == {"time_s": "s", "rack_force_n": "N", "motor_speed_rad_s": "rad/s"}
    assert schema.field("rack_force_n").metadata[b"description"].startswith(b"rig load cell")
    assert schema.metadata[b"written_by"].startswith(b"eps_hil ")
