"""Fig. 14: friction offsets by torque injection and error injection, from wrong values."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from eps_hil.adaptation.error_injection import ErrorInjection, ErrorInjectionSettings
from eps_hil.adaptation.gates import InjectionInputs
from eps_hil.adaptation.injection_settings import InjectionSettings
from eps_hil.adaptation.torque_injection import InjectionCommand, TorqueInjection
from eps_hil.physics.model import Model
from eps_hil.report import figures
from eps_hil.reproduction.result import Result, Statement, Table, at_least, at_most
from eps_hil.reproduction.workbench import Workbench
from eps_hil.rig.manoeuvre import Driver, Manoeuvre, Segment
from eps_hil.rig.plant import TRUE_SIGNALS, Plant
from eps_hil.rig.sensors import REPORTED, Sensors, SensorSettings

Floats = npt.NDArray[np.float64]

HANDS_ON = Driver(stiffness_nm_per_rad=60.0, damping_nm_s_per_rad=2.0)
ERROR_INJECTION = ErrorInjectionSettings(gain_per_s=10.0, speed_rad_s=0.3)
"""Quicker, and from slower movements on, than in driving: a few ramps are all there is."""
_LONGEST_S = 120.0
_WRONG = 1.4


@dataclass(frozen=True, slots=True)
class Injected:
    """One injection with error injection listening: commands, inputs and truth, each ms."""

    injection: TorqueInjection
    error_levels_nm: Floats  # (n, 2): k0+ and k0− of error injection in the same test
    commands: list[InjectionCommand]
    inputs: list[InjectionInputs]
    truth: Floats

    def column(self, name: str) -> Floats:
        """A true signal, (n,)."""
        return np.asarray(self.truth[:, TRUE_SIGNALS.index(name)])


def make(bench: Workbench, folder: Path) -> Result:
    """Ramps in both directions on the rig; the model starts with k0± 40 % too high."""
    friction = bench.model.friction
    wrong = replace(
        bench.model,
        friction=replace(
            friction,
            offset_pos_nm=_WRONG * friction.offset_pos_nm,
            offset_neg_nm=_WRONG * friction.offset_neg_nm,
        ),
    )
    settings = InjectionSettings(repetitions=1 if bench.quick else 3)
    runs = {
        name: inject(bench, wrong, settings, driver)
        for name, driver in (("hands on", HANDS_ON), ("hands off", Driver()))
    }
    picture = _draw(runs["hands on"], bench, folder / "fig14.png")
    return Result(
        "fig14",
        "Fig. 14: friction offsets by torque injection (TI) and error injection (EI)",
        f"{settings.repetitions} ramps a direction of {settings.ramp_nm_per_s:g} Nm/s; the model "
        "starts with both offsets 40 % too high. Torque injection 'as the paper' takes the torque "
        "at which movement is seen; otherwise inertia, ramp and delay are taken out. Error "
        f"injection listens to the same test (gain {ERROR_INJECTION.gain_per_s:g} per s, from "
        f"{ERROR_INJECTION.speed_rad_s:g} rad/s on).",
        [_table(runs, bench)],
        _statements(runs, bench),
        picture,
    )


def inject(
    bench: Workbench, believed: Model, settings: InjectionSettings, driver: Driver
) -> Injected:
    """The five-mass rig in closed loop with an injection, until that is over."""
    segment = Segment(duration_s=_LONGEST_S, driver=driver)
    plant = Plant(bench.model, bench.chain, 5, Manoeuvre("injection", (segment,)).table())
    sensors = Sensors(bench.model, SensorSettings(), bench.seed + 14)
    injection = TorqueInjection(settings, believed)
    listening, levels = ErrorInjection(ERROR_INJECTION, believed), []
    truth, reported = np.zeros(len(TRUE_SIGNALS)), np.zeros(len(REPORTED))
    names = [name for name in InjectionInputs._fields if name != "rack_force_n"]
    commands: list[InjectionCommand] = []
    told: list[InjectionInputs] = []
    rows = []
    for millisecond in range(plant.rows):
        active = bool(commands) and commands[-1].active
        plant.step(truth, commands[-1].torque_nm if active else None)
        sensors.step(truth, reported)
        values = dict(zip(REPORTED, reported.tolist(), strict=True))
        told.append(InjectionInputs(**{name: values[name] for name in names}))
        commands.append(injection.step(millisecond * 1_000_000, told[-1]))
        levels.append(tuple(listening.step(millisecond * 1_000_000, told[-1]).levels))
        rows.append(truth.copy())
        if injection.phase.over:
            break
    return Injected(injection, np.array(levels), commands, told, np.array(rows))


METHODS = ("torque injection", "torque injection, as the paper", "error injection")
_BEST, _PAPER, _ERROR = METHODS


def _found(one: Injected, sign: int) -> dict[str, float]:
    """k0 of a direction by every method, Nm; NaN where there is none."""
    result, missing = one.injection.result, float("nan")
    found = dict.fromkeys(METHODS, missing)
    found[_ERROR] = float(one.error_levels_nm[-1, 0 if sign > 0 else 1])
    if result is not None:
        own = [each.detection_nm for each in result.repetitions if each.direction == sign]
        found[_BEST] = (result.positive if sign > 0 else result.negative).offset_nm
        found[_PAPER] = float(np.mean(own))
    return found


def _real(bench: Workbench, sign: int) -> float:
    friction = bench.model.friction
    return friction.offset_pos_nm if sign > 0 else friction.offset_neg_nm


def _deviation(one: Injected, bench: Workbench, method: str) -> float:
    """The larger deviation of both directions, percent."""
    return 100.0 * max(
        abs(_found(one, sign)[method] / _real(bench, sign) - 1.0) for sign in (1, -1)
    )


def _table(runs: dict[str, Injected], bench: Workbench) -> Table:
    columns = ("driver", "parameter", "method", "start in Nm", "real in Nm", "found in Nm",
               "off by %", "duration in s")  # fmt: skip
    rows = []
    for name, one in runs.items():
        for sign, symbol in ((1, "k0+"), (-1, "k0-")):
            real = _real(bench, sign)
            for method, value in _found(one, sign).items():
                away = 100.0 * (value / real - 1.0)
                seconds = len(one.commands) / 1000.0
                rows.append((name, symbol, method, _WRONG * real, real, value, away, seconds))
    return Table("friction offsets found in the same test", columns, tuple(rows))


def _statements(runs: dict[str, Injected], bench: Workbench) -> list[Statement]:
    one = runs["hands on"]
    away = {method: _deviation(one, bench, method) for method in METHODS}
    plus, minus = (_found(one, sign)[_BEST] for sign in (1, -1))
    asymmetry = (minus - plus) / (_real(bench, -1) - _real(bench, 1))
    measure = "larger deviation of k0+ and k0−"
    return [
        at_most(
            "torque injection is suitable to estimate the asymmetric offset (hands on, corrected)",
            measure, away[_BEST], "%", (5.0, 10.0),
        ),
        at_most(
            "the last torque of the ramp is the new offset (hands on, read as the paper does)",
            measure, away[_PAPER], "%", (5.0, 15.0),
        ),
        at_most(
            "error injection is suitable to estimate the asymmetric offset (hands on)",
            measure, away[_ERROR], "%", (5.0, 15.0),
        ),
        at_most(
            "error injection gives slightly better results",
            "its deviation ÷ that of torque injection as the paper reads it",
            away[_ERROR] / away[_PAPER], "", (1.0, 1.5),
            "against torque injection with inertia, ramp and delay taken out the ratio is "
            f"{away[_ERROR] / away[_BEST]:.3g}",
        ),
        at_least(
            "the asymmetry of both directions is found",
            "found ÷ real difference k0− − k0+, or its inverse if that is smaller",
            min(asymmetry, 1.0 / asymmetry) if asymmetry > 0 else 0.0, "", (0.9, 0.7),
        ),
    ]  # fmt: skip


def _draw(one: Injected, bench: Workbench, path: Path) -> Path:
    figure, axes = figures.subplots(2, 2, width_cm=30.0, height_cm=17.0)
    time_s = np.arange(len(one.commands)) / 1000.0
    flag = np.array([float(command.active) for command in one.commands])
    direction = np.array([float(command.direction) for command in one.commands])
    plot = axes[0, 0].plot
    plot(time_s, flag, color=figures.COLOURS[0], label="adaptation active")
    plot(time_s, direction, color=figures.COLOURS[1], label="direction")
    axes[0, 0].set_ylabel("flag")
    _draw_levels(axes[0, 1], one, bench, float(time_s[-1]))
    axes[1, 0].plot(time_s, one.column("motor_speed_rad_s"), color=figures.COLOURS[0], lw=0.9)
    axes[1, 0].set_ylabel("rotor speed in rad/s")
    injected = np.array([command.torque_nm for command in one.commands])
    axes[1, 1].plot(time_s, injected, color=figures.COLOURS[0], lw=1.0, label="T_em (injected)")
    sensor = one.column("torque_sensor_nm")
    axes[1, 1].plot(time_s, sensor, color=figures.COLOURS[1], lw=1.0, label="T_sen (torsion bar)")
    axes[1, 1].set_ylabel("torque in Nm")
    for axis, title in zip(
        axes.flat,
        ("adaptation flag and direction", "friction offsets", "rotor speed", "torques"),
        strict=True,
    ):
        axis.set_title(title, fontsize="medium", pad=22.0)
        axis.set_xlabel("time in s")
        if axis is not axes[1, 0]:
            axis.legend(
                frameon=False, fontsize="x-small", ncols=6, loc="lower center",
                bbox_to_anchor=(0.5, 1.0),
            )  # fmt: skip
    return figures.save(figure, path)


def _draw_levels(axis: object, one: Injected, bench: Workbench, end_s: float) -> None:
    """k0± over time: the start value until a repetition ends, then the mean of those so far."""
    ends = _ends(one)
    for sign, colour, symbol in ((1, figures.COLOURS[0], "k0+"), (-1, figures.COLOURS[1], "k0−")):
        real = sign * _real(bench, sign)
        found = [each for each in one.injection.repetitions if each.direction == sign]
        at, value = [0.0], [_WRONG * real]
        for k, each in enumerate(found):
            at.append(ends[each.number - 1])
            value.append(sign * float(np.mean([other.offset_nm for other in found[: k + 1]])))
        axis.step(  # type: ignore[attr-defined]
            [*at, end_s], [*value, value[-1]], where="post", color=colour, label=f"{symbol}, TI"
        )
        time_s = np.arange(len(one.commands)) / 1000.0
        level = sign * one.error_levels_nm[:, 0 if sign > 0 else 1]
        shade = figures.COLOURS[2 if sign > 0 else 4]
        axis.plot(time_s, level, color=shade, lw=1.0, label=f"{symbol}, EI")  # type: ignore[attr-defined]
        axis.axhline(  # type: ignore[attr-defined]
            real, color=colour, linestyle=(0, (4, 2)), lw=0.9, label=f"{symbol}, real"
        )
    axis.set_ylabel("T_f in Nm")  # type: ignore[attr-defined]


def _ends(one: Injected) -> list[float]:
    """When each repetition was evaluated, in s: where the counter moves on."""
    count = np.array([command.repetition for command in one.commands])
    steps = np.flatnonzero(np.diff(count) > 0) + 1
    ends = [float(step) / 1000.0 for step in steps]
    return [*ends, len(one.commands) / 1000.0]
