"""Colours that one plot needs are told apart by the colour-blind: simulated, and measured.

Machado, Oliveira, Fernandes (2009), severity 1, on linear sRGB; differences are CIE 1976 (Lab).
"""

import re
from itertools import combinations
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from eps_hil.dashboard.traces import LOOPS, STRIPS, TRACES
from eps_hil.report.diagnosis_maps import scale
from eps_hil.report.figures import COLOURS

Floats = npt.NDArray[np.float64]
ROOT = Path(__file__).parents[2] / "eps_hil"
PAGE, REPORT = ROOT / "dashboard/page/dashboard.css", ROOT / "report/assets/page.css"
SEEN_BY = {
    "all": np.eye(3),
    "protanopia": np.array([[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216],
                            [-0.003882, -0.048116, 1.051998]]),
    "deuteranopia": np.array([[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413],
                              [-0.011820, 0.042940, 0.968881]]),
    "tritanopia": np.array([[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602],
                            [0.004733, 0.691367, 0.303900]]),
}  # fmt: skip
TO_XYZ = np.array([[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750],
                   [0.0193339, 0.1191920, 0.9503041]])  # fmt: skip
WHITE = np.array([0.95047, 1.0, 1.08883])
CLEAR = 25.0
"""Ten times what is just noticed side by side, and some more for lines apart."""
LINE, TEXT = 3.0, 4.5
"""Contrast to the background that WCAG 2 asks of graphics and of words."""


def linear(colour: str) -> Floats:
    c = np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)]) / 255
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)


def lab(colour: str, seen: Floats) -> Floats:
    xyz = TO_XYZ @ np.clip(seen @ linear(colour), 0.0, 1.0) / WHITE
    f = np.where(xyz > 216 / 24389, np.cbrt(xyz), (24389 / 27 * xyz + 16) / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


def apart(one: str, other: str) -> float:
    """The least difference that anybody sees."""
    seen = SEEN_BY.values()
    return min(float(np.linalg.norm(lab(one, m) - lab(other, m))) for m in seen)


def contrast(one: str, other: str) -> float:
    low, high = sorted(float(TO_XYZ[1] @ linear(each)) + 0.05 for each in (one, other))
    return high / low


def schemes(path: Path) -> dict[str, dict[str, str]]:
    """Variables of the light and of the dark scheme, the dark one on top of the light."""
    rules = re.findall(r":root[^{]*\{([^}]*)\}", path.read_text(encoding="utf-8"))
    light, dark = (dict(re.findall(r"--([\w-]+):\s*(#[0-9a-f]{6})", rule)) for rule in rules[:2])
    return {"light": light, "dark": light | dark}


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_lines_of_one_plot_on_the_page(scheme: str) -> None:
    palette = schemes(PAGE)[scheme]
    colour = {trace.name: f"c{trace.colour}" for trace in TRACES}
    plots = [names for _, names in STRIPS] + [names for _, _, names in LOOPS]
    for names in plots:
        for one, other in combinations((colour[name] for name in names), 2):
            assert apart(palette[one], palette[other]) > CLEAR, (one, other)
        for name in names:
            assert contrast(palette[colour[name]], palette["back"]) > LINE, name


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_lines_and_dots_of_one_plot_in_a_report(scheme: str) -> None:
    palette = schemes(REPORT)[scheme]
    for one, other in combinations(("before", "after", "ink"), 2):  # noise is dashed
        assert apart(palette[one], palette[other]) > CLEAR, (one, other)
    assert apart(palette["before"], palette["third"]) > CLEAR, "torque rising, torque falling"
    for name in ("before", "after", "third"):
        assert contrast(palette[name], palette["back"]) > LINE, name


@pytest.mark.parametrize("path", [PAGE, REPORT], ids=["page", "report"])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_words_can_be_read_and_good_is_told_from_bad(path: Path, scheme: str) -> None:
    palette = schemes(path)[scheme]
    for name in ("ink", "soft", "good", "bad"):
        assert contrast(palette[name], palette["back"]) > TEXT, name
    for kind in ("good", "bad"):
        if f"{kind}-back" in palette:
            assert contrast(palette[kind], palette[f"{kind}-back"]) > TEXT
    assert apart(palette["good"], palette["bad"]) > CLEAR


def test_the_scale_of_maps_rises_for_every_eye() -> None:
    for seen in SEEN_BY.values():
        lightness = [float(lab(colour, seen)[0]) for colour in scale()]
        assert all(np.diff(lightness) > 2.0), lightness


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_cell_that_was_not_visited_is_no_colour_of_the_scale(scheme: str) -> None:
    report, page = schemes(REPORT)[scheme], schemes(PAGE)[scheme]
    for colour in scale():
        assert apart(report["unseen"], colour) > 8.0
        assert apart(page["card"], colour) > 8.0
    template = (ROOT / "report/templates/diagnosis.html.jinja").read_text(encoding="utf-8")
    assert 'class="unseen"' in template
    assert not re.search(r'(?:fill|stroke)="#', template), "a colour that no scheme changes"


def test_the_first_two_colours_of_figures() -> None:
    """More lines than two have labels or styles of their own (Okabe and Ito's palette)."""
    assert apart(COLOURS[0], COLOURS[1]) > CLEAR
    for one, other in combinations(COLOURS, 2):
        assert apart(one, other) > 15.0


HUE_HALF_A_TURN = np.array([[-0.574, 1.430, 0.144], [0.426, 0.430, 0.144], [0.426, 1.430, -0.856]])
"""What CSS' hue-rotate(180deg) does to (red, green, blue)."""


def darkened(colour: str) -> str:
    """A picture's colour as the dark scheme shows it: the style sheet's filter, step by step."""
    css = REPORT.read_text(encoding="utf-8")
    found = re.search(
        r"\.picture \{ filter: invert\(([\d.]+)\) hue-rotate\(180deg\) brightness\(([\d.]+)\)", css
    )
    assert found
    invert, brighter = (float(each) for each in found.groups())
    rgb = np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)]) / 255
    rgb = rgb * (1 - invert) + (1 - rgb) * invert
    rgb = np.clip(brighter * np.clip(HUE_HALF_A_TURN @ rgb, 0, 1), 0, 1)
    return "#" + "".join(f"{round(255 * each):02x}" for each in rgb)


def test_pictures_in_the_dark() -> None:
    """The style sheet darkens Matplotlib pictures and keeps their contrast."""
    back, page = darkened("#ffffff"), schemes(REPORT)["dark"]["back"]
    assert apart(back, page) < 8.0, "no window of another shade"
    assert contrast(darkened("#000000"), back) > TEXT
    shown = [darkened(colour) for colour in COLOURS]
    assert all(contrast(colour, back) > LINE for colour in shown)
    assert apart(shown[0], shown[1]) > CLEAR
    for one, other in combinations(shown, 2):
        assert apart(one, other) > 10.0


def test_one_stylesheet_and_no_colour_beside_it() -> None:
    for template in ROOT.rglob("templates/*.jinja"):
        text = template.read_text(encoding="utf-8")
        style = "".join(re.findall(r"<style>(.*?)</style>", text, re.S))
        assert not re.search(r"#[0-9a-f]{3,6}\b", style), template.name


def test_no_minified_code_in_the_repository() -> None:
    for path in (*ROOT.rglob("*.js"), *ROOT.rglob("*.css")):
        longest = max(len(line) for line in path.read_text(encoding="utf-8").splitlines())
        assert longest < 400, f"{path.name} looks minified"
        assert ".min." not in path.name
