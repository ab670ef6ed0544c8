"""The page of a diagnosis: whole, escaped, self-contained, and right for every verdict."""

import json
import shutil
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from eps_hil.diagnosis.accept.free_run import free_runs
from eps_hil.diagnosis.attribute.channel_fault import ChannelFault
from eps_hil.diagnosis.data.prepare import Prepared
from eps_hil.diagnosis.data.quality import Channel, Quality
from eps_hil.diagnosis.diagnose import diagnose
from eps_hil.diagnosis.given_load import Diagnosis
from eps_hil.physics.model import Model, load_model
from eps_hil.report import diagnosis_page
from eps_hil.report.diagnosis_evidence import LABELS, acts_over, held_out, shows
from eps_hil.report.diagnosis_figures import _shown, holdouts
from eps_hil.report.diagnosis_maps import colour
from eps_hil.report.page import number
from eps_hil.report.plots import numbers, thinned, ticks
from eps_hil.series import Series

ROOT = Path(__file__).parents[2]
EVIL = "<script>alert(1)</script>&\"'.csv"
_VOID = {"meta", "rect", "br", "link"}


def _diagnosed(rig: ModuleType, effects: dict[str, float]) -> Diagnosis:
    plant = rig.Effects({getattr(rig, name): value for name, value in effects.items()})

    def recorded(manoeuvre: str, seed: int) -> dict[str, Series]:
        columns = rig.record(plant, manoeuvre, seed, seconds=12.0)
        t_ns = np.round(columns.pop("time_s") * 1e9).astype(np.int64)
        return {name: Series(t_ns, np.asarray(v, np.float64)) for name, v in columns.items()}

    model = load_model(ROOT / "configs" / "reference_rig.yaml")
    fitted = {EVIL: recorded("sweep", 1), "weave.csv": recorded("weave", 2)}
    return diagnose(model, fitted, {"kept.csv": recorded("sweep", 3)})


@pytest.fixture(scope="module")
def explained(other_rig: ModuleType) -> Diagnosis:
    return _diagnosed(other_rig, {"SPRING": 0.004})


@pytest.fixture(scope="module")
def page(explained: Diagnosis) -> str:
    return diagnosis_page.render(explained, "rig & co.yaml")


@pytest.fixture(scope="module")
def checked(page: str) -> "_Checked":
    return _Checked(page)


class _Checked(HTMLParser):
    """Every element closed in order; texts by element id, and all attributes that load."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.loads: list[str] = []
        self.ids: list[str] = []
        self.holders: list[str] = []
        self.scripts: list[str] = []
        self.text = ""
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in _VOID:
            self.open.append(tag)
        for name, value in attrs:
            if name in ("src", "href", "action", "data", "poster", "xlink:href"):
                self.loads.append(value or "")
            if name == "id":
                self.ids.append(value or "")
            if name == "data-plot":
                self.holders.append(value or "")

    def handle_endtag(self, tag: str) -> None:
        if tag not in _VOID:
            assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] == "script":
            self.scripts.append(data)
        elif not self.open or self.open[-1] != "style":
            self.text += data


def _plots(checked: _Checked) -> list[dict[str, Any]]:
    loaded: list[dict[str, Any]] = json.loads(checked.scripts[0])
    return loaded


_ROOM = """() => JSON.parse(document.getElementById("plots").textContent).map((plot) => {
  const pen = document.createElement("canvas").getContext("2d");
  pen.font = "12px system-ui, 'DejaVu Sans', sans-serif";
  const area = document.querySelector(`.plot[data-plot="${plot.name}"] .u-over`).style;
  const middle = parseFloat(area.top) + parseFloat(area.height) / 2;
  return [plot.name, middle, pen.measureText(plot.y_label).width];
})"""


def test_no_label_beside_an_axis_is_cut(page: str, tmp_path: Path) -> None:
    """Its middle is the middle of the plot: half of it has to fit above."""
    chromium = shutil.which("chromium")
    if chromium is None:
        pytest.skip("no Chromium here")
    playwright = pytest.importorskip("playwright.sync_api")
    (tmp_path / "page.html").write_text(page)
    with playwright.sync_playwright() as play:
        browser = play.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        shown = browser.new_page(viewport={"width": 1366, "height": 900})
        shown.goto(f"file://{tmp_path}/page.html")
        shown.wait_for_selector(".u-over", state="attached")
        rooms = shown.evaluate(_ROOM)
        browser.close()
    assert any("motor_speed" in name for name, _, _ in rooms)
    for name, middle, wide in rooms:
        assert middle >= 0.5 * wide, name


def test_page_is_whole_and_loads_nothing(page: str, checked: _Checked) -> None:
    assert checked.open == []
    assert all(link.startswith("#") for link in checked.loads)
    assert "url(" not in page
    assert "@import" not in page
    assert "default-src 'none'" in page
    assert len(checked.ids) == len(set(checked.ids))
    assert len(page.encode()) < 2_000_000


def test_the_figures_at_the_top_fit_in_one_row(page: str, explained: Diagnosis) -> None:
    """Speed and angle of the free run are one of them."""
    tiles = page.split('<div class="tile">')[1:]
    assert len(tiles) == 4
    freely = tiles[-1].split("</div>")[0]
    assert "error of the speed and angle, hold-outs" in freely
    for part in ("baseline", "augmented"):
        run = explained.content["fit"]["holdout"][part]["free_run"]
        for name in ("speed_rmse_rad_s", "angle_rmse_rad"):
            assert f">{number(run[name])}<" in freely


def test_every_plot_has_its_place_and_its_units(checked: _Checked) -> None:
    plots = _plots(checked)
    names = [plot["name"] for plot in plots]
    assert sorted(names) == sorted(checked.holders)
    assert len(names) == len(set(names))
    for plot in plots:
        assert any(unit in plot["y_label"] for unit in ("mNm", "N", "rad/s")), plot["name"]
        lengths = {len(column) for column in plot["data"]}
        assert len(lengths) == 1
        assert len(plot["data"]) == 1 + len(plot["lines"])
        assert plot["data"][0] == sorted(plot["data"][0])


def test_page_tells_what_the_json_holds(explained: Diagnosis, checked: _Checked) -> None:
    text = checked.text
    content = explained.content
    assert content["verdict"] == "explained"
    assert [one["effect"] for one in content["findings"]] == ["unmodelled_spring"]
    finding = content["findings"][0]
    stiffness = finding["parameters"]["stiffness_nm_per_rad"]
    assert finding["summary"] in text
    assert finding["equation"] in text
    for value in (stiffness["value"], *stiffness["ci95"]):
        assert number(value, 4) in text
    before, after = (
        {**content["fit"]["holdout"][one], **content["fit"]["holdout"][one]["free_run"]}
        for one in ("baseline", "augmented")
    )
    for name in before.keys() - {"free_run"}:
        assert name in text
        assert number(before[name], 4) in text
        assert number(after[name], 4) in text
    assert "explained by unmodelled spring" in text


def test_term_is_drawn_as_it_acts(explained: Diagnosis, checked: _Checked) -> None:
    """A spring's torque over the rotor angle is a line through zero with its stiffness."""
    (plot,) = (one for one in _plots(checked) if one["name"] == "finding0")
    assert plot["x_label"] == "rotor angle in rad"
    angle, term = np.array(plot["data"][0]), np.array(plot["data"][-1], dtype=np.float64)
    slope = np.polyfit(angle, term * 1e-3, 1)[0]
    fitted = explained.content["findings"][0]["parameters"]["stiffness_nm_per_rad"]["value"]
    assert abs(slope) == pytest.approx(fitted, rel=0.05)


def test_names_from_files_are_text(page: str, checked: _Checked) -> None:
    assert "<script>alert" not in page
    assert "&lt;script&gt;alert(1)&lt;/script&gt;" in page
    assert EVIL in checked.text
    assert "rig & co.yaml" in checked.text


def test_ablation_lists_every_term(page: str, checked: _Checked) -> None:
    assert "all but unmodelled spring" in checked.text
    assert "sensor noise alone" in checked.text
    assert "the ceiling: with boosted trees on top" in page


@pytest.mark.slow
def test_page_of_nothing_missing(other_rig: ModuleType) -> None:
    result = _diagnosed(other_rig, {})
    assert result.content["verdict"] == "no_mismatch"
    checked = _Checked(diagnosis_page.render(result, "m.yaml"))
    assert checked.open == []
    assert "Nothing is missing" in checked.text
    assert "No finding" in checked.text
    plots = _plots(checked)
    assert sorted(plot["name"] for plot in plots) == sorted(checked.holders)
    assert all(line["style"] != "after" for plot in plots for line in plot["lines"])


@pytest.mark.slow
def test_page_of_two_states_says_what_changed(explained: Diagnosis) -> None:
    change: dict[str, Any] = {
        "is": "new",
        "before": [],
        "size_after": None,
        "numbers": [],
        "share_before": None,
    }
    found = [{**explained.content["findings"][0], "change": change}]
    first = {"findings": [{"effect": "stribeck"}]}
    content = {**explained.content, "findings": found, "before": first, "seen_in": "after"}
    content["undecided"] = []

    def page_of(content: dict[str, Any]) -> str:
        result = replace(explained, content=content)
        return _Checked(diagnosis_page.render(result, "m.yaml")).text

    text = page_of(content)
    assert "Two states of one rig, against m.yaml" in text
    assert "What has changed: unmodelled spring (new)." in text
    assert "the first state has Stribeck friction." in text
    assert "the baseline model, which is the first state" in text
    assert "The mismatch is explained" not in text
    assert "which is the second state" in page_of({**content, "seen_in": "before"})
    gone = {**change, "is": "gone", "share_after": {"value": 0.1, "ci95": [0.05, 0.15]}}
    del gone["share_before"]
    told = page_of({**content, "findings": [{**found[0], "change": gone}], "seen_in": "before"})
    assert "the second recordings hold 5 to 15 %" in told
    nothing = page_of({**content, "findings": [], "before": {"findings": []}})
    assert "Nothing has changed that these recordings could show." in nothing
    assert "Beyond the model file" not in nothing
    open_one = page_of({**content, "findings": [], "undecided": ["unknown"]})
    assert "Not decided whether anything has changed" in open_one


def test_what_is_wrong_with_the_data_is_said_once_and_with_the_names_of_the_axes(
    explained: Diagnosis,
) -> None:
    """A recording of which a part is kept from the fit is looked at in two parts."""
    channels = [
        Channel(name, 1e3, 0.0, 3, 6000, ((16.127, 16.229),), (), (), 0.0, 0.0, 0).content()
        for name in ("motor_speed_rad_s", "steering_wheel_angle_rad")
    ]
    channels += [
        {"signal": "motor_torque_nm", "flags": ["coarse"]},
        {"signal": "rack_force_n", "flags": []},
    ]
    look = {**explained.content["data_quality"][0], "recording": "my_bus.log", "channels": channels}
    content = {**explained.content, "data_quality": [look, look]}
    text = _Checked(diagnosis_page.render(replace(explained, content=content), "m.yaml")).text
    together = "my_bus.log: gaps from 16.1 s on, lost frames: rotor speed, steering-wheel angle"
    assert text.count(together) == 1
    assert text.count("my_bus.log: coarse: motor torque") == 1
    assert text.count("my_bus.log: ") == 2


_CURVE = [[-0.01, 0.002, 0.001], [0.01, 0.02, 0.001]]


@pytest.mark.parametrize(
    ("verdict", "curve"),
    [
        ("unknown_effect", _CURVE),
        pytest.param("partly_explained", [], marks=pytest.mark.slow),
        pytest.param("unknown_effect", [], marks=pytest.mark.slow),
        pytest.param("partly_explained", _CURVE, marks=pytest.mark.slow),
    ],
)
def test_page_of_an_unknown(explained: Diagnosis, verdict: str, curve: list[Any]) -> None:
    unknown = {
        "effect": "unknown",
        "kind": "structure",
        "confidence": 0.9,
        "equation": "",
        "summary": "Something is left <b>here</b>.",
        "parameters": {},
        "where": [
            {"signal": "rack_position_m|left", "from": -0.01, "to": 0.01, "share_of_excess": 0.4}
        ],
        "curve": curve,
        "confusable_with": [],
        "next_experiment": "",
    }
    named = explained.content["findings"] if verdict == "partly_explained" else []
    content = {**explained.content, "verdict": verdict, "findings": [*named, unknown]}
    model = explained.model if named else explained.problem.model
    result = Diagnosis(content, model, explained.problem, explained.selection, explained.judged, [])
    checked = _Checked(diagnosis_page.render(result, "m.yaml"))
    assert checked.open == []
    assert "Something is left <b>here</b>." in checked.text
    assert "no known effect explains" in checked.text
    plots = {plot["name"]: plot for plot in _plots(checked)}
    assert ("unknown" in plots) == bool(curve)
    if curve:
        assert plots["unknown"]["x_label"] == "rack position in m, turning negative"
        assert plots["unknown"]["data"][-1] == [2.0, 20.0]
        assert plots["unknown"]["data"][1] == [1.0, 19.0]
        assert "50.3 N" in checked.text  # 20 mNm at 2513 rad/m


def test_page_of_a_law_shows_it_beside_the_residual(explained: Diagnosis) -> None:
    """The spring, as if the catalogue had no name for it."""
    angle = "motor_angle_rad"
    law = {
        "effect": "empirical", "form": "law", "where": "rotor", "how": "sum", "inputs": [angle],
        "memory": ["none"], "shapes": ["linear"], "size": 0.004, "range": {angle: [-99.0, 99.0]},
    }  # fmt: skip
    told = {**law, "holdout_share_removed": 1.0, "ci95": [0.9, 1.0]}
    (spring,) = explained.content["findings"]
    unknown = {**spring, "effect": "unknown", "curve": _CURVE, "model": told, "resembles": []}
    content = {**explained.content, "verdict": "unknown_effect", "findings": [unknown]}
    model = replace(explained.problem.model, effects=(law,))
    result = Diagnosis(content, model, explained.problem, explained.selection, explained.judged, [])
    checked = _Checked(diagnosis_page.render(result, "m.yaml"))
    assert checked.open == []
    plot = next(one for one in _plots(checked) if one["name"] == "finding0")
    assert plot["x_label"] == "rotor angle in rad"
    seen, drawn = (np.array(plot["data"][k]) for k in (3, 4))
    assert np.ptp(drawn) > 10.0
    assert float(np.max(np.abs(seen - drawn))) < 0.1 * np.ptp(drawn)
    assert "the residual when this law alone is taken out" in checked.text


def test_a_ripple_of_the_load_is_drawn_over_its_own_phase() -> None:
    """Of a load of the other sign it is half a period on; else both would cancel."""
    law = {
        "effect": "empirical", "form": "law", "inputs": ["rack_force_n", "motor_angle_rad"],
        "memory": ["none", "none"], "shapes": ["linear", "sine"], "order_2": 2.0,
    }  # fmt: skip
    angle, force = np.linspace(0.0, 20.0, 500), np.where(np.arange(500) % 3 > 0, 800.0, -300.0)
    signals = {"motor_angle_rad": angle, "rack_force_n": force}
    evidence = cast(Any, SimpleNamespace(signals=signals))
    assert shows(law, evidence)
    name, turn = acts_over(law, [], evidence)
    assert name == "angle of order 2 per rotor turn in °"
    torque = force * np.sin(2.0 * angle)
    np.testing.assert_allclose(np.abs(force) * np.sin(np.radians(turn)), torque, atol=1e-9)
    assert not shows({**law, "memory": ["lag", "none"]}, evidence)
    assert not shows({**law, "form": "curve"}, evidence)
    name, over = acts_over({**law, "shapes": ["linear", "gaussian"]}, [], evidence)
    assert (name, over is angle) == ("rotor angle in rad", True)


def test_page_of_a_signal_that_is_late(explained: Diagnosis) -> None:
    """It is put right, so there is an after; no effect of the drive is to blame."""
    late = ChannelFault("rack_force_n", late_s=0.012, share=0.97)
    unknown = late.finding(explained.problem.model)
    content = {**explained.content, "verdict": "unknown_effect", "findings": [unknown]}
    parts = explained.model, explained.problem, explained.selection, explained.judged
    checked = _Checked(diagnosis_page.render(Diagnosis(content, *parts, []), "m.yaml"))
    assert checked.open == []
    assert "explained by one signal that is wrong, and by no effect of the drive" in checked.text
    assert "12 ms later than the model file says" in checked.text
    assert "Blue: with the findings." in checked.text
    assert "corrected in all that follows" in checked.text


@pytest.mark.parametrize(
    ("fitted", "kept", "said"),
    [
        (["a/r.log"], ["a/r.log"],
         "Fitted: the first two thirds of r.log. Kept from the fit: the last third of r.log."),
        (["a/r.log", "a/s.log"], ["a/t.log"], "Fitted: r.log, s.log. Kept from the fit: t.log."),
    ],
)  # fmt: skip
def test_parts_of_one_recording_are_told_apart(
    fitted: list[str], kept: list[str], said: str
) -> None:
    def names(of: list[str]) -> list[Any]:
        return [SimpleNamespace(name=one, prepared=SimpleNamespace(name=one)) for one in of]

    problem = SimpleNamespace(recordings=names(fitted))
    assert (
        diagnosis_page._split(cast(Diagnosis, SimpleNamespace(problem=problem, judged=names(kept))))
        == said
    )


def test_a_load_that_nobody_measured_is_not_drawn_as_a_load_cell(explained: Diagnosis) -> None:
    """It was, and a right model, which leaves that load out, looked as if it ruined the force."""
    evidence = held_out(explained)
    (measured, *_) = holdouts(explained, evidence)
    assert [one.name for one in measured["plots"]][-1] == "holdout0-force"
    judged = [
        replace(one, prepared=one.prepared.changed(load_is_assumed=True))
        for one in explained.judged
    ]
    (assumed, *_) = holdouts(replace(explained, judged=judged), evidence)
    names = [one.name for one in assumed["plots"]]
    assert names
    assert "holdout0-force" not in names
    assert assumed["plots"][-1].x_label == "time in s"


def test_an_axis_reaches_to_where_a_term_acts() -> None:
    """A stop at the ends of the travel, where the rack hardly ever is."""
    x = np.sin(np.linspace(0.0, 60.0, 20_000)) ** 5
    stop = np.where(np.abs(x) > 0.9999, np.sign(x), 0.0)
    seen = np.percentile(x, [0.5, 99.5])
    low, high = _shown(x, stop)
    assert low < -0.9999 < seen[0]
    assert high > 0.9999 > seen[1]
    assert _shown(x, np.ones(len(x))) == pytest.approx(tuple(seen), abs=1e-3)


def test_two_ends_of_one_signal_are_told_together() -> None:
    ends = [
        {"signal": "rack_position_m", "from": low, "to": high, "share_of_excess": share}
        for low, high, share in ((-0.017, -0.016, 0.33), (0.016, 0.017, 0.66))
    ]
    force = {"signal": "rack_force_n", "from": 1.0, "to": 2.0, "share_of_excess": 0.9}
    content = {"findings": [{"effect": "end_stop", "where": [*ends, force]}]}
    assert diagnosis_page._located(content) == (
        "end stop: 99 % of it at rack position −0.017 to −0.016 m "
        "and rack position 0.016 to 0.017 m"
    )


def test_thinned_keeps_peaks() -> None:
    values = np.zeros(10_000)
    values[1234], values[7777] = 5.0, -4.0
    rows = thinned(values, 100)
    assert len(rows) <= 101
    assert {1234, 7777} <= set(rows.tolist())
    assert thinned(values[:50], 100).tolist() == list(range(50))


def test_numbers_are_json() -> None:
    assert numbers(np.array([1.23456789, np.nan, np.inf])) == [1.2346, None, None]
    assert [number(v) for v in (0.0, -1.5, float("nan"), None, 12345.0, 2e-9)] == [
        "0", "−1.5", "–", "–", "12345", "2e−9",
    ]  # fmt: skip


def test_colours_rise_in_lightness() -> None:
    light = []
    for part in np.linspace(0, 1, 9):
        red, green, blue = (int(colour(float(part))[k : k + 2], 16) for k in (1, 3, 5))
        light.append(0.2126 * red + 0.7152 * green + 0.0722 * blue)
    assert light == sorted(light)


def test_where_is_told_in_one_and_two_signals(
    explained: Diagnosis, page: str, checked: _Checked
) -> None:
    cells = explained.content["location"]["cells"]
    assert cells
    assert "% of the mismatch sits in" in checked.text
    assert "where it stands out" in checked.text
    two = [cell for cell in cells if len(cell["signals"]) == 2]
    for signal in two[0]["signals"]:
        assert LABELS[signal] in checked.text
    assert 'class="frame"' in page


def test_names_that_help_no_holdout_for_sure_are_no_whole_explanation(
    explained: Diagnosis,
) -> None:
    content = {**explained.content, "verdict": "partly_explained"}
    values, _ = diagnosis_page.values_of(replace(explained, content=content))
    assert values["verdict"].endswith("do not get better by it beyond chance.")


def test_placebos_stand_beside_the_gain(explained: Diagnosis, checked: _Checked) -> None:
    text = checked.text
    (term,) = explained.content["fit"]["placebo"]
    for value in (term["gain"], term["placebo_gain_most"]):
        assert number(value) in text
    assert term["placebo_gain_most"] < 0.5 * term["gain"]


@pytest.mark.slow
def test_two_orders_of_one_effect_are_told_apart(other_rig: ModuleType) -> None:
    plant = {"COG": 0.015, "COG_N": 6.0, "COG2": 0.01, "COG2_N": 12.0}
    page = diagnosis_page.render(_diagnosed(other_rig, plant), "rig.yaml")
    text = _Checked(page).text
    assert "The mismatch is explained by cogging torque." in text
    for order in (6, 12):
        assert f"repeats {order} times a rotor turn" in text
        assert f"angle of order {order} per rotor turn" in page
        assert text.count(f"cogging torque of order {order}") == 2  # ablation and placebo


def test_sentences_name_signals_as_people_do() -> None:
    said = diagnosis_page.plain("against motor_torque_offset: follows abs_motor_speed_rad_s")
    assert said == "against motor torque offset: follows rotor speed either way"
    said = diagnosis_page.plain("over abs_rack_force_n and load_power_sign")
    assert said == "over size of rack force and whether the load drives or brakes"


def test_ticks_are_round_and_inside() -> None:
    assert ticks(-0.0209, 0.0197) == [-0.02, -0.01, 0.0, 0.01]
    assert ticks(0.0, 45.0, 8) == [0.0, 10.0, 20.0, 30.0, 40.0]
    assert ticks(3.0, 3.0) == [3.0]


def test_a_finding_may_shift_which_half_seconds_slide(
    explained: Diagnosis, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A late speed does: what is compared is what both models were run over."""
    whole = free_runs

    def fewer(one: Prepared, model: Model, quality: Quality | None) -> tuple[Any, Any, Any]:
        parts = whole(one, model, quality)
        first = 0 if model is explained.problem.model else 500
        return parts[0][first:], parts[1][first:], parts[2][first:]

    monkeypatch.setattr("eps_hil.report.diagnosis_figures.free_runs", fewer)
    plots = _plots(_Checked(diagnosis_page.render(explained, "rig.yaml")))
    speed = next(one for one in plots if one["name"].endswith("-speed"))
    times = whole(explained.judged[0].prepared, explained.problem.model)[0]
    assert min(speed["data"][0]) >= times[500] - 1e-6
    assert {len(column) for column in speed["data"]} == {len(speed["data"][0])}
    assert [line["style"] for line in speed["lines"]] == ["before", "after"]


def test_rotor_and_rack_apart_without_a_name_have_a_plot_of_their_own(
    explained: Diagnosis,
) -> None:
    unknown = {
        "effect": "unknown",
        "kind": "structure",
        "confidence": 0.95,
        "equation": "",
        "summary": "Rotor and rack move apart.",
        "parameters": {},
        "where": [{"signal": "rack_force_n", "from": -900, "to": 900, "share_of_excess": 0.4}],
        "curve": [[-900.0, -0.05, 0.001], [900.0, 0.05, 0.001]],
        "confusable_with": [],
        "next_experiment": "",
        "seen_in": "kinematics",
    }
    torque = {**unknown, "curve": [[-0.01, 0.002, 0.001], [0.01, 0.02, 0.001]]}
    del torque["seen_in"]
    content = {**explained.content, "verdict": "unknown_effect", "findings": [unknown, torque]}
    problem = explained.problem
    result = Diagnosis(content, problem.model, problem, explained.selection, explained.judged, [])
    checked = _Checked(diagnosis_page.render(result, "m.yaml"))
    assert checked.open == []
    plots = {plot["name"]: plot for plot in _plots(checked)}
    assert {"unknown", "unknown-apart"} <= set(plots)
    assert plots["unknown-apart"]["y_label"] == "φ − i·x, mrad"
    assert plots["unknown-apart"]["data"][-1] == [-50.0, 50.0]
    assert "up to 0.0199 mm" in checked.text


def test_a_load_that_nobody_measured_is_drawn_as_the_written_model_makes_it(
    explained: Diagnosis,
) -> None:
    """Not with the force that was fitted in its place, which is in no file."""
    given = explained.problem.model
    written = replace(
        given, effects=({"effect": "unmodelled_spring", "stiffness_nm_per_rad": 0.02},)
    )
    (kept,) = explained.judged
    assumed = replace(kept, prepared=kept.prepared.changed(load_is_assumed=True))
    told = replace(
        explained, model=written, given=given, beside_load=explained.model, judged=[assumed]
    )
    (shown,) = holdouts(told, held_out(told))
    (speed,) = (plot for plot in shown["plots"] if plot.name == "holdout0-speed")
    for line, model in zip(speed.lines, (given, written), strict=True):
        time, run, measured = free_runs(assumed.prepared.as_measured(), model, assumed.quality)
        known = np.isfinite(line.y)
        rows = np.searchsorted(time, speed.x[known] - 1e-9)
        np.testing.assert_allclose(line.y[known], (run - measured)[rows], atol=1e-9)
