"""Steering chains against eq. 1b, eigenvalues, a second integrator, and the energy they hold."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from scipy.integrate import solve_ivp

from eps_hil.compiled import direct
from eps_hil.errors import InputError
from eps_hil.physics.chain import (
    HAND_TORQUE,
    INPUTS,
    LOAD_DAMPING,
    LOAD_FORCE,
    LOAD_STIFFNESS,
    RACK,
    ROAD_WHEELS,
    ROTOR,
    STEERING_WHEEL,
    Chain,
    ChainState,
    build_chain,
    ratios,
    rest_state,
    stored_energy_j,
)
from eps_hil.physics.chain_parameters import (
    ChainParameters,
    ColumnFriction,
    FrictionShare,
    load_chain,
    rotor_inertia_kg_m2,
)
from eps_hil.physics.chain_reading import read_out
from eps_hil.physics.chain_step import advance
from eps_hil.physics.friction import friction_law
from eps_hil.physics.model import Friction, load_model

Floats = npt.NDArray[np.float64]

CONFIGS = Path(__file__).parents[2] / "configs"
ORDERS = (1, 2, 3, 4, 5)
BETWEEN = [pytest.param(order, marks=pytest.mark.slow) for order in (2, 3, 4)]
"""Chains that no other rig of the tests has: what takes seconds is quick for the others."""
NO_FRICTION = Friction(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1e-9, 0.0, 1.0)

model = load_model(CONFIGS / "reference_rig.yaml")
parameters = load_chain(CONFIGS / "reference_chain.yaml")
smooth_model = replace(model, friction=NO_FRICTION)
smooth = replace(
    parameters,
    column_friction=ColumnFriction(level_nm=0.0),
    end_stop=None,
    motor_dead_time_s=0.0,
    motor_time_constant_s=0.0,
)


def drive(
    chain: Chain,
    seconds: float,
    command: Callable[[float], float],
    row: Callable[[float], Floats],
    state: ChainState | None = None,
) -> tuple[ChainState, Floats]:
    """Step by step; columns: time and the readings, one line per integration step."""
    state = state or rest_state(chain)
    scratch, dt = np.zeros((2, INPUTS)), chain.step_s
    first = row(0.0)
    step = direct(advance, chain, state, 0.0, first, first, 1, scratch)
    read = direct(read_out, chain, state, first, first)
    lines = []
    for k in range(round(seconds / dt)):
        now, after = row(k * dt), row((k + 1) * dt)
        step(chain, state, float(command((k + 0.5) * dt)), now, after, 1, scratch)
        lines.append((k * dt + dt, *read(chain, state, after, (after - now) / dt)))
    return state, np.array(lines)


TIME, MOTOR, SENSOR, SPEED, ANGLE, FORCE, POSITION, WHEEL_ANGLE, WHEEL_SPEED, FRICTION = range(10)


def inputs(**values: float) -> Floats:
    row = np.zeros(INPUTS)
    for name, value in values.items():
        row[
            {"force": LOAD_FORCE, "hand": HAND_TORQUE, "k": LOAD_STIFFNESS, "d": LOAD_DAMPING}[name]
        ] = value
    return row


def no_input(_: float) -> Floats:
    return np.zeros(INPUTS)


def system(chain: Chain) -> Floats:
    """A of [q, ω]' = A [q, ω] for the free chain, shape (2n, 2n)."""
    n, inverse = chain.inertia.size, np.diag(1.0 / chain.inertia)
    zero, one = np.zeros((n, n)), np.eye(n)
    return np.block([[zero, one], [-inverse @ chain.stiffness, -inverse @ chain.damping]])


def speed_response(chain: Chain, frequency_hz: Floats, load_k: float, load_d: float) -> Floats:
    """|rotor speed / motor torque| of the linear chain against a spring-damper at the rack."""
    stiffness, damping = chain.stiffness.copy(), chain.damping.copy()
    end, rotor = chain.group[ROAD_WHEELS], chain.group[ROTOR]
    stiffness[end, end] += load_k / chain.rack_to_rotor**2
    damping[end, end] += load_d / chain.rack_to_rotor**2
    response = []
    for omega in 2 * np.pi * frequency_hz:
        dynamic = -(omega**2) * np.diag(chain.inertia) + 1j * omega * damping + stiffness
        torque = np.zeros(chain.inertia.size)
        torque[rotor] = 1.0
        response.append(abs(1j * omega * np.linalg.solve(dynamic, torque)[rotor]))
    return np.array(response)


class TestInertia:
    def test_equation_1b_gives_the_inertia_of_the_model_file(self) -> None:
        p, i_apa = parameters, model.rack_to_rotor_ratio_rad_per_m
        j_1m = (
            p.rack_mass_kg / i_apa**2
            + (p.tie_rod_ratio_rad_per_m / i_apa) ** 2 * p.road_wheel_inertia_kg_m2
            + rotor_inertia_kg_m2(model, p)
            + (1 / model.belt_ratio) ** 2 * p.ball_nut_inertia_kg_m2
        )
        assert j_1m == pytest.approx(2.0e-4, rel=1e-12)
        assert build_chain(model, p, 2).inertia[1] == pytest.approx(2.0e-4, rel=1e-12)

    @pytest.mark.parametrize("order", ORDERS)
    def test_reduction_moves_inertia_and_loses_none(self, order: int) -> None:
        chain = build_chain(model, parameters, order)
        side = model.rack_to_rotor_ratio_rad_per_m / model.pinion_ratio_rad_per_m
        wheel = parameters.steering_wheel_inertia_kg_m2 / side**2
        assert chain.inertia.size == order
        assert chain.inertia.sum() == pytest.approx(2.0e-4 + wheel, rel=1e-12)

    def test_without_steering_wheel_the_one_mass_is_the_estimation_model(self) -> None:
        chain = build_chain(model, parameters.without_steering_wheel(), 1)
        assert chain.inertia[0] == pytest.approx(2.0e-4, rel=1e-12)

    def test_masses_heavier_than_the_model_are_refused(self) -> None:
        with pytest.raises(InputError, match="more than the model file's inertia"):
            build_chain(model, replace(parameters, ball_nut_inertia_kg_m2=1e-2), 5)

    def test_a_given_rotor_inertia_must_agree_with_the_model(self) -> None:
        rotor = rotor_inertia_kg_m2(model, parameters)
        assert rotor_inertia_kg_m2(model, replace(parameters, rotor_inertia_kg_m2=rotor)) == rotor
        with pytest.raises(InputError, match=r"eq\. 1b"):
            build_chain(model, replace(parameters, rotor_inertia_kg_m2=1.1 * rotor), 5)

    def test_a_chain_has_one_to_five_masses(self) -> None:
        with pytest.raises(ValueError, match="1 to 5"):
            build_chain(model, parameters, 6)


class TestParameterFile:
    def test_friction_shares_must_add_up(self, tmp_path: Path) -> None:
        text = (CONFIGS / "reference_chain.yaml").read_text().replace("nut: 0.0", "nut: 0.5")
        (tmp_path / "chain.yaml").write_text(text)
        with pytest.raises(InputError, match=r"chain\.friction_share.*1\.5"):
            load_chain(tmp_path / "chain.yaml")

    def test_an_unknown_field_is_named_with_its_line(self, tmp_path: Path) -> None:
        (tmp_path / "chain.yaml").write_text("chain:\n  rack_mass: 3.0\n")
        with pytest.raises(InputError, match="rack_mass"):
            load_chain(tmp_path / "chain.yaml")


class TestSigns:
    """CONTRACT 1."""

    @pytest.mark.parametrize("order", ORDERS)
    @pytest.mark.parametrize(
        ("command", "row", "sign"),
        [(1.0, inputs(), 1), (0.0, inputs(force=2000.0), -1), (0.0, inputs(hand=8.0), 1)],
        ids=["motor", "rack force", "hand"],
    )
    def test_each_input_turns_everything_its_way(
        self, order: int, command: float, row: Floats, sign: int
    ) -> None:
        chain = build_chain(model, parameters, order)
        _, lines = drive(chain, 0.1, lambda _: command, lambda _: row)
        for column in (SPEED, ANGLE, POSITION, WHEEL_ANGLE, FRICTION):
            assert np.sign(lines[-1, column]) == sign

    @pytest.mark.parametrize("order", [1, 2])
    def test_equation_1d_holds_for_what_is_read_out(self, order: int) -> None:
        chain = build_chain(model, parameters, order)
        _, lines = drive(
            chain,
            0.5,
            lambda t: 0.6 * np.sin(20 * t),
            lambda t: inputs(force=500 * np.sin(9 * t), hand=3 * np.sin(31 * t)),
        )
        acceleration = np.gradient(lines[:, SPEED], lines[:, TIME])
        balance = (
            lines[:, MOTOR]
            + model.sensor_to_rotor * lines[:, SENSOR]
            - lines[:, FORCE] / model.rack_to_rotor_ratio_rad_per_m
            - lines[:, FRICTION]
            - 2.0e-4 * acceleration
        )[100:-1]
        assert np.sqrt(np.mean(balance**2)) < 2e-4


class TestLinearDynamics:
    @pytest.mark.parametrize("order", [*BETWEEN, 5])
    def test_free_oscillations_have_the_frequencies_of_the_eigenvalues(self, order: int) -> None:
        undamped = replace(
            smooth,
            torsion_bar_damping_nm_s_per_rad=0.0,
            belt_damping_nm_s_per_rad=0.0,
            ball_gear_damping_n_s_per_m=0.0,
            tie_rod_damping_n_s_per_m=0.0,
        )
        chain = build_chain(smooth_model, undamped, order)
        values, vectors = np.linalg.eig(-system(chain)[order:, :order])
        for value, shape in zip(values, vectors.T, strict=True):
            omega = np.sqrt(max(value.real, 0.0))
            if omega < 1.0:
                continue  # the free turning of the whole chain
            state = rest_state(chain)
            state.angle_rad[:] = shape.real
            rotor = shape.real[chain.group[ROTOR]]
            _, lines = drive(chain, 60 * np.pi / omega, lambda _: 0.0, no_input, state)
            angle = lines[:, ANGLE] / rotor
            zero = np.flatnonzero(np.diff(np.sign(angle)))
            at = zero + angle[zero] / (angle[zero] - angle[zero + 1])
            found = np.pi / (chain.step_s * np.mean(np.diff(at)))
            # The midpoint rule turns ω into 2/Δt·atan(ω Δt/2): 0.5 % at 760 Hz, nothing at 10 Hz.
            warped = 2 / chain.step_s * np.arctan(0.5 * omega * chain.step_s)
            assert found == pytest.approx(warped, rel=2e-4)
            assert found == pytest.approx(omega, rel=6e-3)

    def test_five_masses_against_a_second_integrator(self) -> None:
        chain = build_chain(smooth_model, smooth, 5)
        matrix, ratio = system(chain), ratios(smooth_model, smooth)

        def torque(t: float) -> float:
            return float(0.5 * np.sin(40 * t) + 0.2 * np.sin(300 * t))

        def row(t: float) -> Floats:
            return inputs(force=800 * np.sin(25 * t), hand=2 * np.sin(12 * t))

        def rate(t: float, state: Floats) -> Floats:
            external = np.zeros(5)
            external[ROTOR] = torque(t)
            external[ROAD_WHEELS] = -row(t)[LOAD_FORCE] / ratio[RACK]
            external[STEERING_WHEEL] = row(t)[HAND_TORQUE] / ratio[STEERING_WHEEL]
            change = matrix @ state
            change[5:] += external / chain.inertia
            return np.asarray(change)

        _, lines = drive(chain, 0.4, torque, row)
        other = solve_ivp(
            rate, (0, 0.4), np.zeros(10), "DOP853", lines[:, TIME], rtol=1e-9, atol=1e-9
        )
        for column, mass in ((SPEED, 5 + ROTOR), (ANGLE, ROTOR)):
            error = lines[:, column] - other.y[mass]
            assert np.abs(error).max() < 1e-3 * np.abs(other.y[mass]).max()
        wheel_error = lines[:, WHEEL_SPEED] * ratio[0] - other.y[5]
        assert np.abs(wheel_error).max() < 1e-3 * np.abs(other.y[5]).max()

    @pytest.mark.parametrize(
        ("order", "free_percent", "loaded_percent"),
        [(4, 0.1, 6.3), (3, 0.25, 6.3), (2, 2.0, 6.7)],
    )
    def test_orders_agree_up_to_6_hz(
        self, order: int, free_percent: float, loaded_percent: float
    ) -> None:
        """As fig. 5: rotor speed to motor torque; docs/theory-plant.md says where it parts.

        Against the rig's spring-damper the orders differ by 6 %: it pulls at the road wheels, so
        only the five masses have its spring in series with the tie rods.
        """
        frequency = np.linspace(0.5, 6.0, 60)
        full, reduced = build_chain(model, parameters, 5), build_chain(model, parameters, order)
        for load_k, load_d, percent in ((0.0, 0.0, free_percent), (2e5, 2e4, loaded_percent)):
            one = speed_response(full, frequency, load_k, load_d)
            other = speed_response(reduced, frequency, load_k, load_d)
            assert 100 * np.abs(other / one - 1).max() < percent

    def test_stiff_joints_make_one_mass_of_five(self) -> None:
        stiff = replace(
            smooth,
            torsion_bar_stiffness_nm_per_rad=1e7,
            torsion_bar_damping_nm_s_per_rad=2e3,
            belt_stiffness_nm_per_rad=1e7,
            belt_damping_nm_s_per_rad=2e2,
            ball_gear_stiffness_n_per_m=1e11,
            ball_gear_damping_n_s_per_m=1e7,
            tie_rod_stiffness_n_per_m=1e11,
            tie_rod_damping_n_s_per_m=1e8,
        )

        def run(order: int) -> Floats:
            chain = build_chain(model, replace(stiff, column_friction=ColumnFriction(0.1)), order)
            return drive(
                chain,
                0.5,
                lambda t: 0.8 * np.sin(15 * t),
                lambda t: inputs(force=900 * np.sin(7 * t), hand=np.sin(11 * t)),
            )[1]

        five, one = run(5), run(1)
        for column in (SPEED, POSITION, WHEEL_ANGLE, FRICTION):
            error = np.abs(five[:, column] - one[:, column]).max()
            assert error < 2e-3 * np.abs(one[:, column]).max()
        # A rigid bar's torque is computed from the balance; the stiff bar's is measured.
        sensor = five[:, SENSOR] - one[:, SENSOR]
        assert np.sqrt(np.mean(sensor**2)) < 5e-3 * np.abs(one[:, SENSOR]).max()

    def test_dead_time_and_lag_of_the_motor(self) -> None:
        chain = build_chain(model, parameters, 5)
        _, lines = drive(chain, 0.006, lambda _: 0.5, no_input)
        since = lines[:, TIME] - parameters.motor_dead_time_s
        expected = np.where(since > 0, 0.5 * (1 - np.exp(-since / 1e-3)), 0.0)
        assert np.abs(lines[:, MOTOR] - expected).max() < 1e-9

    def test_the_motor_gives_no_more_than_its_limit(self) -> None:
        _, lines = drive(build_chain(model, parameters, 5), 0.02, lambda _: 99.0, no_input)
        assert lines[-1, MOTOR] == pytest.approx(parameters.motor_torque_limit_nm, rel=1e-6)


class TestFriction:
    def test_one_mass_lugre_against_a_second_integrator(self) -> None:
        chain = build_chain(model, replace(smooth.without_steering_wheel()), 1)
        law = friction_law(model.friction)

        def force(t: float) -> float:
            return float(600 * np.sin(9 * t))

        def torque(t: float) -> float:
            return float(0.45 * np.sin(21 * t))

        def rate(t: float, state: Floats) -> list[float]:
            _, speed, bristle = state
            plus, load = speed >= 0, abs(force(t))
            level = (
                law.offset_pos_nm
                + law.viscous_pos_nm_s_per_rad * speed
                + law.load_pos_nm_per_n * load
                if plus
                else law.offset_neg_nm
                - law.viscous_neg_nm_s_per_rad * speed
                + law.load_neg_nm_per_n * load
            )
            change = speed - abs(speed) * law.sigma0_nm_per_rad * bristle / level
            sigma1 = law.sigma1_nm_s_per_rad * np.exp(-((speed / law.sigma1_speed_rad_s) ** 2))
            friction = law.sigma0_nm_per_rad * bristle + sigma1 * change
            accel = (torque(t) - force(t) / model.rack_to_rotor_ratio_rad_per_m - friction) / 2e-4
            return [speed, accel, change]

        _, lines = drive(chain, 1.0, torque, lambda t: inputs(force=force(t)))
        other = solve_ivp(
            rate,
            (0, 1.0),
            np.zeros(3),
            "LSODA",
            lines[:, TIME],
            rtol=1e-8,
            atol=1e-10,
            max_step=1e-3,
        )
        assert np.abs(lines[:, SPEED] - other.y[1]).max() < 1e-3 * np.abs(other.y[1]).max()
        assert np.abs(lines[:, ANGLE] - other.y[0]).max() < 1e-3 * np.abs(other.y[0]).max()

    @pytest.mark.parametrize("order", [1, *BETWEEN, 5])
    def test_a_load_below_the_friction_level_is_held(self, order: int) -> None:
        chain = build_chain(model, parameters, order)
        _, lines = drive(chain, 1.5, lambda _: 0.0, lambda t: inputs(force=100 * min(t / 0.2, 1.0)))
        torque = 100 / model.rack_to_rotor_ratio_rad_per_m
        assert torque < model.friction.offset_pos_nm
        assert abs(lines[-1, SPEED]) < 2e-2
        # At rest the bristle carries the load: pushed to the negative side by T/σ0.
        assert lines[-1, FRICTION] == pytest.approx(-torque, rel=0.02)
        assert -0.02 < lines[-1, ANGLE] < 0.0

    @pytest.mark.parametrize(("order", "load"), [(1, 0.0), (5, 0.0), (5, 800.0)])
    def test_constant_torque_ends_at_the_speed_that_friction_and_load_allow(
        self, order: int, load: float
    ) -> None:
        friction = replace(model.friction, viscous_pos_nm_s_per_rad=2e-3)  # soon steady
        chain = build_chain(replace(model, friction=friction), smooth, order)
        torque = 0.15 + 2 * load / model.rack_to_rotor_ratio_rad_per_m
        _, lines = drive(chain, 1.5, lambda _: torque, lambda _: inputs(force=load))
        left = torque - load / model.rack_to_rotor_ratio_rad_per_m
        left -= friction.offset_pos_nm + friction.load_pos_nm_per_n * load
        steady = left / friction.viscous_pos_nm_s_per_rad
        assert np.mean(lines[-2000:, SPEED]) == pytest.approx(steady, rel=2e-3)

    def test_friction_on_nut_and_rack_is_the_same_friction_below_the_resonances(self) -> None:
        shared = replace(parameters, friction_share=FrictionShare(0.4, 0.35, 0.25))

        def run(p: ChainParameters) -> Floats:
            chain = build_chain(model, p, 5)
            return drive(
                chain,
                1.0,
                lambda t: 0.5 * np.sin(8 * t),
                lambda t: inputs(force=400 * np.sin(5 * t)),
            )[1]

        one, spread = run(parameters), run(shared)
        assert np.abs(one[:, SPEED] - spread[:, SPEED]).max() < 0.02 * np.abs(one[:, SPEED]).max()


class TestEnergy:
    @pytest.mark.parametrize("order", [1, *BETWEEN, 5])
    def test_work_is_stored_or_lost(self, order: int) -> None:
        """Booked in the kernel, and by trapezoids over the read-out: both must close."""
        chain = build_chain(model, parameters, order)
        row = lambda t: inputs(  # noqa: E731
            force=700 * np.sin(19 * t), hand=3 * np.sin(8 * t), k=3e4, d=500.0
        )
        state, lines = drive(chain, 1.5, lambda t: 0.6 * np.sin(13 * t), row)
        motor, load, hand, joints, friction, stop = state.energy_j
        stored = stored_energy_j(chain, state)
        assert abs(motor + load + hand - joints - friction - stop - stored) < 1e-6 * friction

        time = lines[:, TIME]
        assert np.trapezoid(lines[:, MOTOR] * lines[:, SPEED], time) == pytest.approx(
            motor, rel=1e-3, abs=1e-3 * friction
        )
        rack_speed = np.gradient(lines[:, POSITION], time)
        if order < 5:  # with five masses the load moves with the road wheels
            assert -np.trapezoid(lines[:, FORCE] * rack_speed, time) == pytest.approx(
                load, rel=1e-3, abs=1e-3 * friction
            )
        assert joints >= 0.0
        assert friction > 0.0

    def test_without_input_energy_only_falls(self) -> None:
        chain = build_chain(model, parameters, 5)
        state = rest_state(chain)
        state.speed_rad_s[:] = (30.0, -80.0, -60.0, 50.0, 20.0)
        scratch, still = np.zeros((2, INPUTS)), np.zeros(INPUTS)
        # What the bristles hold comes back, so it counts as stored here.
        law = friction_law(model.friction)

        def held() -> float:
            bristles = 0.5 * law.sigma0_nm_per_rad * chain.friction_share @ state.bristle_rad**2
            column = 0.5 * chain.column.sigma0_nm_per_rad * state.column_bristle_rad[0] ** 2
            return stored_energy_j(chain, state) + float(bristles) + float(column)

        energy = [held()]
        for _ in range(4000):
            advance(chain, state, 0.0, still, still, 1, scratch)
            energy.append(held())
        assert np.diff(energy).max() < 1e-9 * energy[0]
        assert energy[-1] < 0.05 * energy[0]

    def test_the_end_stop_holds_the_rack(self) -> None:
        chain = build_chain(model, parameters, 5)
        _, lines = drive(chain, 1.5, lambda _: 2.0, no_input)
        assert 0.08 < lines[:, POSITION].max() < 0.1
        assert lines[-1, POSITION] < 0.0865


def test_the_documentation_lists_the_eigenfrequencies() -> None:
    text = (CONFIGS.parent / "docs" / "theory-plant.md").read_text(encoding="utf-8")
    for order in ORDERS[1:]:
        line = next(line for line in text.splitlines() if line.startswith(f"| {order} | "))
        listed = [float(word) for word in line.split("|")[4].split(",")]
        values = np.linalg.eigvals(system(build_chain(model, parameters, order)))
        found = sorted(np.abs(values[values.imag > 1]) / (2 * np.pi))
        assert listed == pytest.approx(found, abs=0.05)
