import builtins
import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from threading import Event, Thread
from typing import Any

import asammdf
import numpy as np
import pyarrow
import pyarrow.parquet
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from eps_hil.errors import InputError
from eps_hil.recordings.mf4_file import quiet
from eps_hil.recordings.read import SUFFIXES, read_recording
from eps_hil.recordings.write import write_table

DBC = Path(__file__).parents[2] / "dbc" / "eps_rig.dbc"
SIGNALS = Path(__file__).parents[2] / "configs" / "eps_rig_signals.yaml"


def _refused(path: Path, **options: Any) -> str:
    with pytest.raises(InputError) as caught:
        read_recording(path, **options)
    text = str(caught.value)
    assert text.startswith(str(path))
    assert "\n" not in text
    return text


def _parquet(path: Path, columns: Mapping[str, Any]) -> Path:
    pyarrow.parquet.write_table(pyarrow.table(dict(columns)), path)
    return path


@pytest.mark.parametrize("suffix", [*SUFFIXES, ".CSV", ".Blf"])
def test_missing_file_folder_and_empty_file(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    assert "no such file; check the path" in _refused(path, dbc=[DBC], signals=SIGNALS)
    path.touch()
    assert "is empty" in _refused(path, dbc=[DBC], signals=SIGNALS)
    path.unlink()
    path.mkdir()
    assert "is a folder" in _refused(path, dbc=[DBC], signals=SIGNALS)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_pipe_is_refused_and_not_waited_for(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    os.mkfifo(path)
    said = _refused(path, dbc=[DBC], signals=SIGNALS)
    assert "is a pipe, and a recording is read more than once; write it to a file" in said


def test_unreadable_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def forbidden(*_: object, **__: object) -> None:
        raise PermissionError

    monkeypatch.setattr(Path, "open", forbidden)
    assert "may not be read; check its permissions" in _refused(tmp_path / "a.csv")


@pytest.mark.parametrize("name", ["a.xlsx", "a", "a.csv.bak"])
def test_unknown_suffix_lists_the_known_ones(tmp_path: Path, name: str) -> None:
    assert "known: .csv, .parquet, .mf4, .log, .blf, .asc, .trc" in _refused(tmp_path / name)


@pytest.mark.parametrize(("suffix", "library"), [("parquet", "pyarrow"), ("mf4", "asammdf")])
def test_missing_extra_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, suffix: str, library: str
) -> None:
    real_import = builtins.__import__

    def without(name: str, *args: Any, **kwargs: Any) -> Any:
        if name.partition(".")[0] == library:
            raise ImportError(name)
        return real_import(name, *args, **kwargs)

    path = tmp_path / f"a.{suffix}"
    write_table(path, {"time_s": np.zeros(1), "rack_force_n": np.zeros(1)})
    monkeypatch.setattr(builtins, "__import__", without)
    assert f'pip install "eps_hil[{suffix}]"' in _refused(path)


def test_parquet_problems_name_row_and_column(tmp_path: Path) -> None:
    path = tmp_path / "a.parquet"
    time = [0.0, 1.0, 2.0]
    _parquet(path, {"time_s": time, "rack_force_n": ["a", "b", "c"]})
    assert "column rack_force_n: holds string, not numbers" in _refused(path)
    _parquet(path, {"time_s": time, "rack_force_n": [1.0, float("nan"), 2.0]})
    assert "row 2, column rack_force_n: is NaN or infinite" in _refused(path)
    _parquet(path, {"time_s": [0.0, 1.0, 0.5], "rack_force_n": time})
    assert "row 3, column time_s: time goes back" in _refused(path)
    _parquet(path, {"time_s": [0.0, None, 0.5], "rack_force_n": time})
    assert "row 2, column time_s: is empty" in _refused(path)
    _parquet(path, {"time_s": time, "rack_force": time})
    assert "rename it to rack_force_n" in _refused(path)
    _parquet(path, {"time_s": pyarrow.array([], pyarrow.float64()), "rack_force_n": time[:0]})
    assert "column rack_force_n: holds" in _refused(path) or "no rows" in _refused(path)


def test_parquet_integers_booleans_and_decimals_are_numbers(tmp_path: Path) -> None:
    columns = {
        "time_s": pyarrow.array([0, 1, 2], pyarrow.int32()),
        "rack_force_n": pyarrow.array([1, None, 3], pyarrow.int64()),
        "motor_torque_nm": pyarrow.array([1, 2, 3]).cast(pyarrow.decimal128(22, 3)),
        "valid": pyarrow.array([True, False, True]),
    }
    series = read_recording(_parquet(tmp_path / "a.parquet", columns)).series
    assert series["rack_force_n"].t_ns.tolist() == [0, 2_000_000_000]
    assert series["motor_torque_nm"].value.tolist() == [1.0, 2.0, 3.0]


def _mf4(path: Path, channels: Mapping[str, Any], time: list[float]) -> Path:
    with asammdf.MDF(version="4.10") as mdf:
        mdf.header.abs_time = 0
        for name, samples in channels.items():
            mdf.append(
                asammdf.Signal(np.array(samples), np.array(time), name=name, encoding="utf-8")
            )
        mdf.save(path, overwrite=True)
    return path


def test_mf4_problems_name_sample_and_channel(tmp_path: Path) -> None:
    path = tmp_path / "a.mf4"
    good = [1.0, 2.0, 3.0]
    _mf4(path, {"rack_force_n": [1.0, np.nan, 2.0]}, good)
    assert "sample 2, channel rack_force_n: is NaN" in _refused(path)
    marked = read_recording(path, gaps="mark")
    np.testing.assert_array_equal(marked.series["rack_force_n"].value, [1.0, np.nan, 2.0])
    assert marked.notes == ("channel rack_force_n: 1 bad samples marked",)
    _mf4(path, {"rack_force_n": good}, [0.0, 1.0, 1.0])
    assert "sample 3, channel rack_force_n: time repeats" in _refused(path)
    _mf4(path, {"rack_force_n": [b"a", b"b", b"c"]}, good)
    assert "channel rack_force_n: does not hold plain numbers" in _refused(path)
    _mf4(path, {"RackForce": good}, good)
    assert "rename it to rack_force_n" in _refused(path)
    _mf4(path, {"RackForce": good, "motor_torque_nm": good}, good)
    assert list(read_recording(path, ignore_unknown=True).series) == ["motor_torque_nm"]


def test_an_mf4_that_is_read_beside_others_leaves_our_output_alone(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Recordings are read side by side: the last reader to begin is not the last one to end."""
    begun, end = Event(), Event()

    def second() -> None:
        with quiet(), quiet():
            begun.set()
            print("asammdf's own")
            end.wait(10.0)

    streams = sys.stdout, sys.stderr
    thread = Thread(target=second)
    with quiet():
        print("asammdf's own")
        thread.start()
        assert begun.wait(10.0)
    print("a note")
    end.set()
    thread.join()
    assert (sys.stdout, sys.stderr) == streams
    assert capsys.readouterr() == ("a note\n", "")


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(content=st.binary(min_size=0, max_size=400), suffix=st.sampled_from(SUFFIXES))
@example(content=b"LOGG" + bytes(200), suffix=".blf")
@example(content=b"MDF     4.10    " + bytes(400), suffix=".mf4")
@example(content=b"PAR1" + bytes(40) + b"PAR1", suffix=".parquet")
@example(content=b"date Mon\nbase hex\n0.1 1 1 Rx d 9 xx\n", suffix=".asc")
@example(content=b";$FILEVERSION=2.1\n;$STARTTIME=x\n1 2 3\n", suffix=".trc")
@example(content=b"(1.0) can0 123#0", suffix=".log")
def test_random_bytes_are_refused_under_every_suffix(
    tmp_path_factory: pytest.TempPathFactory, content: bytes, suffix: str
) -> None:
    path = tmp_path_factory.mktemp("random") / f"a{suffix}"
    path.write_bytes(content)
    _refused(path, dbc=[DBC], signals=SIGNALS)
    _refused(path)


@settings(max_examples=40, deadline=None)
@given(cut=st.floats(0.0, 0.999), suffix=st.sampled_from((".csv", ".parquet", ".mf4")))
def test_truncated_table_is_read_or_refused(
    tmp_path_factory: pytest.TempPathFactory, cut: float, suffix: str
) -> None:
    folder = tmp_path_factory.mktemp("cut")
    whole, part = folder / f"whole{suffix}", folder / f"part{suffix}"
    time = np.arange(300) * 0.001
    write_table(whole, {"time_s": time, "rack_force_n": time, "motor_torque_nm": time})
    content = whole.read_bytes()
    part.write_bytes(content[: int(cut * len(content))])
    try:
        series = read_recording(part).series
    except InputError:
        return
    assert suffix == ".csv" or cut > 0.5  # Parquet and MF4 end with their index
    assert 0 < len(series["rack_force_n"].t_ns) <= 300


def test_no_table_loads_pandas(tmp_path: Path) -> None:
    """Where pyarrow is asked the wrong way it loads pandas: 40 MB for the whole run."""
    path = _parquet(tmp_path / "a.parquet", {"time_s": [0.0, 0.1, 0.2], "rack_force_n": [1, 2, 3]})
    rows = "".join(f"{k / 1000},{k / 7}\n" for k in range(10_000))
    (tmp_path / "a.csv").write_text(f"time_s,rack_force_n\n{rows}")
    program = (
        "import sys\n"
        "from eps_hil.recordings.read import read_recording\n"
        "for name in sys.argv[1:]:\n"
        "    read_recording(name)\n"
        "sys.exit('pandas' in sys.modules)\n"
    )
    words = [sys.executable, "-c", program, str(path), str(tmp_path / "a.csv")]
    subprocess.run(words, check=True)


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_two_clocks_that_say_something_else_are_told(tmp_path: Path, kind: str) -> None:
    path = tmp_path / f"a.{kind}"

    def notes(seconds: list[float], t_ns: list[int]) -> tuple[str, ...]:
        columns = {"time_s": seconds, "time_ns": t_ns, "motor_torque_nm": [1.0, 2.0, 3.0]}
        if kind == "parquet":
            _parquet(path, columns)
        else:
            rows = [",".join(map(str, row)) for row in zip(*columns.values(), strict=True)]
            path.write_text("\n".join([",".join(columns), *rows]) + "\n", encoding="utf-8")
        read = read_recording(path)
        assert read.series["motor_torque_nm"].t_ns.tolist() == t_ns
        return read.notes

    epoch = 1_757_617_431_821_276_124
    assert notes([0.0, 0.1, 0.2], [0, 100_000_000, 200_000_000]) == ()
    stamps = [epoch, epoch + 1_000_001, epoch + 2_000_003]
    assert notes([one / 1e9 for one in stamps], stamps) == ()
    said = "time_s and time_ns are up to 4.8 s apart: time_ns is taken"
    assert notes([0.0, 0.1, 5.0], [0, 100_000_000, 200_000_000]) == (said,)


def test_dates_and_durations_are_a_parquet_files_time(tmp_path: Path) -> None:
    for kind in ("datetime64[ns]", "timedelta64[us]"):
        name, _, unit = kind.partition("[")
        clock = np.array([0, 1000, 2500], f"{name}[ms]").astype(f"{name}[{unit}")
        path = _parquet(tmp_path / "a.parquet", {"time_s": clock, "motor_torque_nm": [1, 2, 3]})
        t_ns = read_recording(path).series["motor_torque_nm"].t_ns
        assert t_ns.tolist() == [0, 1_000_000_000, 2_500_000_000]


@pytest.mark.parametrize("kind", ["mf4", "parquet"])
@pytest.mark.parametrize(
    ("name", "unit", "said"),
    [
        ("motor_torque_nm", "mNm", "taken as Nm"),
        ("motor_speed_rad_s", "rpm", "taken as rad/s"),
        ("motor_temperature_degc", "K", "taken as degC"),
        ("motor_torque_nm", "N·m", ""),
        ("motor_temperature_degc", "[°C]", ""),
        ("lateral_acceleration_m_s2", "m/s²", ""),
        ("rack_force_n", "", ""),
    ],
)
def test_another_unit_in_the_file_is_told(
    tmp_path: Path, kind: str, name: str, unit: str, said: str
) -> None:
    path, times = tmp_path / f"a.{kind}", np.array([0.0, 1.0, 2.0])
    if kind == "mf4":
        with asammdf.MDF(version="4.10") as mdf:
            mdf.append([asammdf.Signal(np.ones(3), times, name=name, unit=unit)])
            mdf.save(path)
    else:
        field = pyarrow.field(name, pyarrow.float64(), metadata={"unit": unit} if unit else None)
        schema = pyarrow.schema([("time_s", pyarrow.float64()), field])
        table = pyarrow.table({"time_s": times, name: np.ones(3)}, schema=schema)
        pyarrow.parquet.write_table(table, path)
    notes = read_recording(path).notes
    if said:
        assert notes == (f"{name}: the file says that its unit is '{unit}': {said}",)
    else:
        assert notes == ()
