"""Units behind numbers, and where a template writes them."""

from eps_hil.report import page
from eps_hil.unit_words import of, spaced


def test_a_number_without_a_dimension_has_no_unit() -> None:
    assert f"3{spaced('1')}" == "3"
    assert f"3{spaced('')}" == "3"
    assert f"3{spaced('Nm')}" == "3 Nm"
    assert [of(one) for one in ("1", "", "rad/s")] == ["", "", "rad/s"]


def test_an_investigation_says_a_gain_without_a_unit() -> None:
    """Its page said "gain: 3 1"."""
    found = {
        "effect": "torque_sensor_gain", "summary": "", "confidence": 1.0, "confusable_with": [],
        "parameters": {
            "gain": {"value": 3.0, "unit": "1", "ci95": [2.9, 3.1]},
            "level_nm": {"value": 0.5, "unit": "Nm", "ci95": None},
        },
    }  # fmt: skip
    empty = ("open_effects", "not_told_apart", "not_shown_here", "limits")
    last = {
        "findings": [found],
        "verdict": "explained",
        "discrepancy": 1.0,
        **dict.fromkeys(empty, ()),
    }
    html = page.fill(
        "investigation.html.jinja", "eps_hil.investigate", last=last, rows=[], page_css="",
        end="", why="", minutes=1.0, verdict="explained", model_file="m.yaml",
    )  # fmt: skip
    assert "gain: 3 (2.9 to 3.1)<br>" in html
    assert "level nm: 0.5 Nm<br>" in html
