"""The C source of a model: its kernels translated, and only those effects that it has."""

from collections.abc import Sequence
from importlib.resources import files
from typing import Any

from eps_hil.errors import InputError
from eps_hil.fmu.to_c import PRELUDE, Given, NotCarriedError, Translation
from eps_hil.fmu.variables import INPUTS, OUTPUTS, Variable
from eps_hil.physics import simulate, two_masses
from eps_hil.physics.effects import added
from eps_hil.physics.effects.added import WALK, terms
from eps_hil.physics.effects.catalogue import joint_of, with_model_effects
from eps_hil.physics.effects.effect import STATES, WIDTH, Instant, Joint
from eps_hil.physics.model import Model

_SLOTS = {
    "level": added.level_nm,
    "torque": added.torque_nm,
    "motor": added.motor_nm,
    "sensor": added.sensor_nm,
    "position": added.position_m,
    "load": added.load_nm,
}


def sources(model: Model, name: object, variables: Sequence[Variable], main: str) -> dict[str, str]:
    """C files by name, ``main`` (fmi2.c or fmi3.c) the one to compile.

    ``InputError`` (of file ``name``) names an effect that C cannot carry.
    """
    generated = _generated(with_model_effects(model), name, variables)
    folder = files("eps_hil.fmu") / "templates"
    return {"model.h": generated} | {
        file: (folder / file).read_text(encoding="utf-8") for file in ("core.h", "instance.h", main)
    }


def _generated(model: Model, name: object, variables: Sequence[Variable]) -> str:
    given: dict[Any, Given] = {
        function: Given(f"added_{slot}") for slot, function in _SLOTS.items()
    }
    given[added.advance] = Given("added_advance", "void")
    c = Translation(given, {added.Added: "Added"})
    acting = terms(model)
    slots: dict[str, list[str]] = {slot: [] for slot in WALK}
    for slot, walk in WALK.items():
        for row, kernel in walk:
            for k, (effect, _, own, _, _) in enumerate(acting):
                if own != row:
                    continue
                try:
                    called = c.function(kernel).name
                except NotCarriedError as error:
                    raise InputError(name, f"effect '{effect.id}'",
                                     f"an FMU cannot carry it: {error}") from None  # fmt: skip
                at = f"a.parameters + {k} * WIDTH, a.state + {k} * STATES, u"
                slots[slot].append(
                    f"    {called}({at}, dt);\n" if slot == "memory"
                    else f"    value = {called}({at}, value);\n"
                )  # fmt: skip
    kernels = len(c.functions)
    instant = c.c_type(Instant)
    for one in (simulate.instant, simulate.level_nm, simulate.friction_nm):
        c.function(one)
    drive, joint = c.c_type(simulate.Drive), c.c_type(Joint)
    joined = joint_of(model)
    inner: Any = simulate.interval if joined is None else two_masses.interval
    interval = c.function(inner).name
    if joined is not None:
        c.function(two_masses.rest_twist)
    slot_functions = "".join(
        f"static double added_{slot}(Added a, {instant} u, double value)\n"
        f"{{\n{''.join(slots[slot])}    (void)a; (void)u;\n    return value;\n}}\n\n"
        for slot in _SLOTS
    ) + (
        f"static void added_advance(Added a, {instant} u, double dt)\n"
        f"{{\n{''.join(slots['memory'])}    (void)a; (void)u; (void)dt;\n}}\n"
    )
    return "\n".join(
        [
            "/* Made by eps-hil export from the kernels of eps_hil; the numbers are below. */",
            "#include <math.h>\n#include <stdlib.h>\n",
            _sizes(model, variables, interval, len(acting), joined is not None),
            PRELUDE,
            "typedef struct { double *parameters; double *state; } Added;\n",
            *c.types,
            *c.functions[:kernels],
            slot_functions,
            *c.functions[kernels:],
            _set_up(model, variables, slots, drive, joint),
        ]
    )


def _sizes(
    model: Model, variables: Sequence[Variable], interval: str, acting: int, joined: bool
) -> str:
    late = max(-model.delays_s.motor_torque, 0.0)
    return (
        f"#define WIDTH {WIDTH}\n#define STATES {STATES}\n#define TERMS {max(acting, 1)}\n"
        f"#define INPUTS {len(INPUTS)}\n#define OUTPUTS {len(OUTPUTS)}\n"
        f"#define VARIABLES {len(variables)}\n#define JOINED {int(joined)}\n"
        f"#define INTERVAL {interval}\n"
        f"#define LATE_S {late!r} /* shaft torque behind the reported one */\n"
        f"#define HISTORY {16384 if late > 0.0 else 1}\n"
    )


def _set_up(
    model: Model,
    variables: Sequence[Variable],
    slots: dict[str, list[str]],
    drive: str,
    joint: str,
) -> str:
    """Tables of the variables, and the function that puts the parameters where the model looks."""
    texts = ", ".join(f'"{one.name}"' for one in variables)
    numbers = [
        (f"static const double {table}[VARIABLES] = {{",
         ", ".join(_c(getattr(one, field)) for one in variables), "};\n")
        for table, field in (("STARTS", "start"), ("LOWEST", "lower"), ("HIGHEST", "upper"))
    ]  # fmt: skip
    index = {one.name: k for k, one in enumerate(variables)}
    packed = [
        f"    parameters[{k} * WIDTH + {i}] = {_c(number)};\n"
        for k, one in enumerate(terms(model))
        for i, number in enumerate(one[-1])
    ]
    tuned = [f"    {one.place} = r[{k}];\n" for k, one in enumerate(variables) if one.place]
    pinion, rack = index["pinion_ratio_rad_per_m"], index["rack_to_rotor_ratio_rad_per_m"]
    used = [
        f"    drive->use.{slot} = {int(bool(slots.get(slot)))};\n" for slot in added.InUse._fields
    ]
    return (
        f"static const char *const NAMES[VARIABLES] = {{{texts}}};\n"
        + "".join("".join(one) for one in numbers)
        + f"#define TUNABLE {next(k for k, one in enumerate(variables) if one.tunable)}\n\n"
        + f"static void set_up(const double *r, {drive} *drive, {joint} *joint, "
        + "double *parameters, double *state)\n{\n"
        + "".join([*packed, *tuned, *used])
        + f"    drive->sensor_to_rotor = r[{pinion}] / r[{rack}];\n"
        + "    drive->effects.parameters = parameters;\n    drive->effects.state = state;\n"
        + "    (void)joint;\n}\n"
    )


def _c(value: float | None) -> str:
    if value is None:
        return "0.0"
    return {float("inf"): "HUGE_VAL", float("-inf"): "-HUGE_VAL"}.get(value, repr(float(value)))
