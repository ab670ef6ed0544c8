"""The bristle filter in the service: the frames of the bus give what the recording gives."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eps_hil.errors import InputError
from eps_hil.estimation import batch
from eps_hil.estimation.bristle_filter import PhysicsInside
from eps_hil.estimation.stream import Estimate
from eps_hil.physics.model import load_model
from eps_hil.series import Series
from eps_hil.service.config import load_config
from eps_hil.service.setup import prepare

ROOT = Path(__file__).parents[2]


def test_published_is_what_the_recording_gives(
    config_file: Path, config_text: str, rig: Any
) -> None:
    config_file.write_text(config_text + "estimator: {kind: bristle_filter}\n", encoding="utf-8")
    parts = prepare(load_config(config_file), config_file)
    assert isinstance(parts.estimator.physics, PhysicsInside)
    parts.estimator.warm_up()
    samples: dict[str, list[tuple[int, float]]] = {}
    live: list[Estimate] = []
    twin = prepare(load_config(config_file), config_file).decoder
    for k in range(1200):
        frames = rig.millisecond(k)
        for frame in frames:
            for signal, t_ns, value in twin.decode(frame):
                samples.setdefault(signal, []).append((t_ns, value))
        sent = parts.core.on_frames(frames)
        assert len(sent) == 1
        assert parts.core.latest is not None
        live.append(parts.core.latest)
    series = {
        name: Series(np.array([t for t, _ in some]), np.array([v for _, v in some]))
        for name, some in samples.items()
    }
    trace = batch.estimate(
        series, load_model(ROOT / "configs" / "reference_rig.yaml"), parts.estimator.settings,
        parts.decoder.period_s,
    )  # fmt: skip
    by_instant = dict(zip(trace.t_ns.tolist(), trace.rack_force_n.tolist(), strict=True))
    compared = [one for one in live if one.valid and one.t_ns in by_instant]
    assert len(compared) > 900
    assert all(by_instant[one.t_ns] == one.rack_force_n for one in compared)


def test_the_smoother_is_no_live_estimator(config_file: Path, config_text: str) -> None:
    config_file.write_text(config_text + "estimator: {kind: smoother}\n", encoding="utf-8")
    with pytest.raises(InputError, match="whole recording") as refused:
        prepare(load_config(config_file), config_file)
    assert "estimator.kind" in str(refused.value)
