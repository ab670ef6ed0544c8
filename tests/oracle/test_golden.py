"""A golden replay differs when an estimate does, says where, and refuses what is no golden."""

import gzip
import hashlib
import json
import os
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from eps_hil.bus.codec import FrameEncoder
from eps_hil.bus.database import load_database
from eps_hil.cli.main import main
from eps_hil.errors import InputError
from eps_hil.oracle import golden
from eps_hil.oracle.golden import DEFAULT_TOLERANCES, Estimates, compare, parse_tolerances
from eps_hil.oracle.golden_file import Golden, read_golden, write_golden
from eps_hil.rig.config import load_rig_setup
from eps_hil.rig.process import RigSimulation

ROOT = Path(__file__).parents[2]
SECONDS = 3


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log of the simulated rig with a service's own frames in it, configuration, golden."""
    place = tmp_path_factory.mktemp("golden")
    shutil.copy(ROOT / "configs" / "reference_rig.yaml", place / "model.yaml")
    config = place / "service.yaml"
    config.write_text(
        "bus: {interface: virtual, channel: golden-test}\n"
        f"dbc: [{ROOT}/dbc/eps_rig.dbc]\nsignals: {ROOT}/configs/eps_rig_signals.yaml\n"
        "model: model.yaml\nrig: {manoeuvre: weave}\n"
    )
    rig = RigSimulation(load_rig_setup(config))
    own = FrameEncoder(load_database([ROOT / "dbc" / "eps_rig.dbc"]), "EPSHIL_Estimate")
    with (place / "drive.log").open("w") as log:
        for k in range(1000 * SECONDS):
            for frame in [*rig.step(0), own.frame({"RackForceEstimate": 1.0})]:
                stamp = 1_790_000_000.0 + k * 1e-3
                log.write(f"({stamp:.6f}) can0 {frame.can_id:03X}#{frame.data.hex().upper()}\n")
    words = ["golden", "make", str(place / "drive.log"), "--config", str(config)]
    assert main([*words, "--out", str(place / "golden.csv")]) == 0
    return place


@pytest.fixture
def folder(bench: Path, tmp_path: Path) -> Path:
    """A copy that a test may change; everything is found by the golden's own paths."""
    return Path(shutil.copytree(bench, tmp_path / "moved"))


def test_nothing_changed_nothing_differs_bit_for_bit(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    golden = read_golden(folder / "golden.csv")
    assert golden.estimates.t_ns.size > 900 * SECONDS
    assert golden.estimates.valid.mean() > 0.8
    assert golden.provenance.own_frames == 1000 * SECONDS
    zero = [f"--tolerance={name}=0" for name in DEFAULT_TOLERANCES]
    assert main(["golden", "check", str(folder / "golden.csv"), *zero]) == 0
    said = capsys.readouterr().out
    assert "golden.csv: within tolerance" in said
    assert "changed since then" not in said


def test_another_model_shows_by_place_and_size(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """1 % more inertia: the table says first and worst place in s and N, the status says 1."""
    model = folder / "model.yaml"
    model.write_text(model.read_text().replace("2.0e-4 ", "2.02e-4 "))
    out, golden = folder / "diff.json", str(folder / "golden.csv")
    assert main(["golden", "check", golden, "--json", str(out)]) == 1
    told = capsys.readouterr()
    assert "golden.csv: DIFFERS" in told.out
    assert "changed since then: model" in told.out
    assert "1 of 1 golden replays differ" in told.err
    assert told.err.count("\n") == 1
    (found,) = json.loads(out.read_text())["goldens"]
    force = found["signals"][0]
    assert force["signal"] == "rack_force_estimate_n"
    assert 0.0 <= force["first_s"] < SECONDS
    assert force["worst"] > 0.5
    assert force["rms"] < force["worst"]
    wide = f"--tolerance=rack_force_estimate_n={force['worst'] + 1e-6!r}"
    others = ["--tolerance=friction_torque_nm=1", "--tolerance=estimate_age_s=1"]
    assert main(["golden", "check", golden, *others, wide]) == 0
    close = f"--tolerance=rack_force_estimate_n={force['worst'] - 1e-6!r}"
    assert main(["golden", "check", golden, *others, close]) == 1


def test_a_setting_that_costs_validity_shows_as_such(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A signal that the decoder no longer believes: the rows that went invalid are told."""
    signals = (ROOT / "configs" / "eps_rig_signals.yaml").read_text()
    old = "EPS_Torques: {counter: Counter, crc: Crc, crc_profile: e2e_p01, clock: counter}"
    assert old in signals
    (folder / "signals.yaml").write_text(signals.replace(old, old[:-1] + ", crc_data_id: 7}"))
    config = folder / "service.yaml"
    text = config.read_text().replace(f"{ROOT}/configs/eps_rig_signals.yaml", "signals.yaml")
    config.write_text(text)
    assert main(["golden", "check", str(folder / "golden.csv")]) == 1
    said = capsys.readouterr().out
    assert "no estimate is valid both then and now: nothing was compared" in said
    assert "rows differ, first at" in said
    assert "changed since then: configuration, signals" in said


def test_several_goldens_are_checked_and_all_named(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    golden = read_golden(folder / "golden.csv")
    shifted = golden.estimates.values["rack_force_estimate_n"].copy()
    shifted[1_500] += 5.0
    values = {**golden.estimates.values, "rack_force_estimate_n": shifted}
    other = replace(golden, estimates=replace(golden.estimates, values=values))
    write_golden(folder / "other.csv.gz", other)
    assert gzip.decompress((folder / "other.csv.gz").read_bytes()).startswith(b"# eps-hil/golden/1")
    paths = [str(folder / "golden.csv"), str(folder / "other.csv.gz")]
    assert main(["golden", "check", *paths]) == 1
    told = capsys.readouterr()
    assert "golden.csv: within tolerance" in told.out
    assert f"1 of 2 golden replays differ: {paths[1]}" in told.err
    at_s = (golden.estimates.t_ns[1_500] - golden.estimates.t_ns[0]) * 1e-9
    assert f"{at_s:.3f} s" in told.out
    assert "1 of " in told.out


def test_a_log_is_hashed_in_pieces(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A log of a day is larger than the memory."""

    def whole(_path: Path) -> bytes:
        raise AssertionError

    log = tmp_path / "bus.log"
    log.write_bytes(bytes(range(256)) * 4096)
    expected = hashlib.sha256(log.read_bytes()).hexdigest()
    monkeypatch.setattr(Path, "read_bytes", whole)
    assert golden._sha256(log) == expected
    with pytest.raises(InputError, match="cannot be read: No such file"):
        golden._sha256(tmp_path / "none.log")


def test_what_is_written_is_read_back_bit_for_bit(folder: Path) -> None:
    golden = read_golden(folder / "golden.csv")
    odd = golden.estimates.values["friction_torque_nm"].copy()
    odd[:3] = np.nan, 1 / 3, -0.0
    values = {**golden.estimates.values, "friction_torque_nm": odd}
    write_golden(
        folder / "x.csv", replace(golden, estimates=replace(golden.estimates, values=values))
    )
    again = read_golden(folder / "x.csv")
    assert again.provenance == golden.provenance
    assert again.estimates.t_ns.tobytes() == golden.estimates.t_ns.tobytes()
    assert again.estimates.values["friction_torque_nm"].tobytes() == odd.tobytes()


def estimates(force: list[float], reason: list[int], first: int = 0) -> Estimates:
    t_ns = (np.arange(len(force), dtype=np.int64) + first) * 1_000_000
    zero = np.zeros(len(force))
    values = {
        "rack_force_estimate_n": np.array(force),
        "friction_torque_nm": zero,
        "estimate_age_s": zero,
    }
    return Estimates(t_ns, values, np.array(reason, dtype=np.int64))


def test_only_what_is_valid_on_both_sides_is_compared_by_value() -> None:
    golden = estimates([1.0, 2.0, 3.0, 4.0], [0, 0, 4, 0])
    now = estimates([1.5, 900.0, 900.0, 2.0], [0, 8, 4, 0])
    diff = compare(golden, now, {**DEFAULT_TOLERANCES, "rack_force_estimate_n": 1.0})
    force = diff.signals[0]
    assert (force.rows, force.beyond, force.first_s, force.first) == (2, 1, 0.003, (4.0, 2.0))
    assert (force.worst, force.worst_s) == (2.0, 0.003)
    assert force.rms == pytest.approx(np.sqrt((0.25 + 4.0) / 2))
    assert (diff.reason.differ, diff.reason.first_s, diff.reason.first) == (1, 0.001, (0, 8))
    assert not diff.good


def test_a_stamp_that_came_twice_is_no_difference() -> None:
    one = estimates([1.0, 2.0, 3.0], [0, 0, 0])
    twice = replace(one, t_ns=np.array([0, 0, 1_000_000], dtype=np.int64))
    assert compare(twice, twice, DEFAULT_TOLERANCES).good


def test_rows_of_one_side_and_no_common_rows() -> None:
    golden = estimates([1.0, 2.0, 3.0], [0, 0, 0])
    diff = compare(golden, estimates([2.0, 3.0, 4.0, 5.0], [0] * 4, first=1), DEFAULT_TOLERANCES)
    assert (diff.reason.only_golden, diff.reason.only_now, diff.good) == (1, 2, False)
    assert compare(
        golden,
        estimates([2.0, 3.0, 4.0, 5.0], [0] * 4, first=1),
        {**DEFAULT_TOLERANCES, "reason_rows": 3.0},
    ).good
    apart = compare(golden, estimates([1.0], [0], first=9), dict.fromkeys(DEFAULT_TOLERANCES, 1e9))
    assert (apart.both_valid, apart.good) == (0, False)


def test_a_value_that_is_no_number_any_more_is_beyond_every_tolerance() -> None:
    diff = compare(
        estimates([1.0, 2.0], [0, 0]),
        estimates([1.0, np.nan], [0, 0]),
        {**DEFAULT_TOLERANCES, "rack_force_estimate_n": 1e6},
    )
    assert (diff.signals[0].beyond, diff.good) == (1, False)


def test_tolerances_have_names_and_numbers() -> None:
    found = parse_tolerances(["rack_force_estimate_n=5"], DEFAULT_TOLERANCES)
    assert found == {**DEFAULT_TOLERANCES, "rack_force_estimate_n": 5.0}
    for word in ("force=5", "rack_force_estimate_n", "reason_rows=-1", "reason_rows=x"):
        with pytest.raises(InputError, match="--tolerance"):
            parse_tolerances([word], DEFAULT_TOLERANCES)


def test_what_is_no_golden_is_status_2_and_one_line(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    golden = folder / "golden.csv"
    lines = golden.read_text().splitlines(keepends=True)
    wrong = {
        "nowhere.csv": (None, "no such file"),
        "empty.csv": ("", "is empty"),
        "prose.csv": ("hello\n", "line 1: does not begin with"),
        "head.csv": ("# eps-hil/golden/1 {}\n" + "".join(lines[1:]), "line 1: is damaged"),
        "names.csv": (lines[0] + "a,b\n" + "".join(lines[2:]), "line 2: is not t_ns,"),
        "rows.csv": ("".join(lines[:9]) + "1,2,x,4,5\n", "table: is damaged"),
        "none.csv": ("".join(lines[:2]), "line 3: holds no estimates"),
        "packed.csv.gz": ("".join(lines), "is damaged"),
    }
    for name, (text, said) in wrong.items():
        path = folder / name
        if text is not None:
            path.write_text(text)
        assert main(["golden", "check", str(golden), str(path)]) == 2, name
        told = capsys.readouterr()
        assert said in told.err
        assert told.err.startswith(f"error: {path}") or str(path) in told.err
        assert told.err.count("\n") == 1
        assert told.out == "", "no golden is run before all are read"


def test_another_log_is_refused(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = folder / "drive.log"
    log.write_text("".join(log.read_text().splitlines(keepends=True)[:-1]))
    assert main(["golden", "check", str(folder / "golden.csv")]) == 2
    assert "is not the log that" in capsys.readouterr().err
    os.remove(log)
    assert main(["golden", "check", str(folder / "golden.csv")]) == 2
    assert "drive.log: no such file; name the log with --log" in capsys.readouterr().err


def test_make_refuses_what_would_prove_nothing(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["golden", "make", str(folder / "drive.log"), "--config", str(folder / "service.yaml")]
    assert main([*words, "--out", str(folder / "golden.csv")]) == 2
    assert "exists already; add --overwrite" in capsys.readouterr().err
    assert main([*words, "--out", str(folder / "golden.txt")]) == 2
    assert "is neither .csv nor .csv.gz" in capsys.readouterr().err
    short = folder / "short.log"
    short.write_text("".join((folder / "drive.log").read_text().splitlines(keepends=True)[:40]))
    words[2] = str(short)
    assert main([*words, "--out", str(folder / "y.csv")]) == 2
    assert "gives no valid estimate" in capsys.readouterr().err
    assert not (folder / "y.csv").exists()


def test_a_figure_of_the_difference(folder: Path) -> None:
    pytest.importorskip("matplotlib")
    figure = folder / "golden.png"
    words = ["golden", "check", str(folder / "golden.csv"), "--figure", str(figure)]
    assert main(words) == 0
    assert figure.stat().st_size > 5_000


def test_a_golden_is_of_the_type_that_is_read(bench: Path) -> None:
    assert isinstance(read_golden(bench / "golden.csv"), Golden)
