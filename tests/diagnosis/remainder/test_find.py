"""A model of what no name stands for, on rigs of other code."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

from eps_hil.diagnosis.balance.problem import Problem
from eps_hil.diagnosis.data.prepare import prepare
from eps_hil.diagnosis.remainder import find as find_module
from eps_hil.diagnosis.remainder.find import Own, find, share_removed
from eps_hil.diagnosis.remainder.grammar import Input, Law, columns_of, laws
from eps_hil.diagnosis.remainder.refine import refine, with_laws
from eps_hil.diagnosis.remainder.screen import Screened, screen
from eps_hil.diagnosis.remainder.sight import Sight
from eps_hil.diagnosis.remainder.table import tables
from eps_hil.physics.effects.catalogue import values_of
from eps_hil.physics.model import Model
from eps_hil.series import Series

Recordings = Mapping[str, Mapping[str, Series]]
Record = Callable[..., Recordings]


def over(recordings: Recordings, model: Model) -> Problem:
    return Problem([prepare(name, one) for name, one in recordings.items()], model)


@pytest.fixture(scope="module")
def eddy(record: Record, other_rig: ModuleType, reference_model: Model) -> tuple[Problem, Problem]:
    """An eddy-current brake, which no name of the catalogue stands for: fitted and kept."""
    plant = {other_rig.EDDY: 0.06, other_rig.EDDY_W: 30.0}
    made = [record(plant, ("sweep", "weave"), seed=seed, seconds=10.0) for seed in (1, 2)]
    return over(made[0], reference_model), over(made[1], reference_model)


@pytest.fixture(scope="module")
def eddy_free(record: Record, reference_model: Model) -> tuple[Problem, Problem]:
    """The same programme on a rig that lacks nothing."""
    made = [record({}, ("sweep", "weave"), seed=seed, seconds=20.0) for seed in (1, 2)]
    return over(made[0], reference_model), over(made[1], reference_model)


LAWS = [
    Law("rotor", "sum", (Input("motor_speed_rad_s", "saturating", numbers={"width": 20.0}),), 0.02),
    Law("motor", "factor", (Input("motor_torque_nm", "linear", "heat", {"memory": 2.0}),), -0.1),
    Law("friction", "sum", (Input("abs_rack_force_n", "linear"),
                            Input("load_power_sign", "below", numbers={"centre": 0.0})), 3e-5),
    Law("friction", "factor", (Input("abs_motor_speed_rad_s", "linear", "lag", {"memory": 0.5}),),
        0.01),
    Law("rotor", "sum", (Input("motor_angle_rad", "linear", "hysteresis", {"memory": 3.0}),), 0.02),
    Law("load", "factor", (Input("rack_position_m", "gaussian",
                                 numbers={"centre": 0.002, "width": 0.004}),), 0.05),
]  # fmt: skip


@pytest.mark.parametrize("law", LAWS, ids=lambda law: "_".join(str(one) for one in law.family[:2]))
def test_screening_sees_what_the_simulator_does(law: Law, eddy: tuple[Problem, Problem]) -> None:
    problem, _ = eddy
    sight = Sight(problem, problem.model)
    column = columns_of(law, sight)
    assert column is not None
    with_it = replace(problem.model, effects=(law.entry({}),))
    change = (problem.residual(with_it) - sight.residual) * problem.scale
    change, column = change[sight.rows], column[:, 0] * law.size
    assert np.corrcoef(change, column)[0, 1] > 0.98
    assert np.std(change) == pytest.approx(np.std(column), rel=0.1)


def test_a_ripple_that_fades_with_speed_is_tried(eddy: tuple[Problem, Problem]) -> None:
    """Among the laws of the rotor is one of its order whose strength goes as its own."""
    problem, _ = eddy
    sight = Sight(problem, problem.model)
    true = Law("rotor", "sum", (
        Input("abs_motor_speed_rad_s", "exponential", numbers={"centre": 0.0, "width": 6.0}),
        Input("motor_angle_rad", "sine", numbers={"order": 4.3, "phase": 0.0}),
    ))  # fmt: skip
    wanted = columns_of(true, sight)
    assert wanted is not None
    left = np.zeros(len(sight.residual))
    left[sight.rows] = wanted[:, 0]

    def share(law: Law) -> float:
        """Of the ripple's energy that a law takes off."""
        x = columns_of(law, sight)
        assert x is not None
        fitted = x @ np.linalg.lstsq(x, left[sight.rows], rcond=None)[0]
        return 1.0 - float(np.sum((left[sight.rows] - fitted) ** 2) / np.sum(left**2))

    waves = [
        law
        for group in laws(sight, left)
        for law in group
        if (law.where, law.how) == ("rotor", "sum") and law.inputs[-1].shape == "sine"
    ]
    fading = [law for law in waves if law.inputs[0].name == "abs_motor_speed_rad_s"]
    assert max(map(share, fading)) > 0.95
    assert max(share(law) for law in waves if law not in fading) < 0.9


def test_gains_are_those_of_columns_without_what_may_move(eddy: tuple[Problem, Problem]) -> None:
    """Each of the best laws once more, its column made orthogonal as it stands."""
    fitted, kept = (Sight(one, one.model) for one in eddy)
    rng = np.random.default_rng(1)
    smooth = np.cumsum(rng.normal(size=(len(fitted.residual), 4)), axis=0)
    found = screen(fitted, kept, smooth)
    rows, weight = fitted.rows, fitted.weight[fitted.rows, None]
    basis = np.linalg.qr(smooth[rows] * weight)[0]
    left = (fitted.residual * fitted.weight)[rows]

    def free(columns: Any) -> Any:
        return columns - basis @ (basis.T @ columns)

    for one in found.best:
        x, y = (columns_of(one.law, sight) for sight in (fitted, kept))
        assert x is not None
        assert y is not None
        x = free(x / fitted.scale[rows, None] * weight)
        size = np.linalg.lstsq(x, -left, rcond=1e-9)[0]
        assert one.fitted == pytest.approx(float(-left @ x @ size), rel=1e-9)
        y = y / kept.scale[kept.rows, None] * kept.weight[kept.rows, None] @ size
        other = (kept.residual * kept.weight)[kept.rows]
        gain = float(other @ other - (other + y) @ (other + y))
        assert one.judged == pytest.approx(gain, rel=1e-9, abs=1e-9 * float(other @ other))
    assert found.most >= max(one.judged for one in found.best)
    assert found.null.min() > 0.0

    (best, *_) = found.best
    x = columns_of(best.law, fitted)
    assert x is not None
    mine = np.zeros((len(fitted.residual), x.shape[1]))
    mine[rows] = x / fitted.scale[rows, None] * (1.0 + 1e-9 * rng.normal(size=x.shape))
    again = screen(fitted, kept, np.hstack([smooth, mine]))
    its = [one.fitted for one in again.best if replace(one.law, size=best.law.size) == best.law]
    assert not its or max(its) < 1e-3 * best.fitted, "rounding is no gain"


def test_what_is_kept_of_a_search_is_little(eddy: tuple[Problem, Problem]) -> None:
    fitted, kept = (Sight(one, one.model) for one in eddy)
    count = sum(len(group) for group in laws(fitted, fitted.residual))
    screen(fitted, kept, np.zeros((len(fitted.residual), 0)))
    assert count > 1000
    assert len(fitted._passing) == 0
    assert len(fitted._lasting) < 60


def test_numbers_are_refined_by_the_simulator(eddy: tuple[Problem, Problem]) -> None:
    """From a wrong start to the numbers with which a known law was put in."""
    problem, _ = eddy
    true = Law("motor", "sum", (Input("motor_torque_nm", "saturating", numbers={"width": 0.1}),),
               0.05)  # fmt: skip
    lacking = replace(problem.model, effects=(replace(true, size=-0.05).entry({}),))
    start = replace(true, inputs=(Input("motor_torque_nm", "saturating", numbers={"width": 0.3}),))
    before = problem.residual(problem.model)
    bent = Problem(problem.recordings, lacking)
    found = refine(bent, lacking, start, {})
    after = bent.residual(with_laws(lacking, [found], {}))
    assert np.mean(after[bent.sliding] ** 2) < 1.05 * np.mean(before[bent.sliding] ** 2)


def test_a_law_is_refined_with_the_number_that_it_shares_its_work_with(
    record: Record, reference_model: Model
) -> None:
    """Friction that follows the load late, less what follows at once: neither does it alone."""
    problem = over(record({}, ("sweep", "weave"), seed=3, seconds=10.0), reference_model)
    late = Law("friction", "sum", (Input("abs_rack_force_n", "linear", "lag", {"memory": 0.7}),),
               3e-5)  # fmt: skip
    rubs = problem.model.friction
    more = replace(rubs, load_pos_nm_per_n=rubs.load_pos_nm_per_n + 3e-5,
                   load_neg_nm_per_n=rubs.load_neg_nm_per_n + 3e-5)  # fmt: skip
    lacking = replace(problem.model, friction=more, effects=(replace(late, size=-3e-5).entry({}),))
    bent = Problem(problem.recordings, lacking)
    own = Own(Sight(bent, lacking), ("load_pos_nm_per_n", "load_neg_nm_per_n"))
    start = replace(late, inputs=(replace(late.inputs[0], numbers={"memory": 0.3}),))
    law = refine(bent, lacking, start, {}, own.columns)
    assert law.inputs[0].numbers["memory"] == pytest.approx(0.7, rel=0.1)
    model = own.moved(law.entry({}))
    assert model.friction.load_pos_nm_per_n == pytest.approx(rubs.load_pos_nm_per_n, rel=0.1)

    def left(model: Model) -> float:
        residual = bent.residual(replace(model, effects=(*model.effects, law.entry({}))))
        return float(np.mean(residual[bent.sliding] ** 2))

    right = float(np.mean(bent.residual(problem.model)[bent.sliding] ** 2))
    assert left(model) < 1.05 * right < 1.2 * right < left(lacking)


def test_a_curve_follows_what_it_is_drawn_through(eddy: tuple[Problem, Problem]) -> None:
    fitted, kept = (Sight(one, one.model) for one in eddy)
    best = tables(fitted, kept)[0]
    entry = best.entry({})
    with_it = replace(kept.model, effects=(entry,))
    values_of(entry, with_it)
    share, _ = share_removed(kept, kept.problem.residual(with_it))
    assert "motor_speed_rad_s" in {name.removeprefix("abs_") for name in best.inputs}
    assert share > 0.8


@pytest.mark.slow
def test_what_has_no_name_is_modelled(eddy: tuple[Problem, Problem]) -> None:
    fitted, kept = eddy
    found = find(fitted, kept, fitted.model, np.zeros((len(fitted.scale), 0)))
    assert found is not None
    assert found.share > 0.9
    assert found.ci95[0] > 0.7
    assert sorted(found.entries[0]["shapes"]) == ["linear", "rational"]
    assert all("motor_speed_rad_s" in name for name in found.entries[0]["inputs"])
    assert found.entries[0]["width_2"] == pytest.approx(30.0, rel=0.05)
    for entry in found.entries:
        values_of(entry, fitted.model)


@pytest.mark.slow
def test_where_nothing_is_missing_nothing_is_modelled(
    record: Record, reference_model: Model
) -> None:
    fitted, kept = (
        over(record({}, ("sweep", "weave"), seed=seed, seconds=10.0), reference_model)
        for seed in (3, 4)
    )
    assert find(fitted, kept, reference_model, np.zeros((len(fitted.scale), 0))) is None


def test_a_map_s_band_holds_what_made_it(eddy: tuple[Problem, Problem]) -> None:
    """The brake's own torque lies within fitted value and half width; None where no samples are."""
    from eps_hil.diagnosis.remainder.table import _columns, band

    problem, _ = eddy
    speeds, places = [-30.0, -20.0, -10.0, 0.0, 10.0, 20.0, 30.0], [-0.012, 0.0, 0.012]
    entry: dict[str, Any] = {
        "effect": "empirical", "form": "map", "where": "rotor", "how": "sum",
        "inputs": ["motor_speed_rad_s", "rack_position_m"], "memory": ["none", "none"],
        "knots": [speeds, places],
        "range": {"motor_speed_rad_s": [-30.0, 30.0], "rack_position_m": [-0.012, 0.012]},
    }  # fmt: skip
    x, left = _columns(
        Sight(problem, problem.model), ("rotor", "sum"), entry["inputs"], entry["knots"]
    )
    fitted = -np.linalg.lstsq(x, left, rcond=1e-6)[0].reshape(7, 3)
    entry["values"] = fitted.tolist()
    with_it = replace(problem.model, effects=(*problem.model.effects, entry))
    half = band(Sight(problem, with_it), entry)
    ratio = np.array(speeds) / 30.0
    brake = 2.0 * 0.06 * ratio / (1.0 + ratio**2)
    inside = [
        abs(fitted[k, j] - brake[k]) <= half[k][j]
        for k in range(7)
        for j in range(3)
        if half[k][j] is not None
    ]
    assert len(inside) >= 15
    assert np.mean(inside) > 0.8
    assert half[3][1] < 0.06  # slow and in the middle, where most samples are; the peak is 0.06 Nm
    far = {**entry, "knots": [np.linspace(500.0, 560.0, 7).tolist(), places]}
    assert band(Sight(problem, problem.model), far)[3:] == [[None] * 3] * 4


_WARM = Input("abs_motor_speed_rad_s", "saturating", "lag", {"memory": 5.0, "width": 15.0})
_WARMS = Law("friction", "factor", (_WARM,), -0.4)
_AGES = Law("friction", "factor", (Input("time_s", "saturating", numbers={"width": 4.0}),), -0.4)


@pytest.mark.parametrize("true", [_WARMS, _AGES], ids=["warms", "ages"])
@pytest.mark.slow
def test_a_law_of_time_is_the_last_resort(true: Law, eddy_free: tuple[Problem, Problem]) -> None:
    """Time since the recording began stands for nothing that a state of the rig says as well."""
    lacking = replace(eddy_free[0].model, effects=(replace(true, size=0.4).entry({}),))
    fitted, kept = (Problem(one.recordings, lacking) for one in eddy_free)
    found = find(fitted, kept, lacking, np.zeros((len(fitted.scale), 0)), one_law=True)
    assert found is not None
    law = found.terms[0].law
    assert law is not None
    assert law.of_time == true.of_time


@pytest.mark.parametrize(
    ("late", "best", "has_to_be"), [(0.963, 0.957, False), (0.995, 0.967, True)]
)
def test_a_law_of_time_has_to_leave_half_of_what_others_leave(
    late: float, best: float, has_to_be: bool, eddy: tuple[Problem, Problem]
) -> None:
    kept = Sight(eddy[1], eddy[1].model)

    def trial(worth: float) -> find_module._Trial:
        left = np.sqrt(1.0 + (1.0 - worth) * (kept.residual**2 - 1.0).clip(0.0))
        return find_module._Trial(find_module.Term({}, None), left, left, worth, kept.model)

    assert find_module._leaves_less(trial(late), trial(best), kept) is has_to_be


def test_laws_of_time_take_no_place_of_others() -> None:
    timed = [
        Screened(replace(_AGES, where=where, how=how), 9.0, 9.0)
        for where in ("rotor", "friction", "motor", "load")
        for how in ("sum", "factor")
    ]
    chosen = find_module._shortlist([*timed, Screened(_WARMS, 1.0, 1.0)])
    assert [one.of_time for one in chosen] == [False, True, True]


def test_a_memory_longer_than_any_recording_is_a_clock(eddy: tuple[Problem, Problem]) -> None:
    sight = Sight(eddy[0], eddy[0].model)
    longer = _WARMS.with_numbers({(0, "memory"): 1.1 * sight.longest_s})
    assert [find_module._is_a_clock(one, sight) for one in (_WARMS, longer)] == [False, True]


def test_a_sine_that_turns_by_less_than_half_a_period_is_a_line(
    eddy: tuple[Problem, Problem],
) -> None:
    sight = Sight(eddy[0], eddy[0].model)
    half = np.pi / float(np.ptp(sight.inputs["motor_angle_rad"][sight.rows]))
    orders = [share * half for share in (0.1, 0.9, 1.1)]
    laws = [_BESIDE.with_numbers({(0, "order"): order}) for order in orders]
    assert [find_module._is_no_wave(one, sight) for one in laws] == [True, True, False]
    assert not find_module._is_no_wave(_WARMS, sight)


@pytest.mark.parametrize(("gone", "passes"), [(0.8, True), (0.0, False)])
def test_what_a_stop_leaves_in_a_few_samples_hides_no_law(
    gone: float, passes: bool, eddy: tuple[Problem, Problem]
) -> None:
    """A hit of a hundred times everything else is for another term to explain."""
    kept = Sight(eddy[1], eddy[1].model)
    others = np.sqrt(1.0 + (1.0 - gone) * (kept.residual**2 - 1.0).clip(0.0))
    hit = kept.use & (np.cumsum(kept.use) <= 20)
    size = np.sqrt(100.0 * np.sum(kept.residual[kept.use] ** 2) / np.sum(hit))
    kept.residual, after = (np.where(hit, size, one) for one in (kept.residual, others))
    trial = find_module._Trial(find_module.Term({}, None), after, after, gone, kept.model)
    far_above_chance: Any = SimpleNamespace(most=2.0, null=[1.0])
    assert find_module._passes(trial, kept, far_above_chance) is passes
    assert share_removed(kept, after)[0] < find_module.LEAST_SHARE


@pytest.mark.parametrize(
    ("simple", "costly", "chosen"),
    [(2e-2, 5e-4, "costly"), (2e-2, 1.4e-2, "simple"), (5e-5, 1e-6, "simple")],
    ids=["half of it is gone", "a third of it is gone", "there is nothing to see"],
)
def test_a_costlier_law_has_to_leave_half_of_what_a_cheaper_leaves(
    simple: float, costly: float, chosen: str, eddy: tuple[Problem, Problem]
) -> None:
    """The brake is 700 times the noise: two hundredths of it are far out of it, 5e-5 are not."""
    sights = [Sight(one, one.model) for one in eddy]

    def trial(share: float, price: float) -> find_module._Trial:
        fitted, kept = (np.sqrt(1.0 + share * (one.residual**2 - 1.0).clip(0.0)) for one in sights)
        worth = (1.0 - share) * (1.0 - price)
        return find_module._Trial(find_module.Term({}, None), kept, fitted, worth, sights[0].model)

    both = {"simple": trial(simple, 0.004), "costly": trial(costly, 0.024)}
    best = find_module._costlier(both["simple"], list(both.values()), *sights)
    assert best is both[chosen]


_SIMPLE = [
    Law("rotor", "sum", (Input("motor_speed_rad_s", "saturating", numbers={"width": 20.0}),),
        -0.04),
    Law("rotor", "sum", (Input("motor_speed_rad_s", "gaussian",
                               numbers={"centre": 15.0, "width": 8.0}),), -0.04),
    Law("rotor", "sum", (Input("rack_force_n", "saturating", numbers={"width": 200.0}),), -0.04),
]  # fmt: skip
_BESIDE = Law(
    "rotor", "sum", (Input("motor_angle_rad", "sine", numbers={"order": 3.0, "phase": 0.5}),), 2e-3
)


@pytest.mark.slow
@pytest.mark.parametrize("true", _SIMPLE, ids=["tanh", "peak", "load"])
def test_a_simple_law_stays_simple_beside_a_small_one(
    true: Law, eddy_free: tuple[Problem, Problem]
) -> None:
    """What it leaves, a ripple that stands out of the noise, is no reason for a costlier law."""
    lacking = replace(eddy_free[0].model, effects=(true.entry({}), _BESIDE.entry({})))
    fitted, kept = (Problem(one.recordings, lacking) for one in eddy_free)
    found = find(fitted, kept, lacking, np.zeros((len(fitted.scale), 0)))
    assert found is not None
    law = found.terms[0].law
    assert law is not None
    assert law.family == true.family
    assert law.inputs[0].shape == true.inputs[0].shape
    assert law.size == pytest.approx(-true.size, rel=0.1)
