"""What many tests share: the reference rig, and recordings of a rig of other code."""

import functools
import gc
import importlib.util
import os
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest
from hypothesis import settings

# as eps-hil does, before NumPy is there
os.environ.update({f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL")} | os.environ)

from eps_hil.physics.model import Model, load_model

ROOT = Path(__file__).parents[1]

# A first call may compile for seconds; hypothesis is here to find counter-examples, not to time.
# ``quick`` is what scripts/test asks for without --all; a test's own @settings go first.
settings.register_profile("rig", deadline=None)
settings.register_profile("quick", deadline=None, max_examples=30)
settings.load_profile("rig")


REAL_TIME = (
    "service", "rig", "selftest", "bus", "monitor", "programme", "scripts", "cli", "real",
    "dashboard",
)  # fmt: skip
"""Folders whose tests watch a clock, or share the machine's bus: nothing else runs beside them."""
NO_CLOCK = frozenset(
    f"{folder}/test_{name}.py"
    for folder, names in {
        "bus": "bit_packing bits codec database e2e eps_rig_dbc fast_clock frame lanes lanes_anew "
        "mapping protection sample_clock seen stamp_offset supply_power",
        "cli": "bad_input budget compare completion convert diagnose each_verb estimate export "
        "extras first_answer frequency_response gap identify inputs main numbers outputs "
        "prove_concealed schema tune",
        "dashboard": "collect decimate diagnosis events feed mismatch recording stretch",
        "monitor": "alarm meters view_model",
        "programme": "conductor identify_logs plan recordings",
        "real": "emps ford_gt350",
        "rig": "command ecu effects manoeuvre offline",
        "selftest": "judges",
        "service": "calibrated_model calibration command_replay config core estimate_faults "
        "friction_levels guard_properties health override override_core present rates "
        "second_estimator setup verdict",
    }.items()
    for name in names.split()
)
"""Files of those folders that only compute, the long ones: they run beside others."""


def watches_a_clock(path: Path) -> bool:
    """Whether the tests of this file do."""
    place = path.relative_to(ROOT / "tests")
    return place.parts[0] in REAL_TIME and place.as_posix() not in NO_CLOCK


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Where ``-m`` asks for one kind of test, files of the other are not even imported."""
    asked = re.search(r"\b(not )?real_time\b", config.option.markexpr)
    if asked is None or "or" in config.option.markexpr.split() or collection_path.suffix != ".py":
        return None
    return True if watches_a_clock(collection_path) == bool(asked[1]) else None


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark those that watch a clock."""
    for item in items:
        if watches_a_clock(item.path):
            item.add_marker(pytest.mark.real_time)


def pytest_collection_finish() -> None:
    """What was collected stays to the end: the garbage collector need not look at it again."""
    gc.collect()
    gc.freeze()


def _module(name: str, folder: str) -> ModuleType:
    """``tests/<folder>/<name>.py``, once per process and under one name, which numba caches by."""
    if name not in sys.modules:
        spec = importlib.util.spec_from_file_location(name, ROOT / "tests" / folder / f"{name}.py")
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module
        spec.loader.exec_module(module)
    return sys.modules[name]


@pytest.fixture(scope="session", autouse=True)
def _compiled_without_a_word() -> Iterator[None]:
    """What a verb says on stderr does not hang on which kernels are in the machine's cache."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("eps_hil.cli._first_answer.LATE_S", 1e6)
        patch.setattr("eps_hil.compiled._LATE_S", 1e6)
        yield


@pytest.fixture(scope="session", autouse=True)
def _verbs_are_built_once() -> Iterator[None]:
    """typer makes the parsers of all verbs anew for each call of its app, as no process does."""
    import typer.main

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(typer.main, "get_command", functools.cache(typer.main.get_command))
        yield


@pytest.fixture(scope="session")
def reference_model() -> Model:
    return load_model(ROOT / "configs" / "reference_rig.yaml")


@pytest.fixture(scope="session")
def independent_rig() -> ModuleType:
    return _module("independent_rig", "estimation")


@pytest.fixture(scope="session")
def other_rig() -> ModuleType:
    """A second rig of other code, whose missing physics is known."""
    return _module("other_rig", "diagnosis")


@pytest.fixture(scope="session")
def closed_loop_rig() -> ModuleType:
    """A third one, under its own controller."""
    return _module("closed_loop_rig", "diagnosis")


@pytest.fixture(scope="session")
def sweep_truth(independent_rig: ModuleType) -> object:
    """The 540 N rms sweep of the independent rig."""
    force = independent_rig.sweep()
    return independent_rig.run(force, 0.0 * force)


@pytest.fixture(scope="session")
def weave_truth(independent_rig: ModuleType) -> object:
    """A weave of the independent rig, with a driver."""
    import numpy as np

    force = independent_rig.weave()
    time_s = np.arange(len(force)) * 1e-3
    return independent_rig.run(force, 0.8 * np.sin(2 * np.pi * 0.25 * time_s + 0.4))


@pytest.fixture(scope="session")
def steps_truth(independent_rig: ModuleType) -> object:
    """Rack-force steps with rests between them."""
    force = independent_rig.steps()
    return independent_rig.run(force, 0.0 * force)
