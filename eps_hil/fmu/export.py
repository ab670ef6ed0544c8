"""A model file as a Functional Mock-up Unit that runs without Python."""

import re
import zipfile
from dataclasses import dataclass
from pathlib import Path

from eps_hil.errors import InputError
from eps_hil.fmu import build
from eps_hil.fmu.description import build_description, description, guid_of
from eps_hil.fmu.source import sources
from eps_hil.fmu.variables import Variable, variables_of
from eps_hil.physics.model import Model, dump_model
from eps_hil.recordings.files import replacing


@dataclass(frozen=True, slots=True)
class Exported:
    """What was written: the FMU's name for itself, its variables, the platforms it runs on."""

    name: str
    variables: tuple[Variable, ...]
    platforms: tuple[str, ...]
    notes: tuple[str, ...]


def export_fmu(model: Model, path: Path, source: object = "the model", fmi: int = 2) -> Exported:
    """Write ``model``, its effects included, as co-simulation with C sources and binaries.

    ``fmi``: the version of FMI, 2 or 3.
    ``source`` is what an error calls the model. :class:`InputError` where no C compiler is found,
    or an effect cannot be carried.
    """
    if path.suffix.lower() != ".fmu":
        raise InputError(path, "", "an FMU's name ends in .fmu", "give --fmu a name like model.fmu")
    if fmi not in (2, 3):
        raise InputError("--fmi-version", "", f"is {fmi}, 2 or 3 was expected")
    build.check()
    main = f"fmi{fmi}.c"
    name = _identifier(path.stem)
    try:
        variables = variables_of(model)
        texts = sources(model, source, variables, main)
    except ValueError as error:
        raise InputError(source, "effects", str(error)) from None
    guid = guid_of(name, texts)
    # a source FMU is compiled by others: what they need to know stands in it
    texts[main] = f'#ifndef GUID\n#define GUID "{guid}"\n#endif\n' + texts[main]
    if fmi == 3:
        texts["buildDescription.xml"] = build_description(name)
    about = "EPS drive (rotor with load-dependent LuGre friction), made by eps-hil export"
    described = description(name, guid, about, variables, fmi)
    compiled = build.binaries(name, guid, texts, fmi)
    with replacing(path) as temporary, zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED) as out:
        _put(out, "modelDescription.xml", described.encode())
        for file, text in texts.items():
            _put(out, f"sources/{file}", text.encode())
        for place, library in compiled.items():
            _put(out, place, library)
        _put(out, "resources/model.yaml", dump_model(model).encode())
    platforms = tuple(place.split("/")[1] for place in compiled)
    return Exported(name, tuple(variables), platforms, _notes(model))


def _notes(model: Model) -> tuple[str, ...]:
    late = {name: s for name in ("motor_speed", "motor_torque", "torque_sensor", "rack_force")
            if (s := getattr(model.delays_s, name)) > 0.0}  # fmt: skip
    if not late:
        return ()
    each = ", ".join(f"{name} {1e3 * s:.3g} ms" for name, s in late.items())
    return (f"the FMU is physical: the sensors' delays ({each}) are not in it",)


def _put(out: zipfile.ZipFile, name: str, content: bytes) -> None:
    """With a date that is always the same: the same model gives the same file."""
    entry = zipfile.ZipInfo(name, (2020, 1, 1, 0, 0, 0))
    entry.compress_type = zipfile.ZIP_DEFLATED
    entry.external_attr = 0o644 << 16
    out.writestr(entry, content)


def _identifier(stem: str) -> str:
    name = re.sub(r"\W", "_", stem, flags=re.ASCII)
    return name if name[:1].isalpha() else f"m_{name}"
