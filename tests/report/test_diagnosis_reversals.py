"""The picture of a bristle's stiffness: what the balance leaves about full reversals."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from eps_hil.diagnosis.given_load import Diagnosis
from eps_hil.proof.world import World
from eps_hil.report import diagnosis_page, diagnosis_reversals

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module", params=[True, False], ids=["lugre", "slip elements"])
def softer(
    request: pytest.FixtureRequest, diagnosed_world: Callable[[World], Diagnosis]
) -> Diagnosis:
    """A bristle 15 % softer than the model file's."""
    rig = World(simple=request.param)
    rig = replace(rig, drive=rig.drive._replace(sigma0=0.85 * rig.drive.sigma0))
    return diagnosed_world(rig)


def test_the_blip_is_gone_with_the_finding(softer: Diagnosis) -> None:
    plot = diagnosis_reversals.figure(softer)
    assert plot is not None
    noise = 0.5 * plot.lines[1].y[0]  # of a mean, mNm
    before, after = (line.y for line in plot.lines[2:])
    at_the_turn = np.abs(plot.x) < 30.0
    assert np.nanmax(np.abs(before[at_the_turn])) > 8.0 * noise
    assert np.nanmax(np.abs(after)) < 0.4 * np.nanmax(np.abs(before))
    assert np.nansum(after**2) < 0.1 * np.nansum(before**2)


def test_the_page_draws_it(softer: Diagnosis) -> None:
    page = diagnosis_page.render(softer, "rig.yaml")
    assert '"name": "reversals"' in page
    assert "Mean over full reversals" in page
    assert "No curve over a measured signal" not in page


def test_without_reversals_there_is_no_picture(softer: Diagnosis) -> None:
    short = [one.cut(0, 4000) for one in softer.problem.recordings]
    problem = softer.problem.__class__(short, softer.problem.model)
    assert diagnosis_reversals.figure(replace(softer, problem=problem, judged=[])) is None
