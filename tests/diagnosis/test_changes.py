"""Two states of one rig of other code: what is new, gone, stronger; what is no change."""

import dataclasses
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from eps_hil.cli.main import main
from eps_hil.diagnosis import changes as module
from eps_hil.diagnosis.changes import Changes, changes, in_words, what_would_show
from eps_hil.diagnosis.one_way import OneWay, Share
from eps_hil.physics.model import Model, load_model

MODEL = str(Path(__file__).parents[2] / "configs" / "reference_rig.yaml")


@pytest.mark.parametrize(
    ("share", "shown", "changed"),
    [
        (Share(0.0, 0.1, 0.1), True, True),
        (Share(1.0, 0.1, 0.1), True, False),
        (Share(0.8, 0.1, 0.1), True, False),
        (Share(0.5, 0.2, 0.1), True, True),
        (Share(0.0, np.inf, 0.1), False, False),
        (Share(-0.2, 0.9, 0.1), False, False),
    ],
)
def test_a_change_is_beyond_the_intervals_of_both_states(
    share: Share, shown: bool, changed: bool
) -> None:
    assert share.shown is shown
    assert share.changed is changed


@pytest.mark.parametrize(
    ("kind", "size", "words"),
    [
        ("new", None, "new"),
        ("gone", 0.05, "gone"),
        ("different", None, "different"),
        ("stronger", 1.42, "stronger: 1.42 times as much"),
        ("weaker", 0.5, "weaker: 0.5 times as much"),
        ("weaker", -0.8, "other sign than before"),
    ],
)
def test_a_change_in_words(kind: str, size: float | None, words: str) -> None:
    assert in_words({"is": kind, "size_after": size, "numbers": []}) == words


@pytest.mark.parametrize(
    ("left", "said"),
    [
        (0.0012, "these recordings could show"),
        (0.0113, "stands out of the residual, which is 9.4 times the sensors' noise"),
        (None, "these recordings could show"),
    ],
)
def test_no_change_is_said_of_what_would_have_been_seen(left: float | None, said: str) -> None:
    holdout = {"augmented": {"torque_nrmse": left}, "noise_floor": {"torque_nrmse": 0.0012}}
    assert what_would_show({"fit": {"holdout": holdout}}) == said


@pytest.mark.parametrize(
    ("own", "came", "went", "way"),
    [  # (names of each state's own diagnosis, what is told and its gain each way, the way taken)
        (({"end_stop"}, set()), ({"position_torque"}, 50e3), ({"end_stop"}, 5e3), "gone"),
        ((set(), {"end_stop"}), ({"end_stop"}, 5e3), ({"position_torque"}, 50e3), "came"),
        ((set(), set()), ({"stribeck"}, 5e3), ({"inertia"}, 6e3), "gone"),
        ((set(), set()), ({"stribeck"}, 5e3), (set(), 0.0), "came"),
        ((set(), set()), (set(), 0.0), (set(), 0.0), "came"),
    ],
)
def test_beside_what_both_share_a_states_own_diagnosis_says_which_way(
    own: Any, came: Any, went: Any, way: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Against a model with an end stop too many the place of it gains most, as another name."""
    told = {"before": came, "after": went}
    monkeypatch.setattr(module, "beside_shared", lambda _known, word, _other, _say: told[word])
    monkeypatch.setattr(module, "_own", lambda state: own[state])
    monkeypatch.setattr(module, "_names", lambda one: one[0])
    monkeypatch.setattr(module, "gain", lambda one: one[1])
    monkeypatch.setattr(module, "_forward", lambda *_: "came")
    monkeypatch.setattr(module, "_backward", lambda *_: "gone")
    first, second, model = (cast(Any, one) for one in (0, 1, None))
    assert cast(Any, module._beside_shared(first, second, model, {}, None)) == way


def test_the_same_recording_in_both_states_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    one = tmp_path / "one.csv"
    one.write_text("time_s\n0\n")
    assert main(["changes", "--before", str(one), "--after", str(one), "--model", MODEL]) == 2
    assert "one.csv: is both --before and --after" in capsys.readouterr().err


class _Nothing:
    effects: tuple[Any, ...] = ()
    model: Any = None
    tied: Any = ()


NOTHING: Any = _Nothing()


@dataclass(frozen=True)
class Told:
    """A diagnosis as far as the choice between both ways looks at it."""

    content: dict[str, Any]
    price: float = 0.0
    model: Any = NOTHING
    problem: Any = NOTHING
    judged: Sequence[Any] = ()
    as_read: Sequence[Any] = ()
    elsewhere: Sequence[str] = ()


def told_of(*names: str) -> Told:
    holdout: dict[str, Any] = {"augmented": {}, "noise_floor": {}}
    findings = [{"effect": one, "summary": ""} for one in names]
    better = {"torque_residual": {"share": 0.5, "ci95": [0.4, 0.6]}}
    fit = {"holdout": holdout, "improvement": better}
    return Told({"findings": findings, "verdict": "", "limits": [], "fit": fit})


class Way(OneWay):
    """One direction whose findings are all changes, each new in the other state."""

    def as_much_unknown(self) -> bool:
        return False

    def change(self, k: int) -> dict[str, Any]:
        return {"is": "new", "before": [], "size_after": None, "numbers": []}


@pytest.mark.parametrize(
    ("states", "ways", "price", "expected"),
    [
        # (names of the first state, of the second), (second against first, first against second)
        (((), ()), ((), ("stribeck",)), 0.0, []),  # nothing is new: nobody looks the other way
        (((), ("stribeck",)), (("stribeck",), ("unknown",)), 5.0, ["stribeck new"]),
        ((("stribeck",), ()), (("quadratic_drag",), ("stribeck",)), 5.0, ["stribeck gone"]),
        ((("a",), ("a",)), (("unknown",), ("stribeck",)), 5.0, ["stribeck gone"]),
        ((("a",), ("a",)), (("quadratic_drag",), ("stribeck",)), -5.0, ["stribeck gone"]),
        ((("a",), ("a",)), (("quadratic_drag",), ("stribeck",)), 5.0, ["quadratic_drag new"]),
        (((), ("a",)), (("stribeck",), ("unknown",)), -5.0, ["stribeck new"]),
        (((), ()), (("stribeck",), ()), 0.0, []),  # shows one way only, in neither diagnosis
        (((), ("stribeck",)), (("stribeck", "a"), ()), 0.0, ["stribeck new"]),
        ((("backlash",), ("a",)), ((), ("backlash", "stribeck")), 0.0, ["backlash gone"]),
        # both share something without a name: what is measured by itself differs all the same
        ((("unknown",), ("backlash", "unknown")), (("backlash", "a"), ()), 0.0, ["backlash new"]),
        (
            (("belt_compliance", "unknown"), ("unknown",)),
            ((), ("a", "belt_compliance")),
            0.0,
            ["belt_compliance gone"],
        ),
    ],
)
def test_a_change_is_told_the_way_that_explains_both_states(
    states: Any, ways: Any, price: float, expected: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """``price``: of the way back, above that of the way there."""
    said = {"before": told_of(*states[0]), "after": told_of(*states[1])}

    def against(known: Any, word: str, *_: Any) -> OneWay:
        back = word == "after"
        other = dataclasses.replace(told_of(*ways[back]), price=price * back)
        return Way(known, cast("Any", other), cast("Any", None), word, {})

    monkeypatch.setattr(module, "diagnose", lambda _model, recordings, *_: said[recordings])
    monkeypatch.setattr(module, "against", against)
    monkeypatch.setattr(module, "measures", lambda *_: {})
    found = changes(NOTHING, cast("Any", "before"), cast("Any", "after"))
    content = found.after.content
    assert [f"{one['effect']} {one['change']['is']}" for one in content["findings"]] == expected
    if expected:
        assert content["seen_in"] == ("before" if "gone" in expected[0] else "after")
    else:
        assert content["verdict"] in ("", "no_mismatch")


@pytest.mark.parametrize(
    ("states", "undecided"),
    [
        ((("unknown",), ()), ["unknown"]),  # cold, then warm: one of them holds what has no name
        (((), ("unknown",)), ["unknown"]),
        ((("unknown",), ("unknown",)), []),
        (((), ()), []),
    ],
)
def test_what_one_state_alone_leaves_unnamed_is_not_said_to_be_the_same(
    states: tuple[tuple[str, ...], tuple[str, ...]],
    undecided: list[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Neither state shows it against the other."""
    said = {"before": told_of(*states[0]), "after": told_of(*states[1])}
    nothing = Way(cast("Any", told_of()), cast("Any", told_of()), cast("Any", None), "before", {})
    monkeypatch.setattr(module, "diagnose", lambda _model, recordings, *_: said[recordings])
    monkeypatch.setattr(module, "against", lambda *_: nothing)
    monkeypatch.setattr(module, "alike", lambda *_: False)
    content = changes(NOTHING, cast("Any", "before"), cast("Any", "after")).after.content
    assert content["findings"] == []
    assert content["undecided"] == undecided
    assert any("not decided" in one for one in content["limits"]) is bool(undecided)


def run(
    record: Callable[..., Any],
    model: Model,
    before: Mapping[int, float],
    after: Mapping[int, float],
) -> Changes:
    return changes(model, record(before, seed=3, seconds=20.0), record(after, seed=4, seconds=20.0))


def told(found: Changes) -> list[tuple[str, str]]:
    return [(one["effect"], one["change"]["is"]) for one in found.after.content["findings"]]


@pytest.mark.slow
def test_what_came_what_went_and_nothing(
    record: Callable[..., Any], reference_model: Model, other_rig: Any
) -> None:
    stribeck = {other_rig.STRIB: 0.03, other_rig.STRIB_W: 10.0}
    came = run(record, reference_model, {}, stribeck)
    assert told(came) == [("stribeck", "new")]
    (finding,) = came.after.content["findings"]
    assert finding["parameters"]["level_nm"]["value"] == pytest.approx(0.03, rel=0.05)
    assert abs(finding["change"]["share_before"]["value"]) < 0.1
    went = run(record, reference_model, stribeck, {})
    assert told(went) == [("stribeck", "gone")]
    assert went.before.content["findings"][0]["effect"] == "stribeck"
    holdout = went.after.content["fit"]["holdout"]
    assert holdout["augmented"]["torque_nrmse"] < 0.7 * holdout["baseline"]["torque_nrmse"]
    same = run(record, reference_model, stribeck, stribeck)
    assert told(same) == []
    assert same.after.content["verdict"] == "no_mismatch"


@pytest.mark.slow
def test_an_effect_of_another_size_and_shape_says_how_much(
    record: Callable[..., Any], reference_model: Model, other_rig: Any
) -> None:
    small = {other_rig.STRIB: 0.03, other_rig.STRIB_W: 10.0}
    large = {other_rig.STRIB: 0.06, other_rig.STRIB_W: 10.0}
    found = run(record, reference_model, small, large)
    assert told(found) == [("stribeck", "stronger")]
    (finding,) = found.after.content["findings"]
    assert finding["change"]["size_after"] == pytest.approx(2.0, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize(("levels", "says"), [((0.8, 0.9), "higher"), ((0.8, 0.7), "lower")])
def test_levels_that_the_file_has_wrong_are_told_by_where_they_go(
    levels: tuple[float, float],
    says: str,
    record: Callable[..., Any],
    reference_model: Model,
    other_rig: Any,
) -> None:
    """The file's are a fifth too high in the first state: what is off of them says nothing."""
    friction = reference_model.friction
    first, second = (
        {other_rig.K0P: by * friction.offset_pos_nm, other_rig.K0N: by * friction.offset_neg_nm}
        for by in levels
    )
    found = run(record, reference_model, first, second)
    assert told(found) == [("coulomb_level", says)]
    (finding,) = found.after.content["findings"]
    change = finding["change"]
    assert change["size_after"] == pytest.approx(levels[1] / levels[0], rel=0.02)
    assert [one["name"] for one in change["numbers"]] == ["offset_pos_nm", "offset_neg_nm"]
    for one, offset in zip(
        change["numbers"], (friction.offset_pos_nm, friction.offset_neg_nm), strict=True
    ):
        assert one["before"] == pytest.approx(levels[0] * offset, rel=0.03)
        assert one["after"] == pytest.approx(levels[1] * offset, rel=0.03)
    assert " state." in finding["summary"]


@pytest.mark.slow
def test_a_new_zero_of_the_angle_shifts_the_cogging(
    record: Callable[..., Any], reference_model: Model, other_rig: Any
) -> None:
    """The same sine of 7 a turn, which begins 1.2 rad later: the difference is another sine."""
    first, second = (
        {other_rig.COG: 0.02, other_rig.COG_N: 7.0, other_rig.COG_P: phase} for phase in (0.4, 1.6)
    )
    found = run(record, reference_model, first, second)
    assert told(found) == [("cogging_torque", "shifted")]
    (one,) = found.after.content["findings"]
    assert "its phase has moved by" in one["summary"]
    numbers = {one["name"]: one for one in found.after.content["findings"][0]["change"]["numbers"]}
    amplitude, phase = numbers["amplitude_nm"], numbers["phase_rad"]
    assert amplitude["after"] == pytest.approx(amplitude["before"], rel=0.05)
    assert phase["after"] - phase["before"] == pytest.approx(1.2, abs=0.1)


@pytest.mark.slow
def test_the_verb_writes_json_page_and_the_model_of_the_second_state(
    record: Callable[..., Any],
    other_rig: Any,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    names = {}
    for state, plant in (
        ("before", {}),
        ("after", {other_rig.STRIB: 0.04, other_rig.STRIB_W: 8.0}),
    ):
        series = record(plant, ("weave",), seed=len(state), seconds=30.0)[f"weave_{len(state)}"]
        names[state] = tmp_path / f"{state}.csv"
        first = next(iter(series.values()))
        table = [first.t_ns * 1e-9, *(one.value for one in series.values())]
        header = ",".join(["time_s", *series])
        np.savetxt(names[state], np.column_stack(table), delimiter=",", header=header, comments="")
    out, page, model = (tmp_path / one for one in ("out.json", "page.html", "after.yaml"))
    words = ["changes", "--model", MODEL, "--before", str(names["before"])]
    words += ["--after", str(names["after"]), "--json", str(out)]
    assert main([*words, "--report", str(page), "--write-model", str(model)]) == 0
    assert "Stribeck friction [stribeck]" in capsys.readouterr().out
    content = json.loads(out.read_text())
    assert content["before"]["verdict"] == "no_mismatch"
    assert [one["change"]["is"] for one in content["findings"]] == ["new"]
    assert "against the first state" in page.read_text()
    assert [one["effect"] for one in load_model(model).effects] == ["stribeck"]
