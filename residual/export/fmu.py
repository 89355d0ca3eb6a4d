"""A model as an FMU, alone as the one format that is packed and compiled.

FMI 2.0, both kinds, the C99 header inside.
"""

import hashlib
import io
import xml.etree.ElementTree as ET
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from residual.export.c99 import to_c99
from residual.export.exported import Exported, Whole, body_of
from residual.export.program import filled, template

PLATFORM = "linux64"
SOURCE = "fmu.c"
_UNITS = {
    "rad": {"rad": "1"},
    "rad/s": {"rad": "1", "s": "-1"},
    "rad/s2": {"rad": "1", "s": "-2"},
    "N.m": {"kg": "1", "m": "2", "s": "-2"},
    "m": {"m": "1"},
    "m/s": {"m": "1", "s": "-1"},
    "m/s2": {"m": "1", "s": "-2"},
    "N": {"kg": "1", "m": "1", "s": "-2"},
}
_SIGNALS = {"q": "rad", "qd": "rad/s", "qdd": "rad/s2", "tau": "N.m"}
_SLIDING = {"rad": "m", "rad/s": "m/s", "rad/s2": "m/s2", "N.m": "N"}
_DATE = (2000, 1, 1, 0, 0, 0)  # the same model makes the same bytes


@dataclass(frozen=True, eq=False, slots=True)
class Parts:
    """What an FMU is made of.

    Attributes:
        name: Its name: that of the header and of the library.
        header: The C99 export that is inside.
        sources: Text of the C files by name.
        description: modelDescription.xml.
    """

    name: str
    header: Exported
    sources: Mapping[str, bytes]
    description: bytes


def fmu_parts(whole: Whole) -> Parts:
    """Return what is to be compiled and packed."""
    header = to_c99(whole)
    ((file, text),) = header.files.items()
    name, dof = file.removesuffix(".h"), body_of(whole).robot.dof
    guid = f"{{{hashlib.sha256(text).hexdigest()[:32]}}}"
    words = {"P": name, "DOF": str(dof), "GUID": guid}
    source = filled(template(SOURCE), words).encode()
    description = _description(name, guid, body_of(whole).robot.prismatic)
    return Parts(name, header, {file: text, SOURCE: source}, description)


def to_fmu(parts: Parts, library: bytes | None) -> Exported:
    """Return the FMU.

    Args:
        library: The sources compiled for this platform; None to leave that to whoever
            imports it.
    """
    content = {"modelDescription.xml": parts.description}
    content |= {f"sources/{name}": text for name, text in parts.sources.items()}
    if library is not None:
        content[f"binaries/{PLATFORM}/{parts.name}.so"] = library
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as packed:
        for name, data in content.items():
            packed.writestr(zipfile.ZipInfo(name, _DATE), data, zipfile.ZIP_DEFLATED)
    return replace(parts.header, files={f"{parts.name}.fmu": buffer.getvalue()})


def _description(name: str, guid: str, slides: Sequence[bool]) -> bytes:
    about = {
        "fmiVersion": "2.0",
        "modelName": name,
        "guid": guid,
        "generationTool": "modelgap",
        "variableNamingConvention": "flat",
        "numberOfEventIndicators": "0",
    }
    root = ET.Element("fmiModelDescription", about)
    variable_steps = {"canHandleVariableCommunicationStepSize": "true"}
    rates = {"canInterpolateInputs": "true"}
    for what, can in (("ModelExchange", {}), ("CoSimulation", variable_steps | rates)):
        kind = ET.SubElement(root, what, {"modelIdentifier": name, **can})
        ET.SubElement(ET.SubElement(kind, "SourceFiles"), "File", {"name": SOURCE})
    units = ET.SubElement(root, "UnitDefinitions")
    for unit, powers in _UNITS.items():
        ET.SubElement(ET.SubElement(units, "Unit", {"name": unit}), "BaseUnit", powers)
    variables = ET.SubElement(root, "ModelVariables")
    outputs = []
    for signal, unit in _SIGNALS.items():
        out = signal == "tau"
        for j, slide in enumerate(slides):
            number = len(variables)
            own = {
                "name": f"{signal}{j + 1}",
                "valueReference": str(number),
                "causality": "output" if out else "input",
                "variability": "continuous",
            }
            variable = ET.SubElement(variables, "ScalarVariable", own)
            start = {} if out else {"start": "0"}
            own_unit = _SLIDING[unit] if slide else unit
            ET.SubElement(variable, "Real", {"unit": own_unit, **start})
            outputs += [str(number + 1)] if out else []
    structure = ET.SubElement(root, "ModelStructure")
    for part in ("Outputs", "InitialUnknowns"):
        listed = ET.SubElement(structure, part)
        for index in outputs:
            ET.SubElement(listed, "Unknown", {"index": index})
    ET.indent(root)
    return ET.tostring(root, encoding="UTF-8", xml_declaration=True)
