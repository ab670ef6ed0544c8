"""Manoeuvre files: what they say, what the table holds, and what is refused."""

from pathlib import Path

import numpy as np
import pytest

from eps_hil.errors import InputError
from eps_hil.physics.chain import HAND_ANGLE, LOAD_FORCE
from eps_hil.rig.manoeuvre import COLUMNS, MOTOR_STIFFNESS, load_manoeuvre, manoeuvre_names

NAMES = {
    "constant_speed_preload",
    "demo",
    "dwell",
    "multisine",
    "sine_sweep",
    "steps",
    "weave",
}


def write(folder: Path, segments: str) -> Path:
    path = folder / "own.yaml"
    path.write_text(f"manoeuvre:\n  name: own\n  segments:\n{segments}")
    return path


def test_the_named_manoeuvres_are_all_there() -> None:
    assert set(manoeuvre_names()) >= NAMES


@pytest.mark.parametrize("name", sorted(NAMES))
def test_every_named_manoeuvre_makes_a_finite_table(name: str) -> None:
    manoeuvre = load_manoeuvre(name)
    table = manoeuvre.table()
    assert manoeuvre.name == name
    assert table.shape == (round(manoeuvre.duration_s * 1000) + 1, COLUMNS)
    assert np.isfinite(table).all()
    assert np.array_equal(table, load_manoeuvre(name).table())


def test_the_sweep_is_the_one_of_the_paper() -> None:
    table = load_manoeuvre("sine_sweep").table()
    force = table[:-1, LOAD_FORCE]
    assert len(force) == 40_000
    assert np.abs(force).max() == pytest.approx(750.0, rel=1e-5)
    assert np.sqrt(np.mean(force**2)) == pytest.approx(530.0, rel=0.02)
    # Nearly 4 Hz at the end: 3.95 periods in the last second, from just after a zero crossing.
    assert np.count_nonzero(np.diff(np.sign(force[39_000:]))) == 7


def test_the_steps_hold_still_in_between_and_end_at_zero() -> None:
    force = load_manoeuvre("steps").table()[:, LOAD_FORCE]
    assert set(np.round(force[1000::2000])) == {0.0, 500.0, -500.0, 1000.0, -1000.0}
    assert force[-1] == 0.0


def test_the_robot_passes_every_speed_both_ways_and_comes_back() -> None:
    table = load_manoeuvre("constant_speed_preload").table()
    speed = np.diff(table[:-1, HAND_ANGLE]) * 1000
    for preload in (0.0, 1000.0, 2000.0, 3000.0, -2000.0):
        there = np.abs(table[:-2, LOAD_FORCE] - preload) < 1e-9
        for wanted in (0.4, 1.0, 2.0):
            for direction in (1, -1):
                held = there & (np.abs(speed - direction * wanted) < 1e-6)
                assert np.count_nonzero(held) > 250, (preload, direction * wanted)
    assert np.abs(table[:, HAND_ANGLE]).max() < 1.51
    assert abs(table[-1, HAND_ANGLE]) < 0.01


@pytest.mark.parametrize("after", [0.0, 9.0])
def test_two_points_at_one_time_are_a_step_either_way(tmp_path: Path, after: float) -> None:
    """Down, it became a sawtooth: points were ordered by their values too."""
    points = f"[[0, 5], [0.05, 5], [0.05, {after}], [0.1, {after}]]"
    path = write(tmp_path, f"    - {{duration_s: 0.1, rack_force_n: {{points: {points}}}}}\n")
    force = load_manoeuvre(path).table()[:-1, LOAD_FORCE]
    assert force[:50] == pytest.approx(5.0)
    assert force[51:] == pytest.approx(after)


def test_segments_follow_each_other_and_repeat(tmp_path: Path) -> None:
    path = write(
        tmp_path,
        "    - {duration_s: 0.1, rack_force_n: {points: [[0, 0], [0.1, 100]]}, repeat: 2}\n"
        "    - {duration_s: 0.05, motor: {stiffness_nm_per_rad: 0.5}, rack_force_n: 7}\n",
    )
    manoeuvre = load_manoeuvre(path)
    table = manoeuvre.table()
    assert manoeuvre.duration_s == pytest.approx(0.25)
    assert table[50, LOAD_FORCE] == pytest.approx(50.0)
    assert table[150, LOAD_FORCE] == pytest.approx(50.0)
    assert list(table[[199, 200, 249], MOTOR_STIFFNESS]) == [0.0, 0.5, 0.5]
    assert table[-1, LOAD_FORCE] == 7.0


def test_a_multisine_has_its_rms_and_only_its_band() -> None:
    from eps_hil.rig.manoeuvre import MOTOR_TORQUE

    torque = load_manoeuvre("multisine").table()[:-1, MOTOR_TORQUE]
    assert np.sqrt(np.mean(torque**2)) == pytest.approx(0.4, rel=0.05)
    power = np.abs(np.fft.rfft(torque)) ** 2
    frequency = np.fft.rfftfreq(len(torque), 1e-3)
    assert power[(frequency < 0.4) | (frequency > 8.2)].sum() < 1e-3 * power.sum()


@pytest.mark.parametrize(
    ("segments", "words"),
    [
        ("    - {rack_force_n: 3}\n", ["own.yaml", "segments.0.duration_s", "missing"]),
        ("    - {duration_s: -1}\n", ["own.yaml", "line 4", "segments.0.duration_s"]),
        ("    - {duration_s: 1, rack_force: 3}\n", ["own.yaml", "rack_force", "not a known"]),
        (
            "    - {duration_s: 1, rack_force_n: {sweep: {amplitude: 1, from_hz: a, to_hz: 2}}}\n",
            ["own.yaml", "sweep.from_hz", "'a'"],
        ),
        ("    - {duration_s: 0.0001}\n", ["own.yaml", "duration_s", "millisecond"]),
        ("    []\n", ["own.yaml", "segments"]),
        (
            "    - constant_speed_grid: {wheel_speeds_rad_s: [1], preloads_n: [0]}\n"
            "      duration_s: 3\n",
            ["own.yaml", "segments.0.duration_s", "leave it out"],
        ),
    ],
)
def test_mistakes_name_file_and_field(tmp_path: Path, segments: str, words: list[str]) -> None:
    with pytest.raises(InputError) as caught:
        load_manoeuvre(write(tmp_path, segments))
    for word in words:
        assert word in str(caught.value)
    assert "\n" not in str(caught.value)


def test_an_unknown_name_lists_the_known_ones() -> None:
    with pytest.raises(InputError, match=r"slalom.*no such manoeuvre.*sine_sweep"):
        load_manoeuvre("slalom")


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"gone\.yaml.*no such file"):
        load_manoeuvre(tmp_path / "gone.yaml")
