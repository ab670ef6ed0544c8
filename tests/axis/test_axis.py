"""The converter of the axis' recordings, on files of our own making: no real data is needed."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import savemat

from eps_hil.axis.emps import ARM_M, PULSE_GAIN, published_model, read
from eps_hil.axis.proof import balance_n
from eps_hil.cli.main import main
from eps_hil.errors import InputError

N = 6000
GTAU = 35.15


def _write(folder: Path, **changes: Any) -> Path:
    """Two files of a frictionless 95 kg axis that swings 2 cm at 0.5 Hz."""
    time = np.arange(N) * 1e-3
    swing = 2 * np.pi * 0.5
    position = 0.1 + 0.02 * np.sin(swing * time)
    force = -95.1089 * 0.02 * swing**2 * np.sin(swing * time)
    pulses = np.where((time % 2.0) > 1.0, 5, 0).astype(np.uint8)
    for name in ("DATA_EMPS.mat", "DATA_EMPS_PULSES.mat"):
        content = {"t": time, "qm": position, "vir": force / GTAU, "gtau": GTAU}
        if "PULSES" in name:
            content["pulses_N"] = pulses
        content |= changes
        savemat(folder / name, {key: value for key, value in content.items() if value is not None})
    return folder


def test_force_and_position_arrive_in_the_scale_that_is_stated(tmp_path: Path) -> None:
    fitted, heldout = read(_write(tmp_path))
    shown = fitted.series(free_of_load=True)
    angle = shown["motor_angle_rad"].value * ARM_M
    assert angle.max() == pytest.approx(0.02, rel=1e-3)
    assert angle.min() == pytest.approx(-0.02, rel=1e-3)
    assert shown["motor_torque_nm"].value.max() / ARM_M == pytest.approx(18.77, rel=1e-3)
    assert not shown["rack_force_n"].value.any()
    assert "rack_force_n" not in heldout.series()


def test_the_wave_is_taken_out_of_the_motors_force_and_opposes_it(tmp_path: Path) -> None:
    fitted, heldout = read(_write(tmp_path))
    assert heldout.hidden_force_n.min() == pytest.approx(-5 * PULSE_GAIN * GTAU)
    np.testing.assert_allclose(heldout.force_n - heldout.hidden_force_n, fitted.force_n)


def test_the_balance_finds_the_hidden_force_of_a_frictionless_axis(tmp_path: Path) -> None:
    from dataclasses import fields, replace

    _, heldout = read(_write(tmp_path))
    model = published_model()
    tiny = {one.name: 1e-9 for one in fields(model.friction)}
    free = replace(model, friction=replace(model.friction, **tiny))
    found = balance_n(heldout, free)
    middle = (np.arange(N) % 1000 > 300) & (np.arange(N) % 1000 < 700)
    middle[:500] = middle[-500:] = False
    np.testing.assert_allclose(found[middle], heldout.hidden_force_n[middle], atol=0.5)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"qm": None}, "qm: is missing"),
        ({"vir": np.zeros(7)}, "vir: has 7 samples"),
        ({"qm": np.full(N, np.nan)}, "qm: holds a value that is not finite"),
        ({"t": np.arange(N) * 2e-3}, "t: does not step by 1 ms"),
        ({"gtau": np.zeros(0)}, "gtau: is empty"),
        ({"qm": np.array(["a", "b"], dtype=object)}, "qm: holds no plain numbers"),
    ],
)
def test_a_file_of_another_shape_is_one_line(
    tmp_path: Path, changes: dict[str, Any], words: str
) -> None:
    with pytest.raises(InputError, match=words):
        read(_write(tmp_path, **changes))


def test_missing_data_says_where_to_get_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["prove", "emps", str(tmp_path)]) == 2
    said = capsys.readouterr().err.strip()
    assert len(said.splitlines()) == 1
    assert "nonlinearbenchmark.org" in said
    assert "DATA_EMPS.mat" in said


@pytest.mark.parametrize("cut", [None, 0, 64, 200])
def test_a_file_that_is_no_matlab_file_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], cut: int | None
) -> None:
    file = _write(tmp_path) / "DATA_EMPS.mat"
    file.write_bytes(b"time,force\n" * 40 if cut is None else file.read_bytes()[:cut])
    assert main(["prove", "emps", str(tmp_path)]) == 2
    said = capsys.readouterr().err
    assert said.startswith(f"eps-hil: {file}: is no MATLAB file: ")
    assert said.count("\n") == 1
