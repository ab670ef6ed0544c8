"""modelDescription.xml of the model's FMU (FMI 2.0)."""

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


def description(name: str, guid: str, about: str, variables: Sequence[Variable]) -> str:
    """The XML for a model that is called ``name`` (an identifier in C)."""
    root = Xml.Element(
        "fmiModelDescription",
        fmiVersion="2.0",
        modelName=name,
        guid=guid,
        description=about,
        generationTool=f"eps_hil {VERSION}",
        variableNamingConvention="flat",
        numberOfEventIndicators="0",
    )
    simulation = Xml.SubElement(
        root,
        "CoSimulation",
        modelIdentifier=name,
        canHandleVariableCommunicationStepSize="true",
        canInterpolateInputs="true",
        canGetAndSetFMUstate="true",
        canSerializeFMUstate="true",
    )
    Xml.SubElement(Xml.SubElement(simulation, "SourceFiles"), "File", name="fmi2.c")
    units = Xml.SubElement(root, "UnitDefinitions")
    for unit in dict.fromkeys(one.unit for one in variables):
        label, powers = UNITS[unit]
        Xml.SubElement(
            Xml.SubElement(units, "Unit", name=label),
            "BaseUnit",
            {base: str(power) for base, power in powers.items()},
        )
    categories = Xml.SubElement(root, "LogCategories")
    Xml.SubElement(categories, "Category", name="logStatusError")
    Xml.SubElement(root, "DefaultExperiment", startTime="0", stopTime="10", stepSize="0.001")
    listed = Xml.SubElement(root, "ModelVariables")
    for k, one in enumerate(variables):
        _variable(listed, k, one)
    structure = Xml.SubElement(root, "ModelStructure")
    outputs = [k + 1 for k, one in enumerate(variables) if one.causality == "output"]
    for group in ("Outputs", "InitialUnknowns"):
        unknown = Xml.SubElement(structure, group)
        for index in outputs:
            Xml.SubElement(unknown, "Unknown", index=str(index))
    Xml.indent(root)
    text = Xml.tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'


def _variable(parent: Xml.Element, k: int, one: Variable) -> None:
    said = {"name": one.name, "valueReference": str(k), "description": one.meaning}
    said["causality"] = one.causality
    if one.causality == "parameter":
        said["variability"] = "tunable" if one.tunable else "fixed"
    else:
        said["variability"] = "discrete" if one in RATES else "continuous"
    if one.causality == "output":
        said["initial"] = "calculated"
    real = {"unit": UNITS[one.unit][0]}
    if math.isfinite(one.lower):
        real["min"] = repr(one.lower)
    if math.isfinite(one.upper):
        real["max"] = repr(one.upper)
    if one.start is not None:
        real["start"] = repr(one.start)
    Xml.SubElement(Xml.SubElement(parent, "ScalarVariable", said), "Real", real)
