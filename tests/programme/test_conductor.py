"""One cell on the simulated rig without a bus, and a rig that does not follow."""

import math
from dataclasses import replace
from pathlib import Path

import pytest

from eps_hil.bus.message_decoder import Sample
from eps_hil.physics.friction import friction_law, static_level_nm
from eps_hil.programme import cell_record
from eps_hil.programme.cell_record import CellResult, Collector
from eps_hil.programme.conductor import Conductor, Phase, Reading, Wanted
from eps_hil.programme.plan import PlannedCell

from .programme_bench import MODEL, MS, PLAN, Bench

LOADED = replace(PLAN, preloads_n=(0.0, -500.0))


@pytest.mark.parametrize(
    ("speed", "load"),
    [(20.0, 0.0), (-40.0, 2000.0), pytest.param(5.0, -1000.0, marks=pytest.mark.slow)],
)
def test_a_cell_reads_the_rigs_friction(tmp_path: Path, speed: float, load: float) -> None:
    cell = PlannedCell(1, speed, load, 1)
    _, collector, phases = Bench(tmp_path).run(cell)
    assert phases == list(Phase)[: list(Phase).index(Phase.DONE) + 1]
    result = collector.result(cell, 0, 1)
    assert result.accepted, result.problems
    assert result.samples > 450
    truth = math.copysign(static_level_nm(speed, load, friction_law(MODEL.friction)), speed)
    assert result.measured.friction_nm == pytest.approx(truth, rel=0.03)
    assert result.measured.load_n == pytest.approx(load, abs=5.0)


@pytest.mark.slow
def test_cells_follow_each_other_from_wherever_the_rack_is(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    for number, speed in enumerate((40.0, 40.0, -5.0), 1):
        conductor, *_ = bench.run(PlannedCell(number, speed, 500.0, 1))
        assert conductor.phase is Phase.DONE


def test_a_rig_that_does_not_follow_is_said(tmp_path: Path) -> None:
    conductor = Conductor(PlannedCell(1, 20.0, 1000.0, 1), PLAN, MODEL)
    for _ in range(10_000):
        wanted = conductor.step(Reading(0.0, conductor.start_m, 0.0))
        if conductor.over:
            break
    assert conductor.phase is Phase.FAILED
    assert "preload" in conductor.reason
    assert "asked for 20 rad/s at 1000 N" in conductor.reason
    assert tuple(wanted) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("reading", "what"),
    [
        (Reading(0.0, -0.0531, 0.0), "rack position -53.1 mm, the limit is 53 mm"),
        (Reading(91.0, 0.0, 0.0), "rotor speed 91 rad/s, the limit is 90 rad/s"),
        (Reading(0.0, math.nan, 0.0), "rack position nan"),
        (Reading(0.0, 0.0, 12_000.0), "load 1.2e+04 N, the limit is 850 N"),
        (Reading(0.0, 0.0, -851.0), "load -851 N, the limit is 850 N"),
        (Reading(0.0, 0.0, 500.0, 60.0), "torsion-bar torque 60 Nm, the limit is 15.8"),
        (Reading(0.0, 0.0, 500.0, math.nan), "torsion-bar torque nan Nm"),
    ],
)
@pytest.mark.parametrize("phase", [Phase.APPROACH, Phase.MEASURE])
def test_beyond_what_the_file_asks_for_it_ends_at_once(
    reading: Reading, what: str, phase: Phase
) -> None:
    conductor = Conductor(PlannedCell(1, 20.0, 500.0, 1), LOADED, MODEL)
    conductor.step(Reading(0.0, 0.0, 0.0))
    conductor._enter(phase)
    assert conductor.step(reading) == Wanted(0.0, 0.0)
    assert conductor.over
    assert conductor.phase is Phase.TRIPPED
    assert conductor.reason.startswith(what)


def test_the_file_may_say_what_the_torsion_bar_may_carry() -> None:
    plan = replace(LOADED, sensor_torque_nm=4.0)
    conductor = Conductor(PlannedCell(1, 20.0, 500.0, 1), plan, MODEL)
    conductor.step(Reading(0.0, 0.0, 0.0, -3.9))
    assert not conductor.over
    conductor.step(Reading(0.0, 0.0, 0.0, -4.1))
    assert conductor.reason == "torsion-bar torque -4.1 Nm, the limit is 4 Nm"
    assert plan.content()["sensor_torque_nm"] == 4.0
    assert "sensor_torque_nm" not in LOADED.content(), "folders of earlier versions go on"


def test_a_rack_that_was_left_outside_is_led_back_and_no_further_out() -> None:
    conductor = Conductor(PlannedCell(1, 20.0, 1000.0, 1), PLAN, MODEL)
    assert conductor.step(Reading(0.0, 0.08, 0.0)).speed_rad_s < 0.0
    conductor.step(Reading(0.0, 0.0829, 0.0))
    assert not conductor.over
    conductor.step(Reading(0.0, 0.0831, 0.0))
    assert conductor.reason.startswith("rack position 83.1 mm, the limit is 83 mm")


class TestRecord:
    CELL = PlannedCell(3, 20.0, 0.0, 1)

    def collected(
        self, speed: float = 20.0, force: float = 0.0, torque: float = 0.064
    ) -> Collector:
        collector = Collector(MODEL)
        values = {"motor_torque_nm": torque, "torque_sensor_nm": 0.0, "rack_force_n": force}
        for ms in range(500):
            for name, value in ({"motor_speed_rad_s": speed} | values).items():
                collector.take([Sample(name, ms * MS, value)])
        return collector

    def test_written_and_read_back(self, tmp_path: Path) -> None:
        result = self.collected().result(self.CELL, 0, 2)
        assert result.accepted
        cell_record.write(result, tmp_path)
        assert cell_record.read(self.CELL, tmp_path) == result
        assert cell_record.read(PlannedCell(4, 20.0, 0.0, 1), tmp_path) is None

    def test_delays_are_taken_out(self) -> None:
        """Only the stretch in which every signal speaks of the same instants counts: 4 ms less."""
        assert self.collected().result(self.CELL, 0, 1).samples == 496

    @pytest.mark.parametrize(
        ("change", "word"),
        [({"speed": 15.0}, "speed 15"), ({"force": 50.0}, "force 50"), ({"torque": -0.1}, "sign")],
    )
    def test_a_bad_pass_says_why(self, change: dict[str, float], word: str) -> None:
        result = self.collected(**change).result(self.CELL, 0, 1)
        assert not result.accepted
        assert word in "; ".join(result.problems)

    def test_a_clock_that_is_set_back_amid_a_pass(self) -> None:
        """No instant is shared then: it ended in a traceback."""
        collector = self.collected()
        for ms in range(500):
            for name in cell_record.MEASURED:
                collector.take([Sample(name, ms * MS - 3600 * 1000 * MS, 20.0)])
        result = collector.result(self.CELL, 0, 1)
        assert result.problems == ("the signals share too few samples",)
        assert math.isnan(result.measured.friction_nm)

    def test_lost_frames_and_missing_signals(self, tmp_path: Path) -> None:
        assert self.collected().result(self.CELL, 7, 1).problems == ("7 frames lost",)
        nothing = Collector(MODEL).result(self.CELL, 0, 1)
        assert "too few samples of motor_torque_nm" in nothing.problems[0]
        cell_record.write(nothing, tmp_path)
        again = cell_record.read(self.CELL, tmp_path)
        assert isinstance(again, CellResult)
        assert math.isnan(again.measured.friction_nm)
