"""``eps-hil frequency-response`` on a short recording of the simulated rig."""

import json
from pathlib import Path

import numpy as np
import pytest

from eps_hil.cli.main import main
from eps_hil.physics.chain_parameters import load_chain
from eps_hil.physics.model import load_model
from eps_hil.recordings.write import write_table
from eps_hil.rig.manoeuvre import load_manoeuvre
from eps_hil.rig.offline import simulate_recording

ROOT = Path(__file__).parents[2]
MODEL = str(ROOT / "configs" / "reference_rig.yaml")
CHAIN = str(ROOT / "configs" / "reference_chain.yaml")
MANOEUVRE = """
manoeuvre:
  name: short
  segments:
    - duration_s: 12.0
      rig: {stiffness_n_per_m: 200000.0, damping_n_s_per_m: 20000.0}
      motor: {torque_nm: {multisine: {rms: 0.4, from_hz: 0.5, to_hz: 8.0, lines: 30}}}
"""


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("response")
    (folder / "short.yaml").write_text(MANOEUVRE, encoding="utf-8")
    made = simulate_recording(
        load_model(MODEL), load_chain(CHAIN), load_manoeuvre(folder / "short.yaml")
    )
    write_table(folder / "short.csv", made.columns)
    return folder / "short.csv"


def test_measured_and_models(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    numbers, picture = tmp_path / "r.json", tmp_path / "r.png"
    words = ["frequency-response", str(recording), "--model", MODEL, "--chain", CHAIN]
    words += ["--masses", "2", "--masses", "5", "--resolution-hz", "0.5"]
    words += ["--load-stiffness", "200000", "--load-damping", "20000"]
    assert main([*words, "--json", str(numbers), "--out", str(picture)]) == 0
    said = capsys.readouterr()
    assert "rotor speed" in said.out
    assert said.err == ""
    content = json.loads(numbers.read_text())
    assert content["schema"] == "eps-hil/frequency-response/1"
    assert set(content["models"]) == {"2", "5"}
    own = {each["output"]: each for each in content["agreement"] if each["order"] == 5}
    assert max(each["gain_error"] for each in own.values()) < 0.01
    one = content["measured"]["motor_speed_rad_s"]
    assert one["frequency_hz"][0] == 0.5
    assert np.median(one["coherence"]) > 0.9
    assert picture.stat().st_size > 10_000


def test_without_a_chain_only_what_was_measured(
    recording: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["frequency-response", str(recording), "--model", MODEL]
    assert main([*words, "--estimator", "hv"]) == 0
    assert "masses" not in capsys.readouterr().out


def test_the_same_recording_twice_is_refused(
    recording: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It counted as two, and made every band too narrow."""
    assert main(["frequency-response", str(recording), str(recording), "--model", MODEL]) == 2
    assert "is given twice" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--estimator", "h3"], "h3"),
        (["--load-stiffness", "5"], "--load-damping"),
        (["--resolution-hz", "0.1"], "too few"),
        (["--resolution-hz", "5", "--to-hz", "4"], "--from-hz: the band 0.5 to 4 Hz holds no line"),
        (["--from-hz", "9"], "--from-hz: the band 9 to 8 Hz is empty"),
        (["--chain", "gone.yaml"], "gone.yaml"),
    ],
)
def test_mistakes_are_one_line(
    recording: Path, words: list[str], told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["frequency-response", str(recording), "--model", MODEL, *words]) == 2
    said = capsys.readouterr().err
    assert told in said
    assert said.count("\n") == 1


def test_no_torque_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    time_s = np.arange(9000) / 1000.0
    write_table(tmp_path / "r.csv", {"time_s": time_s, "motor_speed_rad_s": np.sin(time_s)})
    assert main(["frequency-response", str(tmp_path / "r.csv"), "--model", MODEL]) == 2
    assert "motor_torque_nm is missing" in capsys.readouterr().err
