"""``eps-hil estimate`` and ``eps-hil simulate`` as a user calls them."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eps_hil.cli.main import main

ROOT = Path(__file__).parents[2]
MODEL = str(ROOT / "configs" / "reference_rig.yaml")
NAMES = (
    "time_s",
    "motor_torque_nm",
    "torque_sensor_nm",
    "motor_speed_rad_s",
    "motor_angle_rad",
    "rack_force_n",
)


def write_csv(path: Path, truth: Any, names: tuple[str, ...] = NAMES, rows: int = 15000) -> Path:
    table = np.column_stack([truth.columns[name][:rows] for name in names])
    np.savetxt(path, table, delimiter=",", header=",".join(names), comments="", fmt="%.9g")
    return path


@pytest.fixture
def weave(tmp_path: Path, weave_truth: Any) -> Path:
    return write_csv(tmp_path / "weave.csv", weave_truth)


def read(path: Path) -> Any:
    return np.genfromtxt(path, delimiter=",", names=True)


def test_where_nothing_is_valid_no_error_is_told(
    tmp_path: Path, weave_truth: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    short = write_csv(tmp_path / "short.csv", weave_truth, rows=100)
    assert main(["estimate", str(short), "--model", MODEL, "--out", str(tmp_path / "e.csv")]) == 0
    told = capsys.readouterr().out
    assert "no estimate is valid: nothing to compare with the load cell" in told
    assert "nan" not in told


def test_estimate_writes_the_contracts_columns(
    tmp_path: Path, weave: Path, weave_truth: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    out, summary = tmp_path / "e.csv", tmp_path / "e.json"
    status = main(
        ["estimate", str(weave), "--model", MODEL, "--out", str(out), "--json", str(summary)]
    )
    assert status == 0
    assert out.read_text(encoding="utf-8").splitlines()[0] == (
        "time_s,rack_force_estimate_n,friction_torque_nm,valid"
    )
    table = read(out)
    assert np.all(np.diff(table["time_s"]) > 0)
    truth = np.interp(table["time_s"], weave_truth.time_s, weave_truth.rack_force_n)
    speed = np.interp(table["time_s"], weave_truth.time_s, weave_truth.speed_rad_s)
    rows = (table["valid"] == 1) & (np.abs(speed) > 1)
    error = table["rack_force_estimate_n"][rows] - truth[rows]
    assert np.sqrt(np.mean(error**2)) < 20
    (one,) = json.loads(summary.read_text(encoding="utf-8"))["recordings"]
    assert one["rows"] == len(table)
    assert one["valid_share"] == pytest.approx(np.mean(table["valid"]))
    settling = 100.0 * one["reasons"]["settling"] / one["rows"]
    assert f"settling {settling:.3g} % of the time" in capsys.readouterr().out
    assert one["rack_force_error_n"]["rms_moving"] < 20


def test_gaps_are_reported(tmp_path: Path, weave: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = weave.read_text().splitlines(keepends=True)
    weave.write_text("".join(lines[:2001] + lines[3000:6001]))
    summary = tmp_path / "e.json"
    assert main(["estimate", str(weave), "--model", MODEL, "--json", str(summary)]) == 0
    signals = ", ".join((*NAMES[1:5], "rack_force_n"))
    assert f"weave.csv: {signals}: 1 gap of 1 s at 1.999 s\n" in capsys.readouterr().err
    (one,) = json.loads(summary.read_text(encoding="utf-8"))["recordings"]
    assert one["gaps"]["motor_torque_nm"] == {
        "count": 1, "longest_s": pytest.approx(1.0), "at_s": pytest.approx(1.999)
    }  # fmt: skip


def test_blocks_can_be_switched_off(
    tmp_path: Path, weave: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    errors = {}
    for block in ("friction-compensation", "extensions", "low-pass"):
        summary = tmp_path / f"{block}.json"
        words = ["estimate", str(weave), "--model", MODEL, "--without", block]
        assert main([*words, "--json", str(summary)]) == 0
        (one,) = json.loads(summary.read_text(encoding="utf-8"))["recordings"]
        errors[block] = one["rack_force_error_n"]["rms_moving"]
    assert errors["friction-compensation"] > 300
    assert errors["extensions"] < 30
    assert errors["low-pass"] < 30


def test_friction_from_a_known_rack_force(tmp_path: Path, weave: Path) -> None:
    out, summary = tmp_path / "f.csv", tmp_path / "f.json"
    words = ["estimate", str(weave), "--model", MODEL, "--friction", "--out", str(out)]
    assert main([*words, "--json", str(summary)]) == 0
    table = read(out)
    assert 0.05 < np.std(table["friction_torque_nm"]) < 0.3
    assert np.all(np.isnan(table["rack_force_estimate_n"][1000:]))
    (one,) = json.loads(summary.read_text(encoding="utf-8"))["recordings"]
    assert one.get("rack_force_error_n") is None, "it was given"


def test_several_recordings_and_formats(tmp_path: Path, weave: Path, weave_truth: Any) -> None:
    second = write_csv(tmp_path / "second.csv", weave_truth, rows=4000)
    out = str(tmp_path / "{name}_estimate.parquet")
    assert main(["estimate", str(weave), str(second), "--model", MODEL, "--out", out]) == 0
    assert (tmp_path / "weave_estimate.parquet").exists()
    assert (tmp_path / "second_estimate.parquet").exists()


def test_the_torque_sensor_may_be_absent(
    tmp_path: Path, weave_truth: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    names = ("time_s", "motor_torque_nm", "motor_speed_rad_s", "motor_angle_rad")
    recording = write_csv(tmp_path / "bare.csv", weave_truth, names)
    out = tmp_path / "e.csv"
    assert main(["estimate", str(recording), "--model", MODEL, "--out", str(out)]) == 0
    assert "no torsion-bar torque" in capsys.readouterr().err
    assert np.mean(read(out)["valid"]) > 0.95


def test_marked_gaps_make_the_estimate_invalid_for_a_while(tmp_path: Path, weave: Path) -> None:
    lines = weave.read_text(encoding="utf-8").splitlines()
    row = lines[5000].split(",")
    row[1] = "nan"
    lines[5000] = ",".join(row)
    weave.write_text("\n".join(lines) + "\n", encoding="utf-8")
    out = tmp_path / "e.csv"
    words = ["estimate", str(weave), "--model", MODEL, "--out", str(out)]
    assert main(words) == 2
    assert not out.exists()
    assert main([*words, "--gaps", "mark"]) == 0
    table = read(out)
    bad = table["valid"] == 0
    around = (table["time_s"] > 4.8) & (table["time_s"] < 5.3)
    assert 50 < np.sum(bad & around) < 200
    assert not np.any(bad & (table["time_s"] > 5.3))
    assert np.all(np.isfinite(table["rack_force_estimate_n"]))


def test_simulate_lies_on_the_recording(tmp_path: Path, independent_rig: Any, weave: Path) -> None:
    """The same model in other code: speed and angle as its sensors report them."""
    force = independent_rig.weave(6.0)
    truth = independent_rig.run(
        force, 0.0 * force, speed_noise=0.0, torque_noise=0.0, sensor_noise=0.0
    )
    recording = write_csv(tmp_path / "clean.csv", truth, rows=6000)
    out = tmp_path / "s.csv"
    assert main(["simulate", "--model", MODEL, "--inputs", str(recording), "--out", str(out)]) == 0
    table = read(out)
    measured = truth.columns["motor_speed_rad_s"]
    error = table["motor_speed_rad_s"] - measured
    fit = 100 * (1 - np.std(error) / np.std(measured))
    assert fit > 90


def test_simulation_can_be_estimated(
    tmp_path: Path, weave: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, summary = tmp_path / "s.csv", tmp_path / "s.json"
    assert main(["simulate", "--model", MODEL, "--inputs", str(weave), "--out", str(out)]) == 0
    assert main(["estimate", str(out), "--model", MODEL, "--json", str(summary)]) == 0
    (one,) = json.loads(summary.read_text(encoding="utf-8"))["recordings"]
    assert one["rack_force_error_n"]["rms_moving"] < 20


def test_physical_instants_differ_by_the_delays(tmp_path: Path, weave: Path) -> None:
    columns = []
    for words in ([], ["--physical"]):
        out = tmp_path / f"s{len(words)}.csv"
        base = ["simulate", "--model", MODEL, "--inputs", str(weave), "--out", str(out)]
        assert main([*base, *words]) == 0
        columns.append(read(out)["motor_speed_rad_s"])
    reported, physical = columns
    assert np.allclose(reported[4:], physical[:-4], atol=1e-9)


HEADER = "time_s,motor_torque_nm,torque_sensor_nm,motor_speed_rad_s\n"


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (HEADER + "0,1,0,2\n0.001,oops,0,2\n", "line 3, column motor_torque_nm"),
        (HEADER + "0.001,1,0,2\n0,1,0,2\n", "time goes back"),
        (HEADER + "0,1,0,2\n0.001,inf,0,2\n", "line 3, column motor_torque_nm"),
        ("time_s,motor_torque_nm,foo\n0,1,2\n", "foo"),
        ("", "empty"),
        ("time_s,motor_torque_nm\n0,1\n0.001,1\n", "motor_speed_rad_s or motor_angle_rad"),
        ("time_s,motor_speed_rad_s\n0,1\n0.001,1\n", "motor_torque_nm"),
        (HEADER + "0,1,0,2\n0.001,1,0,2\n", "too short"),
    ],
)
def test_bad_recordings(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], content: str, said: str
) -> None:
    recording = tmp_path / "bad.csv"
    recording.write_text(content, encoding="utf-8")
    for words in (["estimate", str(recording)], ["simulate", "--inputs", str(recording)]):
        out = tmp_path / "out.csv"
        status = main([*words, "--model", MODEL, "--out", str(out)])
        err = capsys.readouterr().err
        if words[0] == "simulate" and ("short" in said or "speed_rad_s or" in said):
            continue  # a simulation needs no speed, and no length
        assert status == 2
        assert err.count("\n") == 1
        assert "bad.csv" in err
        assert said in err
        assert not out.exists()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--model", "none.yaml"], "none.yaml: no such file"),
        ([], "Missing option '--model'"),
        (["--model", MODEL, "--out", "x.txt"], ".txt"),
        (["--model", MODEL, "--without", "everything"], "everything"),
        (["--model", MODEL, "--settings", "none.yaml"], "none.yaml"),
    ],
)
def test_bad_words(
    weave: Path, capsys: pytest.CaptureFixture[str], words: list[str], said: str
) -> None:
    assert main(["estimate", str(weave), *words]) == 2
    captured = capsys.readouterr()
    assert captured.err.count("\n") == 1
    assert said in captured.err


def test_out_may_not_be_the_recording(weave: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = weave.read_bytes()
    assert main(["estimate", str(weave), "--model", MODEL, "--out", str(weave)]) == 2
    assert weave.read_bytes() == before
    assert "is read by this command" in capsys.readouterr().err


@pytest.mark.parametrize("kind", ["bristle_filter", "smoother"])
def test_another_estimator(
    tmp_path: Path, weave: Path, capsys: pytest.CaptureFixture[str], kind: str
) -> None:
    summary = tmp_path / "e.json"
    words = ["estimate", str(weave), "--model", MODEL, "--estimator", kind]
    assert main([*words, "--json", str(summary)]) == 0
    (one,) = json.loads(summary.read_text(encoding="utf-8"))["recordings"]
    assert one["rack_force_error_n"]["rms_moving"] < 6
    assert (one["latency_s"] is None) == (kind == "smoother")
    assert main([*words, "--without", "friction-compensation"]) == 2
    assert "friction inside" in capsys.readouterr().err


TABLE = """
time: {column: ms, scale: 0.001}
signals:
  motor_speed_rad_s: {column: n_rotor, scale: 0.10471975511965977}
  rack_force_n: {sum: [left, right]}
  motor_torque_nm: {column: iq, torque_constant_nm_per_a: 0.047}
  motor_angle_rad: {column: counts, counts_per_turn: 4096}
  torque_sensor_nm: {column: tb, scale: 0.001}
"""


def test_a_mapped_table_gives_what_the_canonical_one_does(
    tmp_path: Path, weave_truth: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    """In ``estimate`` and ``compare``, as in the verbs that always took one."""
    plain = write_csv(tmp_path / "plain.csv", weave_truth, rows=6000)
    columns = {name: weave_truth.columns[name][:6000] for name in NAMES}
    turns = columns["motor_angle_rad"] / (2 * np.pi)
    theirs = {
        "ms": columns["time_s"] * 1e3,
        "n_rotor": columns["motor_speed_rad_s"] * 30 / np.pi,
        "left": columns["rack_force_n"] * 0.4 + 3,
        "right": columns["rack_force_n"] * 0.6 - 3,
        "iq": columns["motor_torque_nm"] / 0.047,
        "counts": np.floor(turns * 4096) % 4096,
        "tb": columns["torque_sensor_nm"] * 1e3,
    }
    rows = [
        ",".join([*map(repr, map(float, row)), "on"]) for row in zip(*theirs.values(), strict=True)
    ]
    mapped, mapping = tmp_path / "mapped.csv", tmp_path / "columns.yaml"
    mapped.write_text("\n".join([",".join([*theirs, "state"]), *rows]) + "\n", encoding="utf-8")
    mapping.write_text(TABLE, encoding="utf-8")
    errors = []
    for table, more in ((plain, []), (mapped, ["--signals", str(mapping)])):
        found: dict[str, Any] = {}
        for verb in ("estimate", "compare"):
            out = tmp_path / f"{verb}.json"
            words = [verb, str(table), "--model", MODEL, "--json", str(out), *more]
            assert main(words) == 0, capsys.readouterr().err
            found[verb] = json.loads(out.read_text(encoding="utf-8"))
        (one,) = found["estimate"]["recordings"]
        numbers = [one["rack_force_error_n"]["rms_moving"]]
        errors.append(numbers + [row["rmse_overall_n"] for row in found["compare"]["estimates"]])
    np.testing.assert_allclose(errors[1], errors[0], rtol=0.02)
    assert "columns left out: state" in capsys.readouterr().err
    assert main(["check", str(mapping)]) == 0
    mapping.write_text(TABLE.replace("sum:", "sums:"), encoding="utf-8")
    assert main(["check", str(mapping)]) == 2
    assert "sums: is not a known field" in capsys.readouterr().err


DERIVED = """
signals:
  motor_torque_nm: {message: EPS_Torques, signal: MotorTorque}
  torque_sensor_nm: {message: EPS_Torques, signal: TorsionBarTorque}
  motor_speed_rad_s: {derive_from: motor_angle_rad, window_s: WINDOW}
  motor_angle_rad: {message: EPS_MotorState, signal: MotorAngle}
  rack_force_n: {message: RIG_State, signal: RackForce}
"""


def test_a_derived_speeds_window_counts_in_every_way(tmp_path: Path, weave_truth: Any) -> None:
    """``estimate``, ``batch estimate`` and the Python API give the same estimates of a log."""
    import pyarrow.parquet

    import eps_hil
    from eps_hil.bus.codec import FrameEncoder
    from eps_hil.bus.database import load_database
    from eps_hil.estimation.settings import EstimatorSettings

    dbc = ROOT / "dbc" / "eps_rig.dbc"
    database = load_database([dbc])
    columns = weave_truth.columns
    names = {
        "EPS_MotorState": {"MotorAngle": "motor_angle_rad"},
        "EPS_Torques": {"MotorTorque": "motor_torque_nm", "TorsionBarTorque": "torque_sensor_nm"},
        "RIG_State": {"RackForce": "rack_force_n"},
    }
    encoders = {message: FrameEncoder(database, message) for message in names}
    lines = []
    for k in range(3000):
        t_ns = 1_700_000_000_000_000_000 + k * 1_000_000
        for message, signals in names.items():
            values = {signal: float(columns[name][k]) for signal, name in signals.items()}
            frame = encoders[message].frame(values, t_ns)
            stamp = f"({t_ns // 10**9}.{t_ns % 10**9 // 1000:06d})"
            lines.append(f"{stamp} can0 {frame.can_id:03X}#{frame.data.hex().upper()}")
    log = tmp_path / "logs" / "rig.log"
    log.parent.mkdir()
    log.write_text("\n".join(lines) + "\n", encoding="utf-8")
    found = {}
    for window in ("0.05", "0.02"):
        mapping = tmp_path / f"signals-{window}.yaml"
        mapping.write_text(DERIVED.replace("WINDOW", window), encoding="utf-8")
        reading = ["--dbc", str(dbc), "--signals", str(mapping), "--model", MODEL]
        out, batch = tmp_path / f"{window}.parquet", tmp_path / f"batch-{window}"
        assert main(["estimate", str(log), *reading, "--out", str(out)]) == 0
        words = ["batch", "estimate", str(log.parent), *reading, "--out", str(batch)]
        assert main([*words, "--processes", "1"]) == 0
        (row,) = pyarrow.parquet.read_table(batch / "results.parquet").to_pylist()
        read = eps_hil.load(log, dbc=dbc, signals=mapping)
        by_file, by_batch = (
            np.array(pyarrow.parquet.read_table(path)["rack_force_estimate_n"])
            for path in (out, batch / row["output"])
        )
        found[window] = eps_hil.estimate(read, MODEL).trace.rack_force_n
        np.testing.assert_array_equal(by_file, found[window])
        np.testing.assert_array_equal(by_batch, found[window])
        best = eps_hil.compare(read, MODEL).candidates[0].trace.rack_force_n
        np.testing.assert_array_equal(best, found[window])
        given = EstimatorSettings(speed_window_s=0.3)  # the mapping goes before
        other = eps_hil.estimate(read, MODEL, given).trace.rack_force_n
        np.testing.assert_array_equal(other, found[window])
    assert len(found["0.05"]) < len(found["0.02"])  # it looks further back


def test_simulate_says_what_it_takes_for_an_input_that_is_not_there(
    tmp_path: Path, weave_truth: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    table = {name: np.array(weave_truth.columns[name][:3000]) for name in NAMES}
    table["rack_force_n"][1000:] = np.nan
    table["torque_sensor_nm"][:] = np.nan
    table["motor_torque_nm"][500:1500] = np.inf
    path = tmp_path / "holes.csv"
    columns = np.column_stack(list(table.values()))
    np.savetxt(path, columns, delimiter=",", header=",".join(table), comments="", fmt="%.9g")
    words = ["simulate", "--model", MODEL, "--inputs", str(path), "--out", str(tmp_path / "s.csv")]
    assert main(words) == 2
    assert main([*words, "--gaps", "mark"]) == 0
    told = capsys.readouterr().err
    assert "motor_torque_nm: 1000 bad samples: drawn straight between the good ones" in told
    assert "motor_torque_nm: 1 gaps, the longest of 1 s at 0.499 s: drawn straight" in told
    assert "torque_sensor_nm has no good sample: taken as zero" in told
    assert "rack_force_n has no good sample" not in told


def test_a_time_in_ms_is_asked_for(
    tmp_path: Path, weave_truth: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    table = {name: weave_truth.columns[name][:2000] for name in NAMES}
    table["time_s"] = table["time_s"] * 1e3
    path = tmp_path / "ms.csv"
    columns = np.column_stack(list(table.values()))
    np.savetxt(path, columns, delimiter=",", header=",".join(table), comments="", fmt="%.9g")
    for verb in ("estimate", "compare"):
        assert main([verb, str(path), "--model", MODEL]) == 2
        said = capsys.readouterr().err
        assert "motor_speed_rad_s has a value every 1 s" in said
        assert "is the time in ms?" in said
