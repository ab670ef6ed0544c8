"""The fixtures as somebody else's test file would use them."""

import pytest

pytest_plugins = ["pytester"]

TESTS = """
import eps_hil
import pytest

def test_a_recorded_run_meets_its_force(recorded_run, rig_files, expect_force):
    run = recorded_run("steps", seed=1)
    expect_force(eps_hil.estimate(run, rig_files.model), within_n=40.0, overall_n=120.0)

def test_hidden_physics_misses_it(recorded_run, rig_files, expect_force):
    run = recorded_run("steps", effects=[{"effect": "coulomb_level", "scale": 3.0}])
    estimated = eps_hil.estimate(run, rig_files.model)
    with pytest.raises(pytest.fail.Exception, match="rms error in motion is"):
        expect_force(estimated, within_n=40.0)

def test_a_rig_on_a_bus_is_heard(virtual_rig, rig_files):
    import can
    import yaml

    bus = can.Bus(**{k: v for k, v in yaml.safe_load(rig_files.config.read_text())["bus"].items()})
    rig = virtual_rig("steps", duration_s=0.5)
    seen = set()
    while rig.thread.is_alive():
        frame = bus.recv(0.05)
        if frame is not None:
            seen.add(frame.arbitration_id)
    assert {0x100, 0x101, 0x110} <= seen
    assert rig.wait().frames_sent > 1000
    bus.shutdown()

def test_a_log_is_replayed(replayed, rig_files, expect_force):
    from eps_hil.rig.config import load_rig_setup
    from eps_hil.rig.process import RigSimulation

    rig = RigSimulation(load_rig_setup(rig_files.config, "steps"))
    log = rig_files.config.parent / "bus.log"
    with log.open("w") as file:
        for ms in range(8000):
            for frame in rig.step(0):
                stamp, data = 1_700_000_000 + ms * 1e-3, frame.data.hex().upper()
                file.write(f"({stamp:.6f}) can0 {frame.can_id:03X}#{data}\\n")
    expect_force(replayed(log), within_n=60.0)
"""


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_the_fixtures_work_in_a_file_of_somebody_else(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(TESTS)
    done = pytester.runpytest_subprocess("-p", "eps_hil", "-q")
    done.assert_outcomes(passed=4)


def test_importing_the_plugin_imports_nothing_heavy(pytester: pytest.Pytester) -> None:
    pytester.makepyfile("import sys\n\ndef test_it():\n    assert 'numba' not in sys.modules\n")
    done = pytester.runpytest_subprocess("-p", "eps_hil", "-q")
    done.assert_outcomes(passed=1)
