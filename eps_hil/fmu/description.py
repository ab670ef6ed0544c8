"""modelDescription.xml of the model's FMU (FMI 2.0 or 3.0)."""

import hashlib
import math
from collections.abc import Mapping, Sequence
from xml.etree import ElementTree as Xml

from eps_hil.fmu.variables import RATES, UNITS, Variable
from eps_hil.version import VERSION


def guid_of(name: str, texts: Mapping[str, str]) -> str:
    """The same for the same model and sources, another one for every other."""
    digest = hashlib.sha256("\0".join([name, *texts.values()]).encode()).hexdigest()
    return (
        "{"
        + "-".join((digest[:8], digest[8:12], digest[12:16], digest[16:20], digest[20:32]))
        + "}"
    )


def description(name: str, guid: str, about: str, variables: Sequence[Variable], fmi: int) -> str:
    """The XML for a model that is called ``name`` (an identifier in C)."""
    three = fmi == 3
    state = "State" if three else "state"
    root = Xml.Element(
        "fmiModelDescription",
        {
            "fmiVersion": f"{fmi}.0",
            "modelName": name,
            "instantiationToken" if three else "guid": guid,
            "description": about,
            "generationTool": f"eps_hil {VERSION}",
            "variableNamingConvention": "flat",
        },
    )
    simulation = Xml.SubElement(
        root,
        "CoSimulation",
        {
            "modelIdentifier": name,
            "canHandleVariableCommunicationStepSize": "true",
            f"canGetAndSetFMU{state}": "true",
            f"canSerializeFMU{state}": "true",
        },
    )
    if not three:
        root.set("numberOfEventIndicators", "0")
        simulation.set("canInterpolateInputs", "true")
        Xml.SubElement(Xml.SubElement(simulation, "SourceFiles"), "File", name="fmi2.c")
    units = Xml.SubElement(root, "UnitDefinitions")
    for unit in dict.fromkeys([*(one.unit for one in variables), *(["s"] if three else [])]):
        label, powers = UNITS[unit]
        Xml.SubElement(
            Xml.SubElement(units, "Unit", name=label),
            "BaseUnit",
            {base: str(power) for base, power in powers.items()},
        )
    categories = Xml.SubElement(root, "LogCategories")
    Xml.SubElement(categories, "Category", name="logStatusError")
    Xml.SubElement(root, "DefaultExperiment", startTime="0", stopTime="10", stepSize="0.001")
    (_variables_3 if three else _variables_2)(root, variables)
    Xml.indent(root)
    return _text(root)


def build_description(name: str) -> str:
    """sources/buildDescription.xml of FMI 3: how to compile the sources."""
    root = Xml.Element("fmiBuildDescription", fmiVersion="3.0")
    how = Xml.SubElement(root, "BuildConfiguration", modelIdentifier=name)
    files = Xml.SubElement(how, "SourceFileSet", language="C99")
    Xml.SubElement(files, "SourceFile", name="fmi3.c")
    Xml.SubElement(how, "Library", name="m", external="true")
    Xml.indent(root)
    return _text(root)


def _text(root: Xml.Element) -> str:
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{Xml.tostring(root, encoding="unicode")}\n'


def _variables_2(root: Xml.Element, variables: Sequence[Variable]) -> None:
    listed = Xml.SubElement(root, "ModelVariables")
    for k, one in enumerate(variables):
        Xml.SubElement(Xml.SubElement(listed, "ScalarVariable", _said(k, one)), "Real", _real(one))
    structure = Xml.SubElement(root, "ModelStructure")
    for group in ("Outputs", "InitialUnknowns"):
        unknown = Xml.SubElement(structure, group)
        for k in _outputs(variables):
            Xml.SubElement(unknown, "Unknown", index=str(k + 1))


def _variables_3(root: Xml.Element, variables: Sequence[Variable]) -> None:
    listed = Xml.SubElement(root, "ModelVariables")
    for k, one in enumerate(variables):
        Xml.SubElement(listed, "Float64", {**_said(k, one), **_real(one)})
    time = {"name": "time", "valueReference": str(len(variables)), "causality": "independent",
            "variability": "continuous", "unit": "s", "description": "Time"}  # fmt: skip
    Xml.SubElement(listed, "Float64", time)
    structure = Xml.SubElement(root, "ModelStructure")
    for group in ("Output", "InitialUnknown"):
        for k in _outputs(variables):
            Xml.SubElement(structure, group, valueReference=str(k))


def _outputs(variables: Sequence[Variable]) -> list[int]:
    return [k for k, one in enumerate(variables) if one.causality == "output"]


def _said(k: int, one: Variable) -> dict[str, str]:
    said = {"name": one.name, "valueReference": str(k), "description": one.meaning}
    said["causality"] = one.causality
    if one.causality == "parameter":
        said["variability"] = "tunable" if one.tunable else "fixed"
    else:
        said["variability"] = "discrete" if one in RATES else "continuous"
    if one.causality == "output":
        said["initial"] = "calculated"
    return said


def _real(one: Variable) -> dict[str, str]:
    real = {"unit": UNITS[one.unit][0]}
    if math.isfinite(one.lower):
        real["min"] = repr(one.lower)
    if math.isfinite(one.upper):
        real["max"] = repr(one.upper)
    if one.start is not None:
        real["start"] = repr(one.start)
    return real
