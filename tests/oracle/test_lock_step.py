"""The loop closed on the bus: a better model makes the published frames better, in lock-step."""

from pathlib import Path

import can
import numpy as np
import pytest

from eps_hil.bus.database import load_database
from eps_hil.bus.replay import read_log
from eps_hil.cli.main import main
from eps_hil.errors import InputError
from eps_hil.oracle.lock_step import compare, publish
from eps_hil.proof.can_log import Wire, write_log
from eps_hil.proof.cases import Case, make
from eps_hil.proof.model_file import model_yaml
from eps_hil.proof.plans import Plan
from eps_hil.proof.truth import Drive
from eps_hil.service.config import ServiceConfig, load_config

ROOT = Path(__file__).parents[2]
SECONDS = 4


@pytest.fixture(scope="module")
def concealed() -> Case:
    return make(Plan("singles", 6, (("stribeck", 1.5),), simple=True))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, concealed: Case) -> Path:
    """The hold-out's first seconds as a CAN log, the models, and a service's configuration."""
    place = tmp_path_factory.mktemp("loop")
    columns = {n: c[: 1000 * SECONDS] for n, c in concealed.recordings["holdout"].items()}
    database = load_database([ROOT / "dbc" / "eps_rig.dbc"])
    write_log(place / "holdout.log", columns, database, Wire(), np.random.default_rng(1))
    (place / "model.yaml").write_text(model_yaml(Drive()))
    (place / "better.yaml").write_text(concealed.oracle)
    (place / "service.yaml").write_text(
        f"bus: {{interface: virtual, channel: loop-test}}\n"
        f"dbc: [{ROOT}/dbc/eps_rig.dbc]\nsignals: {ROOT}/configs/eps_rig_signals.yaml\n"
        "model: model.yaml\nservice: {start_wait_s: 0}\n"
    )
    return place


@pytest.fixture(scope="module")
def config(folder: Path) -> ServiceConfig:
    return load_config(folder / "service.yaml")


def test_one_frame_is_published_for_every_sync_frame(folder: Path, config: ServiceConfig) -> None:
    sent = publish(folder / "holdout.log", config, folder / "service.yaml", folder / "model.yaml")
    assert len(sent.frames) == 1000 * SECONDS
    stamps = [frame.t_ns for frame in sent.frames]
    assert stamps == sorted(stamps)
    assert np.mean(sent.trace.valid) > 0.95
    late = np.array([frame.t_ns for frame in sent.frames])[-100:] - sent.trace.t_ns[-100:]
    assert 0.003 < np.median(late) * 1e-9 < 0.03  # the instant that a frame speaks of is past


def test_a_log_that_was_recorded_beside_a_service_gives_the_same(
    folder: Path, config: ServiceConfig
) -> None:
    words = (config, folder / "service.yaml", folder / "model.yaml")
    log, both = folder / "holdout.log", folder / "beside.log"
    sent = publish(log, *words)
    with can.CanutilsLogWriter(both) as file:
        frames = [(frame.t_ns, k, frame) for k, frame in enumerate([*read_log(log), *sent.frames])]
        for t_ns, _, frame in sorted(frames):
            file.on_message_received(
                can.Message(
                    t_ns * 1e-9, frame.can_id, frame.extended, data=frame.data, is_fd=frame.fd
                )
            )
    again = publish(both, *words)
    assert [frame.data for frame in again.frames] == [frame.data for frame in sent.frames]


@pytest.mark.slow
def test_the_true_model_on_the_bus_is_better(folder: Path, config: ServiceConfig) -> None:
    models = {"as it was": folder / "model.yaml", "true": folder / "better.yaml"}
    errors = compare(folder / "holdout.log", config, folder / "service.yaml", models)
    assert errors["true"].rmse_moving_n < 0.7 * errors["as it was"].rmse_moving_n
    assert errors["true"].rows == errors["as it was"].rows


def test_the_command_says_both(
    folder: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """Of a model without effects, whose step is compiled already; the one above has effects."""
    given = ["prove", "loop", str(folder / "holdout.log"), "--config", str(folder / "service.yaml")]
    out = tmp_path / "loop.json"
    other = folder / "other.yaml"
    other.write_text(model_yaml(Drive(inertia_kg_m2=2.2e-4)))
    assert main([*given, "--with", str(other), "--json", str(out)]) == 0
    said = capsys.readouterr().out
    assert "other.yaml" in said
    assert "moving" in said
    assert out.exists()


def test_a_service_that_publishes_nothing_is_refused(folder: Path) -> None:
    quiet = folder / "quiet.yaml"
    quiet.write_text((folder / "service.yaml").read_text() + "publish: {enabled: false}\n")
    with pytest.raises(InputError, match="nothing would be published"):
        publish(folder / "holdout.log", load_config(quiet), quiet, folder / "model.yaml")
