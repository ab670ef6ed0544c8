"""Fig. 14: friction offsets by torque injection, hands on, from wrong starting values."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

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
_LONGEST_S = 120.0
_WRONG = 1.4


@dataclass(frozen=True, slots=True)
class Injected:
    """One injection: its commands and the truth, each millisecond."""

    injection: TorqueInjection
    commands: list[InjectionCommand]
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
        "Fig. 14: friction offsets by torque injection",
        f"{settings.repetitions} ramps a direction of {settings.ramp_nm_per_s:g} Nm/s; the model "
        "starts with both offsets 40 % too high. 'as the paper' is the torque at which movement "
        "is seen; the corrected level takes inertia, ramp and delay out.",
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
    truth, reported = np.zeros(len(TRUE_SIGNALS)), np.zeros(len(REPORTED))
    names = [name for name in InjectionInputs._fields if name != "rack_force_n"]
    commands: list[InjectionCommand] = []
    rows = []
    for millisecond in range(plant.rows):
        active = bool(commands) and commands[-1].active
        plant.step(truth, commands[-1].torque_nm if active else None)
        sensors.step(truth, reported)
        values = dict(zip(REPORTED, reported.tolist(), strict=True))
        inputs = InjectionInputs(**{name: values[name] for name in names})
        commands.append(injection.step(millisecond * 1_000_000, inputs))
        rows.append(truth.copy())
        if injection.phase.over:
            break
    return Injected(injection, commands, np.array(rows))


def _levels(one: Injected, sign: int) -> tuple[float, float]:
    """(corrected level, level as the paper reads it) of a direction, Nm; NaN where none."""
    result = one.injection.result
    if result is None:
        return float("nan"), float("nan")
    own = [each for each in result.repetitions if each.direction == sign]
    level = result.positive if sign > 0 else result.negative
    return level.offset_nm, float(np.mean([each.detection_nm for each in own]))


def _real(bench: Workbench, sign: int) -> float:
    friction = bench.model.friction
    return friction.offset_pos_nm if sign > 0 else friction.offset_neg_nm


def _table(runs: dict[str, Injected], bench: Workbench) -> Table:
    columns = (
        "driver", "parameter", "real in Nm", "start in Nm", "as the paper in Nm",
        "corrected in Nm", "as the paper: off by %", "corrected: off by %", "duration in s",
    )  # fmt: skip
    rows = []
    for name, one in runs.items():
        for sign, symbol in ((1, "k0+"), (-1, "k0-")):
            real = _real(bench, sign)
            corrected, plain = _levels(one, sign)
            away = [100.0 * (value / real - 1.0) for value in (plain, corrected)]
            rows.append(
                (name, symbol, real, _WRONG * real, plain, corrected, *away,
                 len(one.commands) / 1000.0)
            )  # fmt: skip
    return Table("offsets found by torque injection", columns, tuple(rows))


def _statements(runs: dict[str, Injected], bench: Workbench) -> list[Statement]:
    one = runs["hands on"]
    plus, minus = (_levels(one, sign) for sign in (1, -1))
    real = _real(bench, 1), _real(bench, -1)
    asymmetry = (minus[0] - plus[0]) / (real[1] - real[0])
    return [
        at_most(
            "torque injection finds the asymmetric offsets, hands on",
            "larger deviation of k0+ and k0−, corrected",
            100.0 * max(abs(plus[0] / real[0] - 1.0), abs(minus[0] / real[1] - 1.0)),
            "%", (5.0, 10.0),
        ),
        at_most(
            "the last torque of the ramp is the new offset (read without correction)",
            "larger deviation of k0+ and k0−",
            100.0 * max(abs(plus[1] / real[0] - 1.0), abs(minus[1] / real[1] - 1.0)),
            "%", (5.0, 15.0),
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
                frameon=False, fontsize="small", ncols=4, loc="lower center",
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
