"""A learnt map is drawn in its range, in the units of where it acts."""

import pytest

from eps_hil.report.diagnosis_map import COLUMNS, ROWS, maps

TERM = {
    "form": "map", "where": "friction", "how": "sum",
    "inputs": ["abs_rack_force_n", "torque_sensor_nm"],
    "knots": [[0.0, 1000.0], [-2.0, 0.0, 2.0]],
    "values": [[0.0, 0.0, 0.0], [0.01, 0.02, 0.03]],
    "range": {"abs_rack_force_n": [0.0, 500.0]},
}  # fmt: skip


def test_values_are_straight_between_knots_in_the_range_that_was_seen() -> None:
    (drawn,) = maps({"model": {"terms": [TERM, {**TERM, "inputs": ["time_s"]}]}})
    assert drawn["title"] == "friction, mNm"
    assert len(drawn["cells"]) == COLUMNS * ROWS
    last = next(c for c in drawn["cells"] if c["column"] == COLUMNS - 1 and c["row"] == 0)
    share, high = (
        (COLUMNS - 0.5) / COLUMNS * 0.5,
        20.0 + 10.0 * (ROWS - 0.5 - 0.5 * ROWS) / (0.5 * ROWS),
    )
    assert last["value"] == pytest.approx(share * high)
    assert drawn["high"] == last["value"]
    assert drawn["axes"][0]["label"] == "size of rack force in N"
    assert drawn["axes"][0]["ticks"][-1] == (1.0, 500.0)


def test_a_factor_is_told_in_percent_and_a_law_is_no_map() -> None:
    (drawn,) = maps({"model": {"terms": [{**TERM, "how": "factor", "range": {}}]}})
    assert drawn["title"] == "friction, %"
    assert drawn["high"] == pytest.approx(100.0 * 0.03, rel=0.06)
    law = {"inputs": ["time_s", "motor_speed_rad_s"], "shapes": ["linear", "linear"]}
    assert maps({"model": {"terms": [law]}}) == maps({}) == []


def test_a_cell_within_its_band_is_not_sure() -> None:
    """Where nothing was seen (None), nothing is."""
    band = [[0.001, 0.001, None], [0.001, 0.05, None]]
    (drawn,) = maps({"model": {"terms": [TERM], "band": [band]}})
    sure = {(cell["column"], cell["row"]): cell["sure"] for cell in drawn["cells"]}
    assert sure[COLUMNS - 1, ROWS - 1]
    assert not sure[0, ROWS - 1]
    assert not any(sure[i, 0] for i in range(COLUMNS))
