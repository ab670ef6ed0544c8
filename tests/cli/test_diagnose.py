"""What ``diagnose`` says to recordings and options it cannot use: one line, before any work."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

from eps_hil.cli.main import main
from eps_hil.physics.model import load_model

MODEL = str(Path(__file__).parents[2] / "configs" / "reference_rig.yaml")
Write = Callable[..., str]


@pytest.fixture(scope="module")
def columns(other_rig: ModuleType) -> Mapping[str, np.ndarray]:
    made: Mapping[str, np.ndarray] = other_rig.record(other_rig.Effects({}), "weave", 1, 1.0, 8.0)
    return made


@pytest.fixture
def write(tmp_path: Path, columns: Mapping[str, np.ndarray]) -> Write:
    """``write(name, without=…, rest=…, seconds=…, times=…)`` -> path of a recording."""

    def made(
        name: str,
        without: Sequence[str] = (),
        rest: bool = False,
        seconds: float = 8.0,
        times: Mapping[str, float] | None = None,
    ) -> str:
        path = tmp_path / f"{name}.csv"
        kept = {key: one[: round(1000 * seconds)] for key, one in columns.items()}
        if rest:
            kept = {k: one if k == "time_s" else 0.0 * one + one[0] for k, one in kept.items()}
        kept = {key: one * (times or {}).get(key, 1.0) for key, one in kept.items()}
        shown = {key: one for key, one in kept.items() if key not in without}
        table = np.column_stack(list(shown.values()))
        header = ",".join(shown)
        np.savetxt(path, table, delimiter=",", header=header, comments="", fmt="%.9g")
        return str(path)

    return made


def _refused(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    assert main(["diagnose", "--model", MODEL, *words]) == 2
    shown = capsys.readouterr()
    assert shown.err.count("\n") == 1
    assert shown.out == ""
    return shown.err


def test_the_recording_that_lacks_a_signal_is_named(
    write: Write, capsys: pytest.CaptureFixture[str]
) -> None:
    good = write("good")
    lacks = write("lacks", without=["motor_torque_nm"])
    said = _refused(capsys, "--recording", good, lacks)
    assert f"{lacks}: a diagnosis needs motor_torque_nm (it holds " in said
    assert good not in said
    still = write("still", without=["motor_speed_rad_s", "motor_angle_rad"])
    assert "motor_angle_rad" in _refused(capsys, "--recording", good, still)


def test_a_short_holdout_is_named(write: Write, capsys: pytest.CaptureFixture[str]) -> None:
    short = write("short", seconds=1.5)
    said = _refused(capsys, "--recording", write("good"), "--holdout", short)
    assert said.startswith(f"eps-hil: {short}: is shorter than 2 s")


def test_a_load_cell_in_some_recordings_only_is_refused(
    write: Write, capsys: pytest.CaptureFixture[str]
) -> None:
    """It would be left aside in all of them, and hide what the others show."""
    without = write("without", without=["rack_force_n"])
    said = _refused(capsys, "--recording", write("good"), "--holdout", without)
    assert f"{without}: has no rack_force_n, but others have" in said


@pytest.mark.parametrize(
    ("column", "factor", "words"),
    [
        ("torque_sensor_nm", -1.0, "torque_sensor_nm has the wrong sign; turn it"),
        ("motor_torque_nm", 1e3, "motor_torque_nm: is about 1000 times too large: in mNm"),
        ("time_s", 1e3, "motor_torque_nm: a value every 1 s, 7999 s (2.22 h) in all"),
    ],
)
def test_a_column_that_is_not_what_its_name_says_is_named(
    write: Write, capsys: pytest.CaptureFixture[str], column: str, factor: float, words: str
) -> None:
    wrong = write("wrong", times={column: factor})
    said = _refused(capsys, "--recording", write("good"), wrong)
    assert said.startswith(f"eps-hil: {wrong}: {words}")


def test_a_recording_does_not_judge_itself(
    write: Write, capsys: pytest.CaptureFixture[str]
) -> None:
    good = write("good")
    other = str(Path(good).parent / ".." / Path(good).parent.name / Path(good).name)
    for same in (good, other):
        said = _refused(capsys, "--recording", good, "--holdout", same)
        assert "is recording and hold-out" in said


def test_the_model_is_written_even_if_the_page_cannot_be(
    write: Write, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What took minutes to find is not lost with a picture."""
    import eps_hil
    from eps_hil.cli import diagnose
    from eps_hil.report import diagnosis_page

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device", "page.html")

    found = replace(load_model(MODEL), inertia_kg_m2=2e-4)
    told = SimpleNamespace(result=SimpleNamespace(content={}, model=found))
    monkeypatch.setattr(eps_hil, "diagnose", lambda *_, **__: told)
    monkeypatch.setattr(diagnose, "_say", lambda _: None)
    monkeypatch.setattr(diagnosis_page, "write", full)
    written = tmp_path / "written.yaml"
    page = str(tmp_path / "page.html")
    words = ["--recording", write("good"), "--report", page, "--write-model", str(written)]
    assert main(["diagnose", "--model", MODEL, *words]) != 0
    assert load_model(written).inertia_kg_m2 == found.inertia_kg_m2


def test_a_reader_that_went_away_takes_no_file_with_it(
    write: Write, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As of ``eps-hil diagnose … --json found.json | head -1``."""
    import eps_hil
    from eps_hil.cli import changes, diagnose, identify

    def gone(_: object) -> None:
        raise BrokenPipeError

    told = SimpleNamespace(content=lambda: {"by": "identify"}, model=load_model(MODEL))
    diagnosed = SimpleNamespace(content={"by": "diagnose"}, model=told.model)
    changed = SimpleNamespace(after=SimpleNamespace(content={"by": "changes"}), model=told.model)
    monkeypatch.setattr(eps_hil, "identify", lambda *_, **__: SimpleNamespace(result=told))
    monkeypatch.setattr(eps_hil, "diagnose", lambda *_, **__: SimpleNamespace(result=diagnosed))
    monkeypatch.setattr("eps_hil.diagnosis.changes.changes", lambda *_: changed)
    monkeypatch.setattr("eps_hil.identification.write_model.model_file", lambda *_: "model: {}")
    one, other = write("one"), write("other")
    for verb, words in (
        (identify, [one]),
        (diagnose, ["--recording", one]),
        (changes, ["--before", one, "--after", other]),
    ):
        monkeypatch.setattr(verb, "_say", gone)
        name = verb.__name__.rpartition(".")[2]
        out, model = tmp_path / f"{name}.json", tmp_path / f"{name}.yaml"
        given = ["--model", MODEL, "--json", str(out), "--write-model", str(model)]
        assert main([name, *words, *given]) == 1
        assert json.loads(out.read_text())["by"] == name
        assert model.is_file()


@pytest.mark.slow
def test_a_holdout_at_rest_judges_nothing(write: Write, capsys: pytest.CaptureFixture[str]) -> None:
    rest = write("rest", rest=True)
    said = _refused(capsys, "--recording", write("good"), "--holdout", rest)
    assert f"{rest}: kept from the fit to judge it, but slides for less than 1 s" in said


@pytest.mark.parametrize("option", ["--json", "--report", "--write-model", "--write-manoeuvre"])
def test_a_file_that_cannot_be_written_is_told_first(
    option: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The recording is not even looked for."""
    target = str(tmp_path / "none" / "out.file")
    said = _refused(capsys, "--recording", "none.csv", option, target)
    assert "does not exist; create it first" in said
    said = _refused(capsys, "--recording", "none.csv", option, str(tmp_path))
    assert "is a folder" in said
    assert list(tmp_path.iterdir()) == []


def test_a_mapping_without_traces_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    said = _refused(capsys, "--recording", "none.csv", "--simulation-signals", "m.yaml")
    assert "goes with --simulation" in said


def test_an_effect_needs_a_name_of_its_own(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, words in (("my-effect.py", "names no effect"), ("stribeck.py", "has 'stribeck'")):
        path = str(tmp_path / name)
        assert words in _refused(capsys, "--recording", "x.csv", "--write-effect", path)
