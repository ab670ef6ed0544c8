"""Names beside a law that has none: found where they are there, and not where they are not."""

from collections.abc import Callable
from types import ModuleType
from typing import Any

import pytest

from eps_hil.diagnosis.accept.beside_law import beside_law
from eps_hil.diagnosis.accept.holdout_support import holdout_support
from eps_hil.diagnosis.attribute.select import select
from eps_hil.diagnosis.remainder.find import rounded

BRAKE_NM, SPRING = 0.05, 4e-4


@pytest.mark.slow
@pytest.mark.parametrize("spring", [SPRING, 0.0])
def test_a_spring_beside_an_eddy_current_brake(
    fitted_and_kept: Callable[..., Any], other_rig: ModuleType, spring: float
) -> None:
    """The brake leaves many times what the spring does; alone, it brings no name with it."""
    plant = {other_rig.EDDY: BRAKE_NM, other_rig.EDDY_W: 30.0, other_rig.SPRING: spring}
    problem, judged = fitted_and_kept(plant)
    selection = select(problem)
    findings = holdout_support(problem, selection, judged)
    found = beside_law(problem, ((selection, ()), (selection, findings)), judged, measured=True)
    if not spring:
        assert found is None
        return
    assert found is not None
    (k,) = found.findings
    entry = found.selection.found.entries[k]
    assert entry["effect"] == "unmodelled_spring"
    half = found.selection.found.half_width[k, "stiffness_nm_per_rad"]
    assert entry["stiffness_nm_per_rad"] == pytest.approx(spring, abs=max(half, 0.03 * spring))
    assert found.remainder.share > 0.95
    assert {"unmodelled_spring", "empirical"} == {
        str(one["effect"]) for one in found.remainder.model.effects
    }
    for one in found.remainder.model.effects:  # as a file is written
        assert dict(one) == rounded(one)
    assert len(found.selection.found.own) == len(
        [name for name in found.told.found.own if not name.startswith("law.")]
    )
