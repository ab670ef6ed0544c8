"""A programme's logs, as the runner leaves them, become a whole model."""

from dataclasses import replace
from pathlib import Path

import pytest

from eps_hil.bus.config import load_bus_setup
from eps_hil.bus.record import open_log
from eps_hil.physics.model import load_model
from eps_hil.programme.cell_record import CellResult
from eps_hil.programme.plan import PlannedCell
from eps_hil.programme.run import Summary
from eps_hil.programme.summary import counted_twice, identified, identify_logs

from .programme_bench import MODEL, PLAN, Bench

SHORT = replace(PLAN, run_s=0.3, settle_s=0.1, settle_rad=1.0)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Summary]:
    """Two speeds and two loads, both ways, one after the other; about 15 s of recording."""
    folder = tmp_path_factory.mktemp("programme")
    bench = Bench(folder)
    results: list[CellResult] = []
    for speed, load in [(v, f) for f in (0.0, 1500.0) for v in (10.0, -10.0, 40.0, -40.0)]:
        cell = PlannedCell(len(results) + 1, speed, load, 1)
        log = open_log(folder / f"{cell.name}.log", "can0")
        _, collector, _ = bench.run(cell, log, SHORT)
        log.close()
        results.append(collector.result(cell, 0, 1))
    return folder, Summary(results, 0)


@pytest.mark.slow
class TestIdentify:
    def test_the_cells_give_eq_3(self, run: tuple[Path, Summary]) -> None:
        found = identified(run[1], MODEL).friction
        assert found is not None
        for name in ("offset_pos_nm", "offset_neg_nm", "load_pos_nm_per_n", "load_neg_nm_per_n"):
            assert getattr(found, name) == pytest.approx(getattr(MODEL.friction, name), rel=0.1)

    def test_the_logs_give_a_model_file(self, run: tuple[Path, Summary], tmp_path: Path) -> None:
        folder, summary = run
        whole = identify_logs(summary, load_bus_setup(folder / "c.yaml"), MODEL, folder)
        assert whole.found is not None, whole.problem
        (tmp_path / "found.yaml").write_text(whole.text)
        found = load_model(tmp_path / "found.yaml")
        assert found.inertia_kg_m2 == pytest.approx(MODEL.inertia_kg_m2, rel=0.05)
        for name in ("offset_pos_nm", "offset_neg_nm", "load_pos_nm_per_n", "load_neg_nm_per_n"):
            truth = getattr(MODEL.friction, name)
            assert getattr(found.friction, name) == pytest.approx(truth, rel=0.05)

    def test_too_little_is_said(self, run: tuple[Path, Summary]) -> None:
        folder, summary = run
        little = Summary(summary.results[:1], 0)
        assert "eq. 3 needs 2" in identified(little, MODEL).problem
        missing = Summary(summary.results[:0], 0)
        whole = identify_logs(missing, load_bus_setup(folder / "c.yaml"), MODEL, folder)
        assert whole.found is None
        assert whole.problem


def test_levels_that_effects_of_the_file_raise_again_are_refused() -> None:
    """The measured friction was written beside the effect that makes a part of it."""
    stribeck = {"effect": "stribeck", "level_nm": 0.05, "speed_rad_s": 6.0}
    assert counted_twice(MODEL) == ""
    assert counted_twice(replace(MODEL, effects=({"effect": "inertia", "scale": 2.0},))) == ""
    assert "stribeck" in counted_twice(replace(MODEL, effects=(stribeck,)))
