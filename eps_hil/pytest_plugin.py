"""Fixtures for tests of a steering rig (docs/howto-test-a-rig.md); found by pytest on its own.

Nothing of eps_hil is imported before a fixture is used.
"""

import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from eps_hil.api.recording import Recording
    from eps_hil.api.results import Estimate
    from eps_hil.estimation.score import Score
    from eps_hil.rig.process import Rig, RigReport

Effects = Sequence[Mapping[str, Any]]


@dataclass(frozen=True, slots=True)
class RigFiles:
    """A folder of its own with configuration, model, mapping and database of the reference rig."""

    config: Path
    model: Path
    signals: Path
    dbc: Path


@dataclass(slots=True)
class RunningRig:
    """A simulated rig in a thread, on python-can's virtual bus of this process."""

    config: Path
    rig: "Rig"
    thread: threading.Thread
    reports: "list[RigReport]"

    def wait(self, timeout_s: float = 60.0) -> "RigReport":
        """Until the manoeuvre is over; ``TimeoutError`` if it is not."""
        self.thread.join(timeout_s)
        if self.thread.is_alive() or not self.reports:
            raise TimeoutError(f"the rig did not end within {timeout_s:g} s")
        return self.reports[0]

    def stop(self) -> None:
        """End it after the present millisecond."""
        self.rig.stop()
        self.thread.join(10.0)


@pytest.fixture
def rig_files(tmp_path: Path) -> RigFiles:
    """Files of the reference rig on a virtual bus that no other test has; change them at will."""
    import yaml

    from eps_hil.examples import shelf

    config = shelf.copy("demo_udp", tmp_path / "rig")[0].path
    content = yaml.safe_load(config.read_text(encoding="utf-8"))
    content["bus"] = {"interface": "virtual", "channel": f"eps_hil_{tmp_path.name}_{id(tmp_path)}"}
    content["rig"] = {"manoeuvre": "demo", "order": 2, "realtime": False}
    config.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    folder = config.parent
    return RigFiles(
        config,
        folder / "reference_rig.yaml",
        folder / "eps_rig_signals.yaml",
        folder.parent / "dbc" / "eps_rig.dbc",
    )


@pytest.fixture
def virtual_rig(rig_files: RigFiles) -> Iterator[Callable[..., RunningRig]]:
    """``start(manoeuvre="demo", duration_s=…, effects=())``: a rig that runs beside the test.

    ``effects``: entries of a model file that the rig obeys and nobody else knows.
    """
    started: list[RunningRig] = []

    def start(
        manoeuvre: str = "demo", *, duration_s: float = 5.0, effects: Effects = ()
    ) -> RunningRig:
        from eps_hil.rig.config import load_rig_setup
        from eps_hil.rig.process import Rig

        setup = load_rig_setup(rig_files.config, manoeuvre)
        hidden = replace(setup.model, effects=tuple(effects))
        rig = Rig(replace(setup, model=hidden))
        reports: list[RigReport] = []

        def run() -> None:
            reports.append(rig.run(duration_s=duration_s, loop=True))

        one = RunningRig(rig_files.config, rig, threading.Thread(target=run, daemon=True), reports)
        started.append(one)
        one.thread.start()
        return one

    yield start
    for one in started:
        one.stop()


@pytest.fixture
def recorded_run(rig_files: RigFiles) -> Callable[..., "Recording"]:
    """``record(manoeuvre="demo", effects=(), order=2, seed=0, noise=True)``: what a rig reports.

    Simulated without a clock, in the database's resolution; the same arguments give the same.
    """

    def record(
        manoeuvre: str = "demo",
        *,
        effects: Effects = (),
        order: int = 2,
        seed: int = 0,
        noise: bool = True,
    ) -> "Recording":
        import numpy as np

        from eps_hil.api.recording import Recording
        from eps_hil.bus.database import load_database
        from eps_hil.bus.mapping import load_mapping
        from eps_hil.rig.config import load_rig_setup
        from eps_hil.rig.frames import resolutions
        from eps_hil.rig.offline import simulate_recording
        from eps_hil.rig.sensors import SensorSettings
        from eps_hil.series import Series

        setup = load_rig_setup(rig_files.config, manoeuvre)
        steps = resolutions(load_database([rig_files.dbc]), load_mapping(rig_files.signals))
        made = simulate_recording(
            replace(setup.model, effects=tuple(effects)),
            setup.chain,
            setup.manoeuvre,
            order=order,
            seed=seed,
            sensors=SensorSettings(noise=noise),
            resolution=steps,
        )
        t_ns = np.round(made.columns["time_s"] * 1e9).astype(np.int64)
        series = {k: Series(t_ns, v) for k, v in made.columns.items() if k != "time_s"}
        return Recording(manoeuvre, series, ())

    return record


@pytest.fixture
def replayed(rig_files: RigFiles) -> Callable[..., "Score"]:
    """``replay(log, model=None, config=None)``: a CAN log through the live service's own core.

    Returns the error of what it would have published against the log's load cell.
    """

    def replay(log: Path, *, model: Path | None = None, config: Path | None = None) -> "Score":
        from eps_hil.oracle.lock_step import compare
        from eps_hil.service.config import load_config

        file = config or rig_files.config
        setup = load_config(file)
        return compare(log, setup, file, {"published": model or setup.model})["published"]

    return replay


@pytest.fixture
def expect_force() -> Callable[..., None]:
    """``expect(estimate, within_n=30, overall_n=None)``: rms error in motion, and over all.

    Takes what ``eps_hil.estimate`` or ``replayed`` return; fails in words.
    """

    def expect(
        estimate: "Estimate | Score", *, within_n: float, overall_n: float | None = None
    ) -> None:
        score = getattr(estimate, "score", estimate)
        if score is None:
            pytest.fail("no load cell in the recording: nothing to compare the rack force with")
        for name, most in (("rmse_moving_n", within_n), ("rmse_overall_n", overall_n)):
            error = getattr(score, name)
            if most is not None and not error <= most:  # also NaN
                what = "in motion" if "moving" in name else "over all"
                pytest.fail(f"rack force: rms error {what} is {error:.1f} N, at most {most:g} N")

    return expect
