"""Frequency responses against closed forms: a known filter in noise, and the linear chains."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eps_hil.identification.chain_response import (
    ORDERS,
    Load,
    agreement,
    chain_responses,
    fitted_load,
    linear_response,
    simulated,
)
from eps_hil.identification.frequency_response import (
    INPUT,
    OUTPUTS,
    Response,
    ResponseSettings,
    Stretch,
    coherence_limit,
    responses,
    stretches,
)
from eps_hil.physics.chain_parameters import ChainParameters, ColumnFriction, load_chain
from eps_hil.physics.model import Delays, Friction, Model, load_model
from eps_hil.series import Series

CONFIGS = Path(__file__).parents[2] / "configs"
Floats = npt.NDArray[np.float64]
SPEED = "motor_speed_rad_s"
POLE_HZ, GAIN = 2.0, 30.0


@pytest.fixture(scope="module")
def model() -> Model:
    return load_model(CONFIGS / "reference_rig.yaml")


@pytest.fixture(scope="module")
def chain() -> ChainParameters:
    return load_chain(CONFIGS / "reference_chain.yaml")


def white(seconds: float, seed: int) -> Floats:
    """Low-passed noise, so that interpolation between its samples means something."""
    from scipy.signal import butter, sosfilt

    raw = np.random.default_rng(seed).standard_normal(round(seconds * 1000))
    return np.asarray(sosfilt(butter(4, 40.0, fs=1000.0, output="sos"), raw)) * 5.0


def low_pass(torque: Floats) -> Floats:
    """GAIN/(1 + jf/POLE_HZ), exact for a torque held over each millisecond."""
    from scipy.signal import lfilter

    keep = np.exp(-2 * np.pi * POLE_HZ * 1e-3)
    return GAIN * np.asarray(lfilter([0.0, 1.0 - keep], [1.0, -keep], torque))


def filter_truth(hertz: Floats) -> npt.NDArray[np.complex128]:
    keep = np.exp(-2 * np.pi * POLE_HZ * 1e-3)
    z = np.exp(2j * np.pi * hertz * 1e-3)
    return np.asarray(GAIN * (1.0 - keep) / (z - keep))


def measured(
    seconds: float, seed: int, output_noise: float = 0.0, input_noise: float = 0.0, **how: str
) -> Response:
    torque = white(seconds, seed)
    noise = np.random.default_rng(seed + 1).standard_normal((2, len(torque)))
    part = Stretch(
        {INPUT: torque + input_noise * noise[0], SPEED: low_pass(torque) + output_noise * noise[1]}
    )
    return responses([part], ResponseSettings(**how))[SPEED]  # type: ignore[arg-type]


def relative_error(one: Response) -> float:
    truth = filter_truth(one.frequency_hz)
    return float(np.sqrt(np.mean(np.abs(one.gain / truth - 1.0) ** 2)))


class TestEstimator:
    def test_a_known_filter_without_noise(self) -> None:
        one = measured(60.0, 1)
        assert one.frequency_hz[0] == 0.5
        assert one.frequency_hz[-1] == 8.0
        assert relative_error(one) < 0.01
        assert one.coherence.min() > 0.99  # windows cut the memory of the filter: leakage
        assert one.trusted.all()
        assert np.all(np.diff(one.phase_deg) < 0)

    @pytest.mark.slow
    def test_h1_is_unmoved_by_output_noise_and_h2_by_input_noise(self) -> None:
        assert relative_error(measured(400.0, 2, output_noise=20.0)) < 0.03
        assert relative_error(measured(400.0, 2, output_noise=20.0, estimator="h2")) > 0.1
        assert relative_error(measured(400.0, 3, input_noise=2.0, estimator="h2")) < 0.03
        assert relative_error(measured(400.0, 3, input_noise=2.0)) > 0.1

    def test_hv_lies_between_h1_and_h2(self) -> None:
        found = [
            np.abs(measured(60.0, 4, output_noise=20.0, estimator=name).gain)
            for name in ("h1", "hv", "h2")
        ]
        assert np.all(found[0] <= found[1])
        assert np.all(found[1] <= found[2])
        assert found[1] ** 2 == pytest.approx(found[0] * found[2])

    @pytest.mark.slow
    def test_the_band_holds_the_truth_in_95_of_100(self) -> None:
        inside: list[bool] = []
        for seed in range(25):
            one = measured(60.0, 100 + seed, output_noise=20.0)
            away = np.abs(one.gain - filter_truth(one.frequency_hz))
            inside += (away <= one.radius)[::2].tolist()  # Hann leaks into the neighbours
        assert 0.92 < np.mean(inside) < 0.98

    def test_strangers_stay_below_the_limit_of_coherence(self) -> None:
        exceeded: list[bool] = []
        for seed in range(25):
            part = Stretch({INPUT: white(60.0, seed), SPEED: white(60.0, 1000 + seed)})
            one = responses([part])[SPEED]
            exceeded += one.trusted[::2].tolist()
            assert np.median(one.magnitude_band[0]) == 0.0
            assert np.median(one.phase_band_deg) == 180.0
        assert 0.02 < np.mean(exceeded) < 0.09

    @given(st.floats(1.01, 500.0))
    @settings(max_examples=50)
    def test_the_limit_falls_with_averages(self, averages: float) -> None:
        assert 0.0 < coherence_limit(averages + 1.0) < coherence_limit(averages) <= 1.0

    def test_one_average_knows_nothing(self) -> None:
        assert coherence_limit(1.0) == 1.0

    def test_several_recordings_average_like_one_long_one(self) -> None:
        parts = [
            Stretch({INPUT: (torque := white(30.0, seed)), SPEED: low_pass(torque)})
            for seed in (5, 6)
        ]
        one = responses(parts)[SPEED]
        assert relative_error(one) < 0.015
        assert one.averages > 1.9 * responses(parts[:1])[SPEED].averages

    def test_too_little_is_refused(self) -> None:
        part = Stretch({INPUT: np.zeros(5000), SPEED: np.zeros(5000)})
        with pytest.raises(ValueError, match="too few"):
            responses([part])
        with pytest.raises(ValueError, match="empty"):
            responses([part], ResponseSettings(from_hz=5.0, to_hz=2.0))

    def test_a_dead_input_gives_no_trusted_line(self) -> None:
        part = Stretch({INPUT: np.zeros(20_000), SPEED: white(20.0, 7)})
        one = responses([part])[SPEED]
        assert np.isfinite(one.coherence).all()
        assert not one.trusted.any()


class TestStretches:
    def series(self, step_ms: int, value: Floats) -> Series:
        t_ns = np.arange(0, len(value), step_ms, dtype=np.int64) * 1_000_000
        return Series(t_ns, value[::step_ms])

    def test_delays_are_taken_out(self, model: Model) -> None:
        torque = white(60.0, 8)
        late = replace(model, delays_s=Delays(motor_speed=0.004, motor_torque=0.001))
        shifted = {
            INPUT: Series(self.series(1, torque).t_ns + 1_000_000, torque),
            SPEED: Series(self.series(1, torque).t_ns + 4_000_000, low_pass(torque)),
        }
        one = responses(stretches(shifted, late))[SPEED]
        assert relative_error(one) < 0.01

    def test_delays_are_those_with_the_models_effects(self, model: Model) -> None:
        """A delay that a diagnosis had found stayed in the phase: 8.6 degrees at 8 Hz."""
        torque = white(60.0, 8)
        effects = ({"effect": "speed_sensor_delay", "delay_s": 0.003},)
        late = replace(model, delays_s=Delays(motor_speed=0.001), effects=effects)
        one = Series(self.series(1, torque).t_ns + 4_000_000, low_pass(torque))
        found = responses(stretches({INPUT: self.series(1, torque), SPEED: one}, late))[SPEED]
        assert relative_error(found) < 0.01

    def test_a_shaft_that_follows_late_is_in_the_chain(self, model: Model) -> None:
        effects = ({"effect": "motor_torque_delay", "delay_s": 0.003},)
        late = replace(model, delays_s=Delays(motor_torque=0.001), effects=effects)
        torque = self.series(1, white(2.0, 8))
        (part,) = stretches({INPUT: torque, SPEED: torque}, late)
        assert part.columns[INPUT][100:200] == pytest.approx(part.columns[SPEED][100:200])

    def test_slow_samples_and_an_angle_instead_of_its_speed(self, model: Model) -> None:
        torque = white(60.0, 9)
        prompt = replace(model, delays_s=Delays())
        angle = np.cumsum(low_pass(torque)) * 1e-3 - 0.5e-3 * low_pass(torque)
        slow = {
            INPUT: self.series(1, torque),
            "motor_angle_rad": self.series(10, angle),
            "steering_wheel_speed_rad_s": self.series(10, low_pass(torque)),
        }
        found = responses(stretches(slow, prompt))
        assert relative_error(found[SPEED]) < 0.02
        assert relative_error(found["steering_wheel_speed_rad_s"]) < 0.01

    def test_gaps_cut_a_recording(self, model: Model) -> None:
        torque = white(60.0, 10)
        whole = {INPUT: self.series(1, torque), SPEED: self.series(1, low_pass(torque))}
        keep = np.ones(60_000, bool)
        keep[20_000:21_000] = False
        value = whole[SPEED].value.copy()
        value[45_000:45_100] = np.nan
        whole[SPEED] = Series(whole[SPEED].t_ns[keep], value[keep])
        parts = stretches(whole, replace(model, delays_s=Delays()))
        assert [round(part.rows, -3) for part in parts] == [20_000, 24_000, 15_000]
        assert relative_error(responses(parts)[SPEED]) < 0.015

    def test_what_is_missing_is_said(self, model: Model) -> None:
        with pytest.raises(ValueError, match="motor_torque_nm is missing"):
            stretches({}, model)
        with pytest.raises(ValueError, match="none of"):
            stretches({INPUT: self.series(1, np.zeros(100))}, model)


class TestChains:
    LOAD = Load(2.0e5, 2.0e4)

    @pytest.mark.parametrize(
        "order", [1, *(pytest.param(n, marks=pytest.mark.slow) for n in (2, 3, 4)), 5]
    )
    def test_without_friction_the_run_gives_the_closed_form(
        self, model: Model, chain: ChainParameters, order: int
    ) -> None:
        slippery = Friction(*(1e-9,) * 2, *(0.0,) * 4, 1e-6, 0.0, 1.0)
        free = replace(chain, column_friction=ColumnFriction(level_nm=0.0))
        rig = replace(model, friction=slippery)
        part = Stretch({INPUT: 0.2 * white(40.0, 11)})
        one = simulated(part, rig, free, order, self.LOAD)
        found = responses([one], ResponseSettings(resolution_hz=0.1))
        truth = linear_response(rig, free, order, self.LOAD, found[SPEED].frequency_hz)
        assert set(truth) == set(found) == set(OUTPUTS)
        for name, each in found.items():
            ratio = each.gain / truth[name]
            assert np.sqrt(np.mean(np.abs(ratio - 1.0) ** 2)) < 0.02, name

    def test_the_closed_form_at_rest_is_the_spring(
        self, model: Model, chain: ChainParameters
    ) -> None:
        """Limit case: one Nm at the rotor is i_APA newtons, over the load's spring."""
        low = np.array([1e-4])
        for order in ORDERS:
            found = linear_response(model, chain, order, self.LOAD, low)
            force = model.rack_to_rotor_ratio_rad_per_m
            assert found["rack_force_n"][0] == pytest.approx(force, rel=1e-3)
            spring = force / self.LOAD.stiffness_n_per_m
            assert abs(found["rack_position_m"][0]) == pytest.approx(spring, rel=0.05)

    @pytest.mark.slow
    def test_the_rigs_own_chain_agrees_and_the_single_mass_does_not(
        self, model: Model, chain: ChainParameters
    ) -> None:
        part = simulated(Stretch({INPUT: 0.1 * white(30.0, 12)}), model, chain, 5, self.LOAD)
        rig = responses([part])
        models = chain_responses([part], model, chain, self.LOAD, orders=(1, 5))
        for name in OUTPUTS:
            same = agreement(rig[name], models[5][name], 5)
            assert same.gain_error < 1e-3
            assert same.inside == 1.0
        assert agreement(rig[SPEED], models[1][SPEED], 1).gain_error > 0.2

    def test_the_load_is_found(self, model: Model, chain: ChainParameters) -> None:
        part = simulated(Stretch({INPUT: 0.1 * white(30.0, 13)}), model, chain, 4, self.LOAD)
        found = fitted_load([part])
        assert found.stiffness_n_per_m == pytest.approx(2.0e5, rel=0.02)
        assert found.damping_n_s_per_m == pytest.approx(2.0e4, rel=0.02)
        with pytest.raises(ValueError, match="needed"):
            fitted_load([Stretch({INPUT: np.zeros(10)})])
        short = Stretch({name: value[:5] for name, value in part.columns.items()})
        assert fitted_load([short, part, short]) == found
        with pytest.raises(ValueError, match="no stretch without gaps is as long as 100 ms"):
            fitted_load([short])
