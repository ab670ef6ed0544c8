"""The rig as a process on a bus: frames, override, pacing, and the way it ends."""

import re
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from eps_hil.bus.codec import FrameDecoder, FrameEncoder
from eps_hil.bus.database import load_database
from eps_hil.bus.frame import Frame
from eps_hil.bus.mapping import load_mapping
from eps_hil.bus.port import Port, open_port
from eps_hil.errors import BusError, InputError
from eps_hil.rig.config import RigSetup, load_rig_setup
from eps_hil.rig.ecu import COMMAND
from eps_hil.rig.frames import resolutions
from eps_hil.rig.offline import simulate_recording
from eps_hil.rig.process import Rig, RigReport, RigSimulation
from eps_hil.rig.realtime import CATCH_UP_MS, MILLISECOND_NS, Pacer

REPOSITORY = Path(__file__).parents[2]
DATABASE = load_database([REPOSITORY / "dbc" / "eps_rig.dbc"])
MAPPING = load_mapping(REPOSITORY / "configs" / "eps_rig_signals.yaml")
STATUS_ID, MOTOR_STATE_ID, TORQUES_ID, RIG_STATE_ID = 0x130, 0x100, 0x101, 0x110


@pytest.fixture
def setup(config_file: Path) -> RigSetup:
    return load_rig_setup(config_file)


class TestSimulation:
    def test_a_mapping_that_reports_by_a_command_is_refused(
        self, setup: RigSetup, tmp_path: Path
    ) -> None:
        """A simulated rig that reports its motor torque as a torque override would command one."""
        text = (REPOSITORY / "configs" / "eps_rig_signals.yaml").read_text()
        old = "{message: EPS_Torques, signal: MotorTorque}"
        assert old in text
        new = "{message: EPSHIL_TorqueOverride, signal: RequestedMotorTorque}"
        signals = tmp_path / "s.yaml"
        signals.write_text(text.replace(old, new))
        with pytest.raises(InputError, match="EPSHIL_TorqueOverride commands a torque"):
            RigSimulation(replace(setup, bus=replace(setup.bus, signals=signals)))

    def test_frames_hold_what_the_offline_simulation_holds(self, setup: RigSetup) -> None:
        """Frame by frame, decoded: equal to the quantised recording of the same seed."""
        simulation, decoder = RigSimulation(setup), FrameDecoder(DATABASE, MAPPING)
        told: dict[str, list[float]] = {}
        for millisecond in range(2000):
            for frame in simulation.step(0):
                stamped = replace(frame, t_ns=millisecond * MILLISECOND_NS)
                for sample in decoder.decode(stamped):
                    told.setdefault(sample.signal, []).append(sample.value)
        assert not any(decoder.faults.values()), decoder.faults
        assert simulation.clipped == 0
        steps = resolutions(DATABASE, MAPPING)
        offline = simulate_recording(
            setup.model,
            setup.chain,
            setup.manoeuvre,
            order=setup.rig.order,
            seed=setup.rig.seed,
            resolution=steps,
        ).columns
        every_ms = ("motor_speed_rad_s", "motor_angle_rad", "motor_torque_nm", "rack_force_n")
        for name in (*every_ms, "torque_sensor_nm", "rack_position_m"):
            assert len(told[name]) == 2000
            # A value on the very edge of two steps may fall to either side.
            assert np.abs(told[name] - offline[name][:2000]).max() <= 1.001 * steps[name][0]
            close = np.abs(told[name] - offline[name][:2000]) < 1e-6 * steps[name][0] + 1e-9
            assert close.mean() > 0.999
        assert len(told["steering_wheel_angle_rad"]) == 200
        assert len(told["vehicle_speed_m_s"]) == 100
        assert len(told["motor_temperature_degc"]) == 20
        assert set(told["motor_temperature_degc"]) == {35.0}

    def test_every_message_keeps_its_cycle_and_the_lowest_id_goes_first(
        self, setup: RigSetup
    ) -> None:
        simulation = RigSimulation(setup)
        counts: Counter[int] = Counter()
        for _ in range(200):
            ids = [frame.can_id for frame in simulation.step(0)]
            assert ids == sorted(ids)
            counts.update(ids)
        assert counts == {0x100: 200, 0x101: 200, 0x110: 200, 0x130: 20, 0x200: 20, 0x210: 10} | {
            0x300: 2
        }

    def test_the_override_moves_the_motor_and_ends_by_itself(self, setup: RigSetup) -> None:
        simulation, encoder = RigSimulation(setup), FrameEncoder(DATABASE, COMMAND)
        decoder = FrameDecoder(DATABASE, MAPPING)
        torque = []
        for ms in range(120):
            now_ns = ms * MILLISECOND_NS
            if ms < 50:
                values = {"RequestedMotorTorque": 0.8, "OverrideRequest": 1.0}
                simulation.hear(encoder.frame(values), now_ns)
            for frame in simulation.step(now_ns):
                for sample in decoder.decode(replace(frame, t_ns=now_ns)):
                    if sample.signal == "motor_torque_nm":
                        torque.append(sample.value)
        assert torque[45] == pytest.approx(0.8, abs=0.03)
        assert torque[65] == pytest.approx(0.8, abs=0.03), "the last command was 20 ms ago"
        assert np.abs(torque[85:]).max() < 0.03, "30 ms later the torque is gone for good"
        assert simulation.override.timeouts == 1

    def test_frames_of_others_are_left_alone(self, setup: RigSetup) -> None:
        simulation = RigSimulation(setup)
        simulation.hear(Frame(0, 0x123, b"12345678"), 0)
        simulation.hear(Frame(0, 0x80, b"12345678", own=True), 0)
        assert simulation.commands == 0
        simulation.hear(Frame(0, 0x80, b"12345678"), 0)
        assert (simulation.commands, simulation.bad_commands) == (1, 1)


class TestPacer:
    def test_it_keeps_absolute_time(self) -> None:
        pacer, start, milliseconds = Pacer(), time.monotonic_ns(), 0
        while milliseconds < 200:
            milliseconds += pacer.wait()
        elapsed_ms = (time.monotonic_ns() - start) / MILLISECOND_NS
        if pacer.overruns == 0:
            assert milliseconds - 0.1 <= elapsed_ms < milliseconds + CATCH_UP_MS + 1
        assert pacer.lateness.p50_us <= pacer.lateness.p99_us <= pacer.lateness.max_us + 1

    def test_a_short_delay_is_caught_up(self) -> None:
        pacer = Pacer()
        pacer.wait()
        time.sleep(0.008)
        assert 5 <= pacer.wait() <= CATCH_UP_MS
        assert pacer.overruns == 0
        assert pacer.caught_up >= 5

    def test_a_long_delay_is_an_overrun_and_time_starts_anew(self) -> None:
        pacer = Pacer()
        pacer.wait()
        time.sleep(0.05)
        assert pacer.wait() == 1
        assert pacer.overruns == 1


def listen(port: Port, seconds: float) -> list[Frame]:
    frames, end = [], time.monotonic() + seconds
    while (left := end - time.monotonic()) > 0:
        frames += port.recv(min(left, 0.02))
    return frames


class TestOnABus:
    def test_a_run_sends_in_real_time_and_says_so(self, setup: RigSetup) -> None:
        bus = setup.bus.bus
        listener = open_port(bus.interface, bus.channel)
        lines: list[str] = []
        reports: list[RigReport] = []
        rig = Rig(setup, lines.append)
        thread = threading.Thread(target=lambda: reports.append(rig.run(duration_s=1.0)))
        thread.start()
        frames: list[Frame] = []
        while thread.is_alive():
            frames += listener.recv(0.05)
        thread.join()
        frames += listener.recv(0.05)
        listener.close()
        assert len(reports) == 1
        report = reports[0]
        assert report.simulated_s == pytest.approx(1.02, abs=1e-9)
        assert report.frames_sent == len(frames)
        assert report.send_dropped == 0
        counts = Counter(frame.can_id for frame in frames)
        assert counts[MOTOR_STATE_ID] == counts[TORQUES_ID] == round(report.simulated_s * 1000)
        assert any("sends 0x100 EPS_MotorState every 1 ms" in line for line in lines)
        assert any("listens to 0x80" in line for line in lines)
        assert "READY" in lines

    def test_what_is_caught_up_ends_with_the_duration(
        self, setup: RigSetup, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """A rig that lags by a few periods as its time ends sends no frame more for that."""

        class Lagging(Pacer):
            def wait(self) -> int:
                return 7

        monkeypatch.setattr("eps_hil.rig.process.Pacer", Lagging)
        assert Rig(setup).run(duration_s=0.1).simulated_s == pytest.approx(0.12, abs=1e-9)

    def test_it_does_not_talk_over_an_ecu(self, setup: RigSetup) -> None:
        """Two ECUs on one bus: no receiver can tell whose torque it was."""
        bus = setup.bus.bus
        ecu = open_port(bus.interface, bus.channel)
        lines: list[str] = []
        rig = Rig(setup, lines.append)
        errors: list[str] = []

        def run() -> None:
            try:
                rig.run(duration_s=30.0)
            except BusError as error:
                errors.append(str(error))

        thread = threading.Thread(target=run)
        thread.start()
        heard: list[Frame] = []
        while thread.is_alive():
            ecu.send(Frame(0, MOTOR_STATE_ID, bytes(8)))
            heard += ecu.recv(0.01)
        thread.join()
        ecu.close()
        assert heard == []
        assert "READY" not in lines
        (error,) = errors
        assert "the ids 0x100 are sent by somebody else already; nothing is talked over" in error
        assert error.endswith("end that sender, or simulate on a bus of its own")

    def test_it_ends_where_an_ecu_begins_to_send(self, setup: RigSetup) -> None:
        bus = setup.bus.bus
        ecu = open_port(bus.interface, bus.channel)
        timer = threading.Timer(0.1, lambda: ecu.send(Frame(0, MOTOR_STATE_ID, bytes(8))))

        def begin(line: str) -> None:
            if line == "READY":
                timer.start()

        rig = Rig(setup, begin)
        with pytest.raises(BusError, match=r"0x100 are now sent by somebody else too"):
            rig.run(duration_s=30.0)
        timer.join()
        ecu.close()

    @pytest.fixture
    def process_config(self, config_file: Path) -> Path:
        """The same on the loopback network, which other processes can hear."""
        port = 44_000 + hash(config_file) % 10_000
        text = re.sub(
            "bus: .*",
            "bus: {interface: udp_multicast, channel: 239.74.163.9, fd: true, "
            f"options: {{port: {port}}}}}",
            config_file.read_text(),
        )
        config_file.write_text(text)
        return config_file

    def start(self, config: Path, *options: str) -> "subprocess.Popen[str]":
        return subprocess.Popen(
            [sys.executable, "-m", "eps_hil.cli", "rig", "--config", str(config), *options],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    def wait_for_frames(self, listener: Port) -> None:
        end = time.monotonic() + 60
        while time.monotonic() < end:
            if listener.recv(0.2):
                return
        pytest.fail("the rig sent nothing within a minute")

    @pytest.mark.parametrize(
        "number",
        [
            *(pytest.param(one, marks=pytest.mark.slow) for one in (signal.SIGINT, signal.SIGHUP)),
            signal.SIGTERM,
        ],
    )
    def test_a_signal_ends_it_cleanly(self, process_config: Path, number: signal.Signals) -> None:
        signal.signal(signal.SIGHUP, signal.SIG_DFL)  # ignored where the tests run under nohup
        bus = load_rig_setup(process_config).bus.bus
        listener = open_port(bus.interface, bus.channel, fd=True, options=bus.options)
        process = self.start(process_config, "--loop")
        try:
            self.wait_for_frames(listener)
            listen(listener, 0.5)
            process.send_signal(number)
            out, err = process.communicate(timeout=20)
        finally:
            process.kill()
            listener.close()
        assert process.returncode == 0, err
        assert err == ""
        assert "done:" in out
        assert "lateness: p50" in out

    @pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
    def test_a_signal_ends_it_while_it_compiles(
        self, process_config: Path, number: signal.Signals
    ) -> None:
        """The compiler goes on after a handler: only the signal's own effect ends it."""
        program = (
            "import sys, time\n"
            "from eps_hil.cli.main import main\n"
            "from eps_hil.rig.process import Rig\n"
            "def compiles(rig):\n"
            "    print('compiles', flush=True)\n"
            "    end = time.monotonic() + 60\n"
            "    while time.monotonic() < end: time.sleep(1)\n"
            "Rig._warm_up = compiles\n"
            "main(sys.argv[1:])\n"
        )
        words = ["rig", "--config", str(process_config), "--loop"]
        with subprocess.Popen(
            [sys.executable, "-c", program, *words], stdout=subprocess.PIPE, text=True
        ) as process:
            try:
                assert process.stdout is not None
                assert "compiles\n" in iter(process.stdout.readline, "")
                process.send_signal(number)
                assert process.wait(timeout=10) == -number
            finally:
                process.kill()

    @pytest.mark.slow
    def test_killed_it_leaves_a_silent_bus_that_the_next_one_can_use(
        self, process_config: Path
    ) -> None:
        bus = load_rig_setup(process_config).bus.bus
        listener = open_port(bus.interface, bus.channel, fd=True, options=bus.options)
        process = self.start(process_config, "--loop")
        try:
            self.wait_for_frames(listener)
            process.kill()
            process.wait(timeout=10)
            listen(listener, 0.3)
            assert listen(listener, 0.3) == []
        finally:
            process.kill()
            process.communicate()
        second = self.start(process_config, "--duration", "0.3")
        try:
            self.wait_for_frames(listener)
            out, err = second.communicate(timeout=30)
        finally:
            second.kill()
            listener.close()
        assert second.returncode == 0, err
        assert "done: 0.3" in out


class TestConfig:
    def rig_block(self, config: Path, text: str) -> Path:
        config.write_text(re.sub("rig: .*", f"rig: {text}", config.read_text()))
        return config

    def test_defaults(self, config_file: Path) -> None:
        setup = load_rig_setup(self.rig_block(config_file, ""))
        assert setup.manoeuvre.name == "demo"
        assert setup.rig.order == 5

    def test_the_command_line_overrules_the_file(self, config_file: Path) -> None:
        assert load_rig_setup(config_file, "weave").manoeuvre.name == "weave"

    def test_a_manoeuvre_file_is_found_beside_the_configuration(self, config_file: Path) -> None:
        own = "manoeuvre: {name: mine, segments: [{duration_s: 1, rack_force_n: 5}]}\n"
        (config_file.parent / "mine.yaml").write_text(own)
        setup = load_rig_setup(self.rig_block(config_file, "{manoeuvre: mine.yaml}"))
        assert setup.manoeuvre.name == "mine"

    @pytest.mark.parametrize(
        ("text", "words"),
        [
            ("{order: 6}", ["config.yaml", "line 5", "rig.order"]),
            ("{colour: red}", ["config.yaml", "rig.colour", "not a known field"]),
            ("{manoeuvre: slalom}", ["slalom", "no such manoeuvre"]),
            ("{chain: gone.yaml}", ["gone.yaml", "no such file"]),
            ("{sensors: {noise: maybe}}", ["rig.sensors.noise"]),
            ("7", ["rig", "must be a block"]),
        ],
    )
    def test_mistakes_name_file_and_field(
        self, config_file: Path, text: str, words: list[str]
    ) -> None:
        with pytest.raises(InputError) as caught:
            load_rig_setup(self.rig_block(config_file, text))
        for word in words:
            assert word in str(caught.value)
