"""A difference has two directions: too many in the simulator, missing in it, another number."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from eps_hil.diagnosis.against import diagnose_against
from eps_hil.physics.model import Model
from eps_hil.report import diagnosis_page

MANOEUVRES = ("sweep", "weave")
SECONDS = 12.0

pytestmark = pytest.mark.slow


def _run(record: Callable[..., Any], model: Model, rig: Any, simulator: Any) -> Any:
    traces = record(
        simulator, MANOEUVRES, noise=0.0, speed_late_s=-4e-3, torque_late_s=1e-3, seconds=SECONDS
    )
    kept = record(rig, ("weave",), seed=2, seconds=SECONDS)
    sims = {f"sim_{name}": one for name, one in traces.items()}
    return diagnose_against(sims, model, record(rig, MANOEUVRES, seconds=SECONDS), kept)


def test_what_only_the_simulator_has_is_a_finding_with_its_size(
    record: Callable[..., Any], reference_model: Model, other_rig: Any, tmp_path: Path
) -> None:
    simulator = {other_rig.STRIB: 0.04, other_rig.STRIB_W: 10.0}
    found = _run(record, reference_model, {}, simulator)
    content = found.content
    assert content["verdict"] == "explained"
    (finding,) = content["findings"]
    assert (finding["effect"], finding["direction"]) == ("stribeck", "simulator_only")
    assert finding["parameters"]["level_nm"]["value"] == pytest.approx(0.04, rel=0.15)
    assert "that the rig lacks" in finding["summary"]
    (one,) = content["simulation"]["differences"]["simulator_only"]
    of_rig = one["rig"]["level_nm"]
    assert abs(of_rig["value"]) < 0.008
    assert of_rig["ci95"][0] < of_rig["value"] < of_rig["ci95"][1] < 0.02
    low, high = finding["parameters"]["level_nm"]["ci95"]
    assert low < finding["parameters"]["level_nm"]["value"] < high < low + 0.01
    assert content["simulation"]["differences"]["numbers"] == []
    before, after = (
        content["fit"]["holdout"][name]["torque_nrmse"] for name in ("baseline", "augmented")
    )
    assert after < 0.5 * before  # before: the simulator as it is
    assert not any(entry["effect"] == "stribeck" for entry in found.model.effects)
    diagnosis_page.write(found, tmp_path / "page.html", "rig.yaml")
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "that the rig lacks" in page
    assert "no other effect of the catalogue fits" not in page  # none was compared


@pytest.mark.parametrize("load_cell", [True, False])
def test_both_have_it_only_where_the_recordings_say_so(
    record: Callable[..., Any], reference_model: Model, other_rig: Any, load_cell: bool
) -> None:
    """Without a load cell nobody is asked, and all were told as had by both."""
    both = {other_rig.STRIB: 0.04, other_rig.STRIB_W: 10.0}
    traces = record(
        both, MANOEUVRES, noise=0.0, speed_late_s=-4e-3, torque_late_s=1e-3, seconds=SECONDS
    )
    sims = {f"sim_{name}": one for name, one in traces.items()}
    rig = record(both, MANOEUVRES, seconds=SECONDS)
    kept = record(both, ("weave",), seed=2, seconds=SECONDS)
    if not load_cell:
        for one in (*rig.values(), *kept.values()):
            one.pop("rack_force_n")
    told = diagnose_against(sims, reference_model, rig, kept).content["simulation"]["differences"]
    assert (told["same"], told["undecided"]) == (
        (["stribeck"], []) if load_cell else ([], ["stribeck"])
    )


def test_too_many_and_missing_and_another_number_at_once(
    record: Callable[..., Any], reference_model: Model, other_rig: Any
) -> None:
    simulator = {other_rig.COG: 0.03, other_rig.COG_N: 12.0, other_rig.COG_P: 0.3}
    rig = {other_rig.STRIB: 0.04, other_rig.STRIB_W: 10.0, other_rig.K0P: 0.08}
    content = _run(record, reference_model, rig, simulator).content
    told = content["simulation"]["differences"]
    assert [one["effect"] for one in told["simulator_only"]] == ["cogging_torque"]
    assert [one["effect"] for one in told["rig_only"]] == ["stribeck"]
    numbers = {one["name"]: one for one in told["numbers"]}
    assert numbers["offset_pos_nm"]["rig"] == pytest.approx(0.08, rel=0.05)
    assert numbers["offset_pos_nm"]["ci95"][0] < numbers["offset_pos_nm"]["rig"]
    assert numbers["offset_pos_nm"]["simulator"] == pytest.approx(0.056, rel=0.05)
    assert "unknown" not in {one["effect"] for one in content["findings"]}
