"""Programme files: order, balance, and what is refused."""

from collections import Counter
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from eps_hil.errors import InputError
from eps_hil.physics.model import load_model
from eps_hil.programme.plan import Plan, load_plan, way_m

ROOT = Path(__file__).parents[2]
MODEL = load_model(ROOT / "configs" / "reference_rig.yaml")
PLAN = Plan("p", (5.0, 20.0, 40.0), (0.0, 1000.0), repetitions=3, seed=4)


def test_every_cell_once_in_each_repetition_and_both_directions() -> None:
    cells = PLAN.cells()
    assert [cell.number for cell in cells] == list(range(1, 37))
    counts = Counter((cell.speed_rad_s, cell.preload_n, cell.repetition) for cell in cells)
    assert set(counts.values()) == {1}
    assert {cell.speed_rad_s for cell in cells} == {s * v for s in (1, -1) for v in (5, 20, 40)}
    for first in (0, 12, 24):  # a repetition is a block: warming up cannot look like speed or load
        assert len({cell.repetition for cell in cells[first : first + 12]}) == 1


def test_random_order_follows_the_seed_and_differs_between_repetitions() -> None:
    assert PLAN.cells() == PLAN.cells()
    other = replace(PLAN, seed=5)
    assert [c.name for c in PLAN.cells()] != [c.name for c in other.cells()]
    blocks = [
        [(c.speed_rad_s, c.preload_n) for c in PLAN.cells() if c.repetition == k] for k in (1, 2, 3)
    ]
    assert blocks[0] != blocks[1] != blocks[2]


def test_as_written() -> None:
    cells = replace(PLAN, order="as_written", repetitions=1).cells()
    assert [(c.speed_rad_s, c.preload_n) for c in cells[:3]] == [(5, 0), (-5, 0), (20, 0)]


@given(st.integers(0, 2**32))
def test_names_are_file_names_of_their_own(seed: int) -> None:
    names = [cell.name for cell in replace(PLAN, seed=seed).cells()]
    assert len(set(names)) == len(names)
    assert not any(set(name) & set("/ ") for name in names)


def test_a_slow_pass_settles_longer() -> None:
    assert PLAN.settling_s(2.0) == pytest.approx(0.4 + 1.0)
    assert PLAN.settling_s(-40.0) == pytest.approx(0.4 + 0.05)


@pytest.mark.parametrize("name", ["friction_map", "short"])
def test_the_projects_own_programmes(name: str) -> None:
    plan = load_plan(ROOT / "configs" / "programmes" / f"{name}.yaml", MODEL)
    assert plan.name == name
    for cell in plan.cells():
        assert way_m(plan, cell.speed_rad_s, MODEL) < 2 * plan.rack_travel_m


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("name: p\n  preloads_n: [0]", ["speeds_rad_s", "is missing"]),
        ("name: p\n  speeds_rad_s: [-1]\n  preloads_n: [0]", ["line 3", "speeds_rad_s.0"]),
        ("name: p\n  speeds_rad_s: [5, 5]\n  preloads_n: [0]", ["a value twice"]),
        ("name: p\n  speeds_rad_s: [400]\n  preloads_n: [0]", ["mm of rack", "rack_travel_m"]),
        ("name: p\n  speeds_rad_s: [5]\n  preloads_n: []", ["preloads_n"]),
        (
            "name: p\n  speeds_rad_s: [5]\n  preloads_n: [0]\n  motor_share: 0.5",
            ["motor_share", "only an armed override commands one", "rig.motor_share"],
        ),
        ("name: p\n  speed: 5\n  speeds_rad_s: [5]\n  preloads_n: [0]", ["not a known field"]),
    ],
)
def test_mistakes_name_the_field(tmp_path: Path, text: str, words: list[str]) -> None:
    file = tmp_path / "p.yaml"
    file.write_text(f"programme:\n  {text}\n")
    with pytest.raises(InputError) as caught:
        load_plan(file, MODEL)
    for word in ("p.yaml", *words):
        assert word in str(caught.value)
