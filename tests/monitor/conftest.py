"""The bench of this folder, as a fixture."""

import importlib.util
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest


def _bench() -> ModuleType:
    name = "monitor_bench"
    if name not in sys.modules:
        spec = importlib.util.spec_from_file_location(name, Path(__file__).parent / "bench.py")
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module
        spec.loader.exec_module(module)
    return sys.modules[name]


@pytest.fixture
def bench_module() -> ModuleType:
    return _bench()


@pytest.fixture
def bench(tmp_path: Path) -> Callable[..., Any]:
    """``bench(more="", model=None, **options)``: a :class:`Bench` with its configuration file."""
    module = _bench()

    def make(model: Path | None = None, rig_model: Path | None = None, **options: Any) -> Any:
        text = module.CONFIG
        if model is not None:
            text = text.replace(f"{module.ROOT}/configs/reference_rig.yaml", str(model))
        if rig_model is not None:
            text = text.replace("loop: true}", f"loop: true, model: {rig_model}}}")
        config = tmp_path / "c.yaml"
        config.write_text(text)
        return module.Bench(config, **options)

    return make
