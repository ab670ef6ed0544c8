"""``import eps_hil``: the names a program needs, and results that tabulate and show themselves."""

import importlib.util
import json
import math
import re
import subprocess
import sys
import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import eps_hil
from eps_hil.api import jobs
from eps_hil.cli.main import main
from eps_hil.estimation.levels import LevelChange
from eps_hil.estimation.score import Score
from eps_hil.estimation.stream import Trace
from eps_hil.physics.model import Model
from eps_hil.recordings.read import read_recording
from eps_hil.series import Arrivals, Series

ROOT = Path(__file__).parents[2]
MODEL = ROOT / "configs" / "reference_rig.yaml"


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory, sweep_truth: Any) -> eps_hil.Recording:
    path = tmp_path_factory.mktemp("api") / "sweep.csv"
    columns = {name: values[:6000] for name, values in sweep_truth.columns.items()}
    table = np.column_stack(list(columns.values()))
    np.savetxt(path, table, delimiter=",", header=",".join(columns), comments="", fmt="%.9g")
    return eps_hil.load(path)


def test_importing_is_free_and_names_are_typed() -> None:
    code = (
        "import sys, eps_hil; heavy = {'numpy', 'numba', 'scipy', 'can', 'pydantic', 'typer'} "
        "& set(sys.modules); sys.exit(str(heavy) if heavy else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert (Path(eps_hil.__file__).parent / "py.typed").is_file()
    for name in eps_hil.__all__:
        assert getattr(eps_hil, name) is not None
        assert name in dir(eps_hil)
    assert eps_hil.Model is Model
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        eps_hil.nothing  # noqa: B018


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: eps_hil.estimate({"time_s": [0.0]}, MODEL), "type dict: is no recording"),  # type: ignore[arg-type]
        (lambda: eps_hil.load(b"drive.csv"), "a value of type bytes: is no recording"),  # type: ignore[arg-type]
        (lambda: eps_hil.load("drive.csv", gaps="x"), "gaps: is 'x'; 'refuse' or 'mark'"),
        (lambda: eps_hil.diagnose([], MODEL), "recordings: hold none; give one or several"),
        (lambda: eps_hil.identify(7, MODEL), "a value of type int: is no recording"),  # type: ignore[arg-type]
        (lambda: eps_hil.simulate(["a.csv"], MODEL), "a value of type list: is no recording"),  # type: ignore[arg-type]
    ],
)  # fmt: skip
def test_a_wrong_argument_is_one_line(call: Callable[[], object], said: str) -> None:
    with pytest.raises(eps_hil.InputError, match=re.escape(said)):
        call()


def test_where_a_computation_failed_is_shown_with_debug_alone(
    drive: eps_hil.Recording,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """What the arithmetic could not do is one line, and --debug says where it happened."""

    def fails_inside(*_given: object, **_named: object) -> None:
        raise np.linalg.LinAlgError("SVD did not converge")

    monkeypatch.setattr("eps_hil.diagnosis.diagnose.diagnose", fails_inside)
    with pytest.raises(eps_hil.InputError, match="SVD did not converge") as caught:
        eps_hil.diagnose(drive, MODEL)
    assert isinstance(caught.value.__cause__, np.linalg.LinAlgError)
    path = tmp_path / "drive.csv"
    columns: dict[str, Any] = {"time_s": next(iter(drive.series.values())).t_ns * 1e-9}
    columns |= {name: one.value for name, one in drive.series.items()}
    table = np.column_stack(list(columns.values()))
    np.savetxt(path, table, delimiter=",", header=",".join(columns), comments="", fmt="%.9g")
    words = ["diagnose", "--recording", str(path), "--model", str(MODEL)]
    assert main(words) == 2
    assert capsys.readouterr().err == f"eps-hil: {path}: SVD did not converge\n"
    assert main([*words, "--debug"]) == 2
    shown = capsys.readouterr().err
    assert "in fails_inside" in shown
    assert shown.endswith(f"eps-hil: {path}: SVD did not converge\n")


def test_settings_of_a_wrong_type(drive: eps_hil.Recording) -> None:
    with pytest.raises(eps_hil.InputError, match="settings: are of type dict"):
        eps_hil.estimate(drive, MODEL, {"dead_zone": False})  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"inertia_kg_m2": -1.0}, "model: inertia_kg_m2: Input should be greater than 0"),
        ({"delays_s": {"motor_speed": 0.004}}, "model: delays_s: are no Delays"),
    ],
)  # fmt: skip
def test_a_model_that_was_changed_is_looked_at(
    drive: eps_hil.Recording, wrong: dict[str, Any], said: str
) -> None:
    model = replace(Model.load(MODEL), **wrong)
    with pytest.raises(eps_hil.InputError, match=re.escape(said)):
        eps_hil.estimate(drive, model)


def test_a_model_that_was_changed_well_is_used(drive: eps_hil.Recording) -> None:
    model = Model.load(MODEL)
    heavier = replace(model, inertia_kg_m2=2.0 * model.inertia_kg_m2)
    changed = eps_hil.estimate(drive, heavier).trace.rack_force_n
    assert not np.array_equal(changed, eps_hil.estimate(drive, model).trace.rack_force_n)


def test_arrays_are_a_recording(drive: eps_hil.Recording) -> None:
    columns = {name: one.value for name, one in drive.series.items()}
    stamps = drive.series["motor_torque_nm"].t_ns
    made = eps_hil.recording({"time_ns": stamps, **columns}, "mine")
    assert made.name == "mine"
    ours, theirs = (eps_hil.estimate(each, MODEL).trace for each in (made, drive))
    assert np.array_equal(ours.rack_force_n, theirs.rack_force_n)
    again = eps_hil.recording(drive.to_dataframe("pandas"))
    assert again.series.keys() == drive.series.keys()


@pytest.mark.parametrize(
    ("t_ns", "value", "said"),
    [
        (np.arange(3), np.zeros(2), "as many values as stamps"),
        (np.arange(3.0), np.zeros(3), "stamps of float64 and values of float64"),
        (np.arange(3), np.zeros(3, int), "stamps of int64 and values of int64"),
        (np.array([0, 2, 1]), np.zeros(3), "stamps that do not increase"),
    ],
)
def test_signals_that_no_reader_would_make(t_ns: Any, value: Any, said: str) -> None:
    with pytest.raises((eps_hil.InputError, ValueError), match=said):
        eps_hil.Recording("mine", {"motor_torque_nm": Series(t_ns, value)})


def test_one_version() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert eps_hil.__version__ == project["version"]
    assert f"## {eps_hil.__version__}" in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")


def test_a_recording_is_a_table_a_figure_and_a_file(
    drive: eps_hil.Recording, tmp_path: Path
) -> None:
    frame = drive.to_dataframe("pandas")
    assert next(iter(frame.columns)) == "time_s"
    assert len(frame) == len(drive.series["motor_torque_nm"].t_ns)
    assert "motor_speed_rad_s" in drive._repr_html_()
    assert repr(drive) == f"<Recording {drive.name}: {len(drive.series)} signals, 6.0 s>"
    figure = drive.plot()
    assert figure._repr_png_().startswith(b"\x89PNG")
    assert [axis.get_ylabel() for axis in figure.axes] == [
        "rotor speed in rad/s", "motor torque in Nm", "torsion-bar torque in Nm", "rack force in N"
    ]  # fmt: skip
    again = read_recording(drive.save(tmp_path / "a.csv"))
    assert set(again.series) == set(drive.series)
    with pytest.raises(eps_hil.InputError, match="nothing: is not recorded; it holds "):
        drive.plot(["nothing"])


def test_an_estimate_is_what_the_verb_writes(drive: eps_hil.Recording, tmp_path: Path) -> None:
    made = eps_hil.estimate(drive, MODEL)
    drive.save(tmp_path / "drive.csv")
    out = tmp_path / "estimate.csv"
    words = ["estimate", str(tmp_path / "drive.csv"), "--model", str(MODEL), "--out", str(out)]
    assert main(words) == 0
    frame = made.to_dataframe("pandas")
    written = np.genfromtxt(out, delimiter=",", names=True)
    assert np.array_equal(frame["rack_force_estimate_n"], written["rack_force_estimate_n"])
    assert made.score is not None
    assert made.score.rmse_moving_n < 0.1 * made.score.rms_force_n
    assert made.content["rack_force_error_n"]["rms_moving"] == made.score.rmse_moving_n
    assert made.content["rows"] == len(made.trace.t_ns)
    assert made.save(tmp_path / "saved.csv").read_bytes() == out.read_bytes()
    assert "rms error moving" in made._repr_html_()
    assert repr(made).startswith("<Estimate of sweep.csv: ")
    assert len(repr(made)) < 100
    assert made.plot()._repr_png_().startswith(b"\x89PNG")


def test_a_simulation_is_what_the_verb_writes(drive: eps_hil.Recording, tmp_path: Path) -> None:
    model = Model.load(MODEL)
    made = eps_hil.simulate(drive, model)
    drive.save(tmp_path / "drive.csv")
    out = tmp_path / "simulated.csv"
    inputs = ["--inputs", str(tmp_path / "drive.csv"), "--out", str(out)]
    assert main(["simulate", "--model", str(MODEL), *inputs]) == 0
    written = np.genfromtxt(out, delimiter=",", names=True)
    speed = made.to_dataframe()["motor_speed_rad_s"]
    assert np.allclose(speed, written["motor_speed_rad_s"], rtol=0, atol=1e-12)
    assert made.plot()._repr_png_().startswith(b"\x89PNG")
    assert "simulated" in made._repr_html_()
    assert repr(made) == "<Simulation of sweep.csv: 6000 rows of 7>"
    bare = eps_hil.Recording("bare", {"rack_force_n": drive.series["rack_force_n"]})
    with pytest.raises(eps_hil.InputError, match=r"bare: .*needs motor_torque_nm"):
        eps_hil.simulate(bare, model)
    with pytest.raises(eps_hil.InputError, match="it holds rack_force_n"):
        eps_hil.estimate(bare, model)


def test_levels_that_were_taken_over_count_from_their_instant_on(
    drive: eps_hil.Recording,
) -> None:
    plain = eps_hil.estimate(drive, MODEL)
    middle = int(plain.trace.t_ns[len(plain.trace.t_ns) // 2])
    change = LevelChange(middle, 0.2, 0.3)
    made = eps_hil.estimate(drive, MODEL, changes=[change])
    before = (
        plain.trace.t_ns < middle - 100_000_000
    )  # a row speaks of an instant before it was known
    force, other = plain.trace.rack_force_n, made.trace.rack_force_n
    assert np.array_equal(force[before], other[before], equal_nan=True)
    assert not np.array_equal(force[~before], other[~before], equal_nan=True)
    late = LevelChange(int(plain.trace.t_ns[-1]) + 10**12, 0.2, 0.3)
    same = eps_hil.estimate(drive, MODEL, changes=[late]).trace.rack_force_n
    assert np.array_equal(force, same, equal_nan=True)


def test_a_comparison_judges_the_variants(drive: eps_hil.Recording) -> None:
    found = eps_hil.compare(drive, MODEL)
    frame = found.to_dataframe("pandas").set_index("estimate")
    assert frame.loc["2Q-fa", "rmse_moving_n"] < frame.loc["w/o FC", "rmse_moving_n"]
    assert "2Q-fa" in found._repr_html_()
    assert repr(found).startswith("<Comparison on sweep.csv, rms error moving in N: 2Q-fa ")
    assert found.plot()._repr_png_().startswith(b"\x89PNG")


def test_a_comparison_takes_settings_and_late_frames_as_an_estimate_does(
    drive: eps_hil.Recording, tmp_path: Path
) -> None:
    """Frames that waited 0.3 s are as little valid in a comparison as live."""
    slow = tmp_path / "slow.yaml"
    slow.write_text("stale_after_s: 0.05\n")
    sample_ns = drive.series["motor_speed_rad_s"].t_ns
    receive_ns = sample_ns.copy()
    receive_ns[2000:2300] = receive_ns[2300]
    held_up = replace(drive, arrivals=Arrivals(receive_ns, sample_ns, np.zeros_like(sample_ns)))
    found = eps_hil.compare(held_up, MODEL, slow).candidates[0].trace
    alone = eps_hil.estimate(held_up, MODEL, slow).trace
    assert np.array_equal(found.reason, alone.reason)
    assert found.valid.sum() < eps_hil.estimate(drive, MODEL, slow).trace.valid.sum()
    with pytest.raises(eps_hil.InputError, match="settings: are of type int"):
        eps_hil.compare(drive, MODEL, 5)  # type: ignore[arg-type]


def test_a_model_is_read_and_written(tmp_path: Path) -> None:
    model = eps_hil.Model.load(MODEL)
    model.save(tmp_path / "m.yaml")
    assert eps_hil.Model.load(tmp_path / "m.yaml") == model


def test_polars_or_a_word_on_what_is_missing(
    drive: eps_hil.Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    polars = ModuleType("polars")
    polars.DataFrame = lambda columns: ("polars", *columns)  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "polars", polars)
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name: True if name == "polars" else None
    )
    assert set(drive.to_dataframe()) == {"polars", "time_s", *drive.series}
    with pytest.raises(eps_hil.InputError, match="needs pandas; pip install pandas"):
        drive.to_dataframe("pandas")
    with pytest.raises(eps_hil.InputError, match="'excel' is none; pandas or polars"):
        drive.to_dataframe("excel")


def test_files_of_one_name_are_called_by_their_paths(
    drive: eps_hil.Recording, tmp_path: Path
) -> None:
    paths = [tmp_path / folder / "run.csv" for folder in "abc"]
    for path in paths:
        path.parent.mkdir()
        drive.save(path)
    for groups in ((paths,), (paths[:2], paths[2])):
        read = jobs._groups(*groups)
        assert [one.name for each in read for one in each] == list(map(str, paths))
    assert [one.name for one in jobs._groups([paths[0], drive])[0]] == ["run.csv", "sweep.csv"]
    with pytest.raises(eps_hil.InputError, match=r"a/run.csv: is given twice"):
        eps_hil.identify([paths[0], paths[0]], MODEL)


@pytest.mark.slow
def test_identify_and_diagnose_give_typed_results(other_rig: ModuleType, tmp_path: Path) -> None:
    plant = {other_rig.STRIB: 0.03, other_rig.STRIB_W: 10.0}
    drives = []
    for k, manoeuvre in enumerate(("sweep", "weave")):
        columns = other_rig.record(other_rig.Effects(plant), manoeuvre, k, 1.0, 15.0)
        path = tmp_path / f"{manoeuvre}.csv"
        table = np.column_stack(list(columns.values()))
        np.savetxt(path, table, delimiter=",", header=",".join(columns), comments="", fmt="%.9g")
        drives.append(eps_hil.load(path, ignore_unknown=True))
    with pytest.raises(eps_hil.InputError, match=r"sweep.csv: is given twice"):
        eps_hil.diagnose([drives[0], drives[0]], MODEL)
    with pytest.raises(eps_hil.InputError, match="'stribek' is no effect"):
        eps_hil.diagnose(drives, MODEL, without_effects=["stribek"])
    found = eps_hil.diagnose(drives, MODEL)
    assert found.verdict == found.content["verdict"]
    assert "stribeck" in [one.effect for one in found.findings]
    assert {"effect", "parameter", "low", "high"} <= set(found.to_dataframe("pandas").columns)
    assert "stribeck" in found._repr_html_()
    assert repr(found).startswith("<Diagnosis: ")
    assert "stribeck" in repr(found)
    figure = found.plot()
    assert figure._repr_png_().startswith(b"\x89PNG")
    assert [axis.get_title() for axis in figure.axes] == [
        "NRMSE of the torque residual", "fit of the simulated speed, %",
        "error of the rack-force estimate, moving, N",
    ]  # fmt: skip
    assert "stribeck" in [entry["effect"] for entry in found.model.effects]
    assert found.report(tmp_path / "page.html").stat().st_size > 10_000
    told = eps_hil.identify(drives, MODEL)
    assert "inertia_kg_m2" in list(told.to_dataframe("pandas")["parameter"])
    assert isinstance(told.model, Model)
    assert "inertia_kg_m2" in told._repr_html_()
    assert repr(told).startswith("<Identification from sweep.csv, weave.csv: ")
    assert told.plot()._repr_png_().startswith(b"\x89PNG")
    assert told.report(tmp_path / "identified.html").stat().st_size > 10_000


def test_no_holdouts_are_none_and_not_a_mistake() -> None:
    one = eps_hil.recording({"time_s": [0.0, 0.1], "rack_force_n": [1.0, 2.0]})
    assert jobs._groups(one, ()) == [[one], []]
    with pytest.raises(eps_hil.EpsHilError, match="recordings: hold none"):
        jobs._groups(())


def test_a_recording_without_a_sample_is_refused() -> None:
    none = Series(np.empty(0, np.int64), np.empty(0))
    with pytest.raises(eps_hil.InputError, match="r: motor_speed_rad_s: holds no sample"):
        eps_hil.Recording("r", {"motor_speed_rad_s": none})


def test_what_an_estimate_does_not_have_is_none_in_its_content() -> None:
    """A smoother has no latency; without a sample that moves there is no error of it."""
    one = np.array([0.0])
    read = eps_hil.recording({"time_s": [0.0, 0.1], "motor_torque_nm": [0.0, 0.1]})
    trace = Trace(np.array([0], np.int64), one, one, np.array([0], np.int64))
    score = Score(math.nan, math.nan, math.nan, math.nan, 0, math.nan)
    found = eps_hil.Estimate(read, Model.load(MODEL), trace, score, math.nan).content
    assert json.loads(json.dumps(found, allow_nan=False)) == found
    assert found["latency_s"] is None
