"""Two records of one manoeuvre with clocks of their own."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eps_hil.diagnosis.simulator.align import match, pair
from eps_hil.physics.model import Model, load_model
from eps_hil.series import Series

MODEL = load_model(Path(__file__).parents[3] / "configs" / "reference_rig.yaml")


def shape(t: npt.NDArray[np.float64], kind: int) -> npt.NDArray[np.float64]:
    rng = np.random.default_rng(kind)
    lines = zip(rng.uniform(0.1, 3.0, 12), rng.uniform(0, 6, 12), strict=True)
    return np.asarray(sum(np.sin(2 * np.pi * f * t + p) for f, p in lines))


def record(
    start: float, seconds: float, kind: int, step: float = 1e-3, noise: float = 0.0, late: float = 0
) -> Mapping[str, Series]:
    """Rack force (on time) and speed (late) of manoeuvre ``kind`` from its second ``start``."""
    t = np.arange(0.0, seconds, step)
    rng = np.random.default_rng(kind)
    t_ns = np.round((t + 1000.0) * 1e9).astype(np.int64)
    return {
        "rack_force_n": Series(
            t_ns, 500 * shape(t + start, kind) + noise * rng.standard_normal(len(t))
        ),
        "motor_speed_rad_s": Series(t_ns, 50 * shape(t + start - late, kind + 50)),
    }


@settings(max_examples=15)
@given(st.floats(-3.0, 3.0), st.sampled_from([1e-3, 4e-3, 1e-2]), st.integers(0, 9))
def test_the_offset_is_found_below_a_sample(offset: float, step: float, kind: int) -> None:
    """The trace starts ``offset`` seconds after the recording; the recorded speed is 4 ms late."""
    trace = record(5.0 + offset, 12.0, kind, step)
    recording = record(5.0, 15.0, kind, noise=20.0, late=0.004)
    found = match(trace, "r", recording, MODEL)
    assert found is not None
    assert found.offset_s == pytest.approx(offset, abs=3e-4)
    assert found.correlation > 0.99


def test_each_trace_finds_its_own_recording() -> None:
    traces = {f"t{k}": record(0.0, 10.0, k, 5e-3) for k in (3, 1, 2)}
    recordings = {f"r{k}": record(1.0, 10.0, k, late=0.004) for k in (1, 2, 3)}
    found = pair(traces, recordings, MODEL)
    assert {name: one and one.recording for name, one in found.items()} == {
        "t3": "r3", "t1": "r1", "t2": "r2",
    }  # fmt: skip


def test_a_trace_of_another_manoeuvre_has_no_place(reference_model: Model) -> None:
    found = pair({"t": record(0.0, 10.0, 7)}, {"r": record(0.0, 10.0, 8)}, reference_model)
    assert found == {"t": None}
