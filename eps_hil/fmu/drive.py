"""Somebody's FMU driven by recordings: its answer as canonical signals, at physical instants.

On the rig a controller holds the rotor where it should be; a simulator under the recorded torque
alone has none, and a small difference of friction carries it away. So a soft spring and damper
keep it at the recorded motion, through its motor torque; what they add is part of the trace's
motor torque, which is the one that acted, and of itself says what the simulator lacks.
"""

import contextlib
import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from ctypes import POINTER, c_double, c_int, c_uint32, cast
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from eps_hil.errors import EpsHilError, InputError
from eps_hil.fmu.described import Described, read_fmu
from eps_hil.fmu.mapping import Link, Mapped, map_fmu
from eps_hil.fmu.quiet import quiet
from eps_hil.physics.model import Model
from eps_hil.recordings.foreign import Columns
from eps_hil.series import Series

Floats = npt.NDArray[np.float64]
Signals = Mapping[str, Series]
STEP_S = 1e-3
_LONGEST_S = 0.02
_TURN, _HALF_A_TURN_S = 2.0 * np.pi, 0.002
"""In a step of so long no rotor turns by half a turn: an angle that jumps by one begins anew."""


class FmuError(EpsHilError):
    """The FMU refused, or failed while it ran."""


MOTION = ("motor_speed_rad_s", "motor_angle_rad")
FOLLOW_RAD_S = 2.0 * np.pi * 8.0
"""How fast the simulator is brought back to the recorded motion."""


@dataclass(frozen=True, slots=True)
class Follow:
    """A recorded motion and what holds a simulator at it; columns of outputs, -1: none."""

    speed_rad_s: Floats
    angle_rad: Floats
    stiffness: float
    damping: float
    speed_at: int
    angle_at: int

    def motion(
        self, out: Floats, k: int, links: Sequence[Link], angle: float, step_s: float
    ) -> tuple[float, float]:
        """Speed, and angle since the start, that the simulator gives; ``angle`` before."""
        if self.angle_at < 0:
            speed = _si(links, out, k, self.speed_at)
            return speed, angle + speed * step_s if k else 0.0
        now = _si(links, out, k, self.angle_at) - _si(links, out, 0, self.angle_at)
        if step_s <= _HALF_A_TURN_S:
            now += _TURN * float(np.rint((angle - now) / _TURN))
        if self.speed_at >= 0:
            return _si(links, out, k, self.speed_at), now
        return (now - angle) / step_s, now

    def torque_nm(self, speed: float, angle: float, k: int) -> float:
        """What pulls the simulator back."""
        wrong, turned = self.speed_rad_s[k] - speed, self.angle_rad[k] - angle
        return float(self.damping * wrong + self.stiffness * turned)


Watch = tuple[Follow | None, Floats, list[float]]


def _si(links: Sequence[Link], out: Floats, k: int, at: int) -> float:
    return float(links[at].scale * out[k, at] + links[at].offset)


class Simulator:
    """A co-simulation FMU with its mapping; :func:`opened` makes one and clears up after it."""

    def __init__(self, fmu: Described, mapped: Mapped, folder: Path) -> None:
        self.fmu, self.mapped = fmu, mapped
        self.step_s = _step_s(fmu)
        if self.step_s > _LONGEST_S:
            problem = f"takes steps of {self.step_s:g} s alone, 0.02 s or less was expected"
            raise InputError(fmu.path, "", problem, "export it with a smaller step")
        self._folder = folder
        self._messages: list[str] = []
        self._deaf = False

    def notes(self) -> list[str]:
        """How its variables were understood, a sentence each, for a person."""
        links = (*self.mapped.inputs.values(), *self.mapped.outputs.values())
        notes = [one.said() for one in links]
        if self.mapped.open:
            every = {**self.fmu.variables, **self.fmu.others}
            each = (f"{n} ({every[n].begins or 'unknown'})" for n in self.mapped.open)
            notes.append(f"inputs that stay at their start: {', '.join(each)}")
        return notes

    def grid(self, series: Signals, model: Model) -> npt.NDArray[np.int64]:
        """Physical instants (ns, by the recording's clock) at which the FMU is asked."""
        known = [name for name in ("motor_torque_nm", *MOTION) if name in series]
        ends = [
            (int(one.t_ns[0]) - late, int(one.t_ns[-1]) - late)
            for one, late in (
                (series[name], round(model.delays_s.of(name) * 1e9)) for name in known
            )
        ]
        first, last = max(start for start, _ in ends), min(end for _, end in ends)
        step = round(self.step_s * 1e9)
        return np.arange(first, last + 1, step, dtype=np.int64)

    def inputs(self, series: Signals, model: Model, t_ns: npt.NDArray[np.int64]) -> Floats:
        """Recorded inputs (n, inputs) in the FMU's units at physical instants."""
        columns = [_back(one, physical(series, name, t_ns, model))
                   for name, one in self.mapped.inputs.items()]  # fmt: skip
        return np.column_stack(columns)

    def run(
        self,
        inputs: Floats,
        values: Mapping[str, float] | None = None,
        begin: Mapping[str, float] | None = None,
        follow: Follow | None = None,
    ) -> tuple[dict[str, Floats], Floats]:
        """The mapped outputs under ``inputs`` (n, inputs) on an even grid, and the torque (Nm)
        that was added to stay at ``follow``; (n,) each.

        ``values``: parameters and :attr:`Mapped.open` inputs by their names, in the FMU's units;
        ``begin``: canonical values at
        the start, where the FMU has a parameter for it. :class:`FmuError` if it fails.
        """
        values = {**(values or {}), **self._begin(begin or {})}
        out = np.empty((len(inputs), len(self.mapped.outputs)))
        added = np.zeros(len(inputs))
        at = [0.0]
        try:
            with quiet(), self._instance() as instance:
                self._go(instance, inputs, values, out, (follow, added, at))
        except EpsHilError:
            raise
        except Exception as error:  # FMPy's own, and what ctypes makes of a bad library
            raise self._failed(at[0], error) from None
        if not np.isfinite(out).all():
            row = int(np.argmin(np.isfinite(out).all(axis=1)))
            raise FmuError(f"{self.fmu.path}: gives what is no number after "
                           f"{row * self.step_s:.4g} s")  # fmt: skip
        given = {
            name: one.scale * out[:, k] + one.offset
            for k, (name, one) in enumerate(self.mapped.outputs.items())
        }
        if "motor_angle_rad" in given and self.step_s <= _HALF_A_TURN_S:
            given["motor_angle_rad"] = np.unwrap(given["motor_angle_rad"])
        return given, added

    def _begin(self, begin: Mapping[str, float]) -> dict[str, float]:
        return {one.variable.name: float(_back(one, np.array([begin[name]]))[0])
                for name, one in self.mapped.start.items() if name in begin}  # fmt: skip

    def trace(
        self, series: Signals, model: Model, values: Mapping[str, float] | None = None
    ) -> dict[str, Series]:
        """A recording's inputs through the FMU: what drove it and what it gave, in SI."""
        t_ns = self.grid(series, model)
        given = self.inputs(series, model, t_ns)
        begin = {name: float(physical(series, name, t_ns[:1], model)[0])
                 for name in self.mapped.start if name in series}  # fmt: skip
        out, added = self.run(given, values, begin, self.follow(series, model, t_ns))
        driven = {
            name: one.scale * given[:, k] + one.offset
            for k, (name, one) in enumerate(self.mapped.inputs.items())
        }
        # what is held over a step acts in its middle
        driven["motor_torque_nm"] += 0.5 * (added + np.append(added[:1], added[:-1]))
        return {name: Series(t_ns, value) for name, value in {**out, **driven}.items()}

    def follow(self, series: Signals, model: Model, t_ns: npt.NDArray[np.int64]) -> Follow:
        """The recorded motion that the FMU is kept at."""
        speed = physical(series, "motor_speed_rad_s", t_ns, model)
        if "motor_angle_rad" in series:
            angle = physical(series, "motor_angle_rad", t_ns, model)
            if "motor_speed_rad_s" not in series:
                speed = np.gradient(angle, self.step_s)
        else:
            angle = np.cumsum(speed) * self.step_s
        names = list(self.mapped.outputs)
        places = (names.index(n) if n in names else -1 for n in MOTION)
        stiffness = model.inertia_kg_m2 * FOLLOW_RAD_S**2
        damping = 2.0 * model.inertia_kg_m2 * FOLLOW_RAD_S
        return Follow(speed, angle - angle[0], stiffness, damping, *places)

    @contextlib.contextmanager
    def _instance(self) -> Iterator[Any]:
        from fmpy.simulation import instantiate_fmu

        self._messages.clear()
        self._deaf = False
        logger = self._log3 if self.fmu.version.startswith("3") else self._log2
        made = instantiate_fmu(
            str(self._folder), self.fmu.raw, "CoSimulation", logger=logger, require_functions=False
        )
        try:
            yield made
        except Exception:
            self._deaf = True  # to what it says while it is taken down
            raise
        finally:
            with contextlib.suppress(Exception):
                made.terminate()
            with contextlib.suppress(Exception):
                made.freeInstance()

    def _log2(self, _environment: Any, _name: Any, _status: int, _category: Any, text: Any) -> None:
        self._heard(text)

    def _log3(self, _environment: Any, _status: int, _category: Any, text: Any) -> None:
        self._heard(text)

    def _heard(self, text: bytes | str | None) -> None:
        if self._deaf:
            return
        said = text.decode(errors="replace") if isinstance(text, bytes) else text or ""
        self._messages = [*self._messages[-3:], " ".join(said.split())]

    def _failed(self, at_s: float, error: Exception) -> FmuError:
        said = self._messages[-1] if self._messages else " ".join(str(error).split())
        where = f"fails at {at_s:.4g} s" if at_s > 0.0 else "does not start"
        return FmuError(f"{self.fmu.path}: {where}: {said}")

    def _go(
        self, fmu: Any, inputs: Floats, values: Mapping[str, float], out: Floats, watch: Watch
    ) -> None:
        three = self.fmu.version.startswith("3")
        length = (len(inputs) - 1) * self.step_s
        put = fmu.setFloat64 if three else fmu.setReal
        if not three:
            fmu.setupExperiment(startTime=0.0, stopTime=length)
        for name, value in values.items():
            self._set(fmu, name, value, three)
        if three:
            fmu.enterInitializationMode(startTime=0.0, stopTime=length)
        else:
            fmu.enterInitializationMode()
        taken = [one.variable.reference for one in self.mapped.inputs.values()]
        put(taken, inputs[0].tolist())
        fmu.exitInitializationMode()
        self._steps(fmu, inputs, out, *watch)

    def _set(self, fmu: Any, name: str, value: float, three: bool) -> None:
        one = self.fmu.variables.get(name) or self.fmu.others[name]
        number = "Int64" if three else "Integer"
        put = getattr(fmu, f"set{number if one.kind == 'Enumeration' else one.kind}")
        whole = one.whole or one.kind == "Boolean"
        put([one.reference], [int(value) if whole else float(value)])

    def _steps(
        self,
        fmu: Any,
        inputs: Floats,
        out: Floats,
        follow: Follow | None,
        added: Floats,
        at: list[float],
    ) -> None:
        """The loop: nothing is allocated by us in it, since a fit runs it a thousand times."""
        three, step = self.fmu.version.startswith("3"), self.step_s
        n, m = inputs.shape[1], out.shape[1]
        taken = (c_uint32 * n)(*(one.variable.reference for one in self.mapped.inputs.values()))
        given = (c_uint32 * m)(*(one.variable.reference for one in self.mapped.outputs.values()))
        order = (c_int * n)(*([1] * n))
        held, slopes = _held(inputs, step, self.fmu.interpolates)

        column = list(self.mapped.inputs).index("motor_torque_nm")
        per_nm = 1.0 / self.mapped.inputs["motor_torque_nm"].scale
        links = list(self.mapped.outputs.values())
        angle = 0.0

        def row(array: Floats, k: int) -> Any:
            return cast(array.ctypes.data + 8 * k * array.shape[1], POINTER(c_double))

        component = fmu.component
        for k in range(len(inputs)):
            if three:
                fmu.fmi3GetFloat64(component, given, m, row(out, k), m)
            else:
                fmu.fmi2GetReal(component, given, m, row(out, k))
            if k + 1 == len(inputs):
                return
            at[0] = k * step
            if follow is not None:
                speed, angle = follow.motion(out, k, links, angle, step)
                added[k] = follow.torque_nm(speed, angle, k)
                held[k, column] += per_nm * added[k]
            if three:
                fmu.fmi3SetFloat64(component, taken, n, row(held, k), n)
            else:
                fmu.fmi2SetReal(component, taken, n, row(held, k))
                if self.fmu.interpolates:
                    fmu.fmi2SetRealInputDerivatives(component, taken, n, order, row(slopes, k))
            ended = fmu.doStep(k * step, step)
            if three and ended[1]:  # FMI 2 says so by its status
                raise FmuError(
                    f"{self.fmu.path}: ends the simulation after {k * step + step:.4g} s"
                )


def _step_s(fmu: Described) -> float:
    """What it is asked to go on by: our step, or what it can."""
    if fmu.step_s is not None and not fmu.any_step:
        return fmu.step_s
    if fmu.fixed_s is None:
        return STEP_S
    return fmu.fixed_s * max(1, round(STEP_S / fmu.fixed_s))


def _held(inputs: Floats, step_s: float, interpolates: bool) -> tuple[Floats, Floats]:
    """What is set before each step, and its slope; without slopes the middle of the step.

    A held input is half a step late on average, unless it is the one of the middle.
    """
    slopes = np.zeros_like(inputs)
    slopes[:-1] = np.diff(inputs, axis=0) / step_s
    held = inputs if interpolates else inputs + 0.5 * step_s * slopes
    return np.array(held, order="C"), slopes


def _back(link: Link, value: Floats) -> Floats:
    return (value - link.offset) / link.scale


def physical(series: Signals, name: str, t_ns: npt.NDArray[np.int64], model: Model) -> Floats:
    """A recorded signal at physical instants; zero where it was not recorded."""
    if name not in series or not np.isfinite(series[name].value).any():
        return np.zeros(len(t_ns))
    one, late = series[name], round(model.delays_s.of(name) * 1e9)
    good, origin = np.isfinite(one.value), int(one.t_ns[0])
    return np.asarray(np.interp(t_ns + late - origin, one.t_ns[good] - origin, one.value[good]))


@contextlib.contextmanager
def opened(path: Path, columns: Columns | None = None) -> Iterator[Simulator]:
    """A simulator that is ready to run; its files are removed when the block ends."""
    fmu = read_fmu(path)
    mapped = map_fmu(fmu, columns)
    folder = Path(tempfile.mkdtemp(prefix="eps_hil-fmu-"))
    try:
        from fmpy import extract

        extract(str(path), str(folder))
        yield Simulator(fmu, mapped, folder)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
