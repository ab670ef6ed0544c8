"""The level of one slide, from motions whose torque is known in closed form; and the result."""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eps_hil.adaptation.injection_result import (
    Repetition,
    level_of,
    mark_outliers,
    result_of,
    student_t95,
)
from eps_hil.adaptation.slide import Slide, SlideLevel
from eps_hil.physics.model import Model, load_model

SlideLevelOf = Callable[[Slide, Model, bool, float], SlideLevel | None]
MODEL = load_model(Path(__file__).parents[2] / "configs" / "reference_rig.yaml")
STEP = 1e-3


def closed_form(
    model: Model, level: float, *, peak: float, spring: float = 0.0, force_n: float = 0.0
) -> Slide:
    """ω = peak sin²(πt/T): travel and acceleration by hand, torque by eq. 1d, 2a and 3."""
    period = 0.6
    t = np.arange(0.0, period, STEP)
    speed = peak * np.sin(np.pi * t / period) ** 2
    travel = peak * (t / 2 - period / (4 * np.pi) * np.sin(2 * np.pi * t / period))
    acceleration = peak * np.pi / period * np.sin(2 * np.pi * t / period)
    f = model.friction
    share = 1.0 - np.exp(-travel * f.sigma0_nm_per_rad / level)
    friction = share * (
        level + f.viscous_pos_nm_s_per_rad * speed + f.load_pos_nm_per_n * abs(force_n)
    )
    sigma1 = f.sigma1_nm_s_per_rad * np.exp(-((speed / f.sigma1_speed_rad_s) ** 2))
    friction += sigma1 * speed * (1.0 - share)
    load = force_n / model.rack_to_rotor_ratio_rad_per_m
    torque = model.inertia_kg_m2 * acceleration + friction + load + spring * travel
    return Slide(STEP, torque, speed, travel, np.full_like(t, force_n))


@given(level=st.floats(0.02, 0.3), peak=st.floats(3.0, 30.0), force=st.floats(-200.0, 200.0))
def test_the_level_comes_back(
    slide_level_of: SlideLevelOf, reference_model: Model, level: float, peak: float, force: float
) -> None:
    slide = closed_form(reference_model, level, peak=peak, force_n=force)
    found = slide_level_of(slide, reference_model, True, 1.3 * level)
    assert found is not None
    assert found.offset_nm == pytest.approx(level, rel=0.01)
    assert found.travel_rad == pytest.approx(peak * 0.3, rel=0.02)


def test_noise_is_within_the_error_that_is_stated(
    slide_level_of: SlideLevelOf, reference_model: Model
) -> None:
    slide = closed_form(reference_model, 0.1, peak=5.0)
    rng = np.random.default_rng(4)
    errors, stated = [], []
    for _ in range(100):
        noisy = slide._replace(
            torque_nm=slide.torque_nm + 4e-3 * rng.standard_normal(len(slide.torque_nm)),
            speed_rad_s=slide.speed_rad_s + 0.25 * rng.standard_normal(len(slide.torque_nm)),
        )
        found = slide_level_of(noisy, reference_model, True, 0.1)
        assert found is not None
        errors.append(found.offset_nm - 0.1)
        stated.append(found.standard_error_nm)
    assert 0.5 < float(np.std(errors)) / float(np.mean(stated)) < 1.5
    assert abs(float(np.mean(errors))) < 3.0 * float(np.std(errors)) / 10.0


def test_what_the_torque_at_detection_is_too_large_by(
    slide_level_of: SlideLevelOf, reference_model: Model
) -> None:
    """Free ramp: J ω = r t²/2, so at the set-point the torque is √(2 J ω r) above the level."""
    inertia, ramp, level, speed = reference_model.inertia_kg_m2, 0.1, 0.056, 2.0
    end = math.sqrt(2 * inertia * speed / ramp)
    t = np.arange(0.0, end, 1e-4)
    travel = 1.0 + ramp * t**3 / (6 * inertia)  # the bristle is at its level already
    omega = ramp * t**2 / (2 * inertia)
    viscous = reference_model.friction.viscous_pos_nm_s_per_rad * omega
    slide = Slide(1e-4, level + ramp * t + viscous, omega, travel, np.zeros_like(t))
    found = slide_level_of(slide, reference_model, True, 0.06)
    assert found is not None
    assert found.offset_nm == pytest.approx(level, rel=2e-3)
    too_large = slide.torque_nm[-1] - viscous[-1] - level
    assert too_large == pytest.approx(math.sqrt(2 * inertia * speed * ramp), rel=1e-2)
    assert too_large > 0.15 * level


def test_no_slide_no_level(slide_level_of: SlideLevelOf, reference_model: Model) -> None:
    slide = closed_form(reference_model, 0.1, peak=5.0)
    short = slide._replace(
        torque_nm=slide.torque_nm[:15],
        speed_rad_s=slide.speed_rad_s[:15],
        travel_rad=slide.travel_rad[:15],
        force_n=slide.force_n[:15],
    )
    assert slide_level_of(short, reference_model, True, 0.1) is None


def test_a_spring_shows_as_drift(slide_level_of: SlideLevelOf, reference_model: Model) -> None:
    slide = closed_form(reference_model, 0.1, peak=5.0, spring=0.0073)
    found = slide_level_of(slide, reference_model, True, 0.1)
    assert found is not None
    assert found.drift_nm_per_rad == pytest.approx(0.0073, rel=0.15)


def repetition(number: int, direction: int, offset: float, **more: float) -> Repetition:
    one = Repetition(number, direction, offset, 2e-4, offset, "speed", 40.0, 0.8, 0.0, 1e-3)
    return replace(one, **more)  # type: ignore[arg-type]


def run_of(*offsets: float) -> list[Repetition]:
    return [repetition(k + 1, 1 if k % 2 == 0 else -1, o) for k, o in enumerate(offsets)]


def test_an_outlier_is_named_and_left_out() -> None:
    result = result_of(run_of(0.05, 0.1, 0.0502, 0.101, 0.08, 0.1005, 0.0498, 0.0995), 0.15, MODEL)
    assert result.positive.outliers == (5,)
    assert result.positive.offset_nm == pytest.approx(0.05)
    assert result.negative.outliers == ()
    assert result.accepted, "one of four is no reason to distrust the others"
    assert result.sum_nm == pytest.approx(0.15, rel=0.01)
    assert result.asymmetry_nm == pytest.approx(-0.05, rel=0.02)


def test_too_many_outliers_are_a_problem() -> None:
    result = result_of(
        run_of(0.05, 0.1, 0.0501, 0.1, 0.09, 0.1, 0.0502, 0.1, 0.02, 0.1), 0.15, MODEL
    )
    assert not result.accepted
    assert "2 of 5 repetitions lie apart (5, 9)" in result.problems[0]


def test_short_slides_and_springs_are_problems() -> None:
    short = [replace(one, lengths=1.0) for one in run_of(0.05, 0.1, 0.05, 0.1)]
    assert "too short in repetition 1, 3" in result_of(short, 0.15, MODEL).problems[0]
    sprung = [replace(one, drift_nm_per_rad=0.008) for one in run_of(0.05, 0.1, 0.0501, 0.1001)]
    assert "the rack force was not zero" in result_of(sprung, 0.15, MODEL).problems[0]


def test_the_interval_is_students(reference_model: Model) -> None:
    values = [0.05, 0.051, 0.049]
    level = level_of([repetition(k, 1, v) for k, v in enumerate(values)])
    half = 4.303 * float(np.std(values, ddof=1)) / math.sqrt(3)
    assert level.ci95_nm == pytest.approx((0.05 - half, 0.05 + half))
    alike = level_of([repetition(k, 1, 0.05) for k in range(3)])
    assert alike.ci95_nm[1] - 0.05 == pytest.approx(1.96 * 2e-4 / math.sqrt(3))
    formed = level_of([repetition(k, 1, 0.05, form_nm=1e-3) for k in range(50)])
    assert formed.ci95_nm[1] - 0.05 == pytest.approx(0.95e-3, rel=0.01), "common to all of them"
    assert mark_outliers([repetition(1, 1, 0.05)], 0.15)[0].outlier is False


@pytest.mark.parametrize(
    ("freedom", "point"), [(1, 12.706), (4, 2.776), (11, 2.201), (30, 2.042), (100, 1.984)]
)
def test_students_t(freedom: int, point: float) -> None:
    assert student_t95(freedom) == pytest.approx(point, abs=3e-3)
