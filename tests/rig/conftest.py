"""The reference rig, as the tests of this folder use it."""

from pathlib import Path

import pytest

from eps_hil.physics.chain_parameters import ChainParameters, load_chain
from eps_hil.physics.model import Model, load_model

REPOSITORY = Path(__file__).parents[2]


@pytest.fixture(scope="session")
def model() -> Model:
    return load_model(REPOSITORY / "configs" / "reference_rig.yaml")


@pytest.fixture(scope="session")
def chain() -> ChainParameters:
    return load_chain(REPOSITORY / "configs" / "reference_chain.yaml")


@pytest.fixture
def config_file(tmp_path: Path) -> Path:
    """A configuration on python-can's in-process bus, of its own per test."""
    text = f"""\
bus: {{interface: virtual, channel: rig_test_{tmp_path.name}}}
dbc: [{REPOSITORY / "dbc" / "eps_rig.dbc"}]
signals: {REPOSITORY / "configs" / "eps_rig_signals.yaml"}
model: {REPOSITORY / "configs" / "reference_rig.yaml"}
rig: {{manoeuvre: sine_sweep, seed: 3, realtime: false}}
"""
    path = tmp_path / "config.yaml"
    path.write_text(text)
    return path
