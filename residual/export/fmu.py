"""A model as an FMU (FMI 2.0, both kinds) around the C99 header."""

import hashlib
import io
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from residual.export.c99 import filled, template, to_c99
from residual.export.export import AnyModel, ModelExport, without_tables

SOURCE = "fmu.c"
_BASE_UNITS = {
    "rad": 'rad="1"',
    "rad/s": 'rad="1" s="-1"',
    "rad/s2": 'rad="1" s="-2"',
    "N.m": 'kg="1" m="2" s="-2"',
    "m": 'm="1"',
    "m/s": 'm="1" s="-1"',
    "m/s2": 'm="1" s="-2"',
    "N": 'kg="1" m="1" s="-2"',
}
# Of each signal: its unit on a joint that turns, and on one that slides.
_SIGNALS = {
    "q": ("rad", "m"),
    "qd": ("rad/s", "m/s"),
    "qdd": ("rad/s2", "m/s2"),
    "tau": ("N.m", "N"),
}
_DATE = (2000, 1, 1, 0, 0, 0)  # the same model makes the same bytes

Sources = Mapping[str, bytes]


def to_fmu(source: AnyModel, build: Callable[[Sources], bytes | None]) -> ModelExport:
    """Return a model as an FMU.

    Args:
        build: Compiles C files (text by name) into a library for this platform (64-bit
            Linux); None leaves that to whoever imports the FMU.
    """
    made = to_c99(source)
    ((file, text),) = made.files.items()
    name, robot = file.removesuffix(".h"), without_tables(source).robot
    guid = f"{{{hashlib.sha256(text).hexdigest()[:32]}}}"
    words = {"P": name, "DOF": str(robot.dof), "GUID": guid}
    sources = {file: text, SOURCE: filled(template(SOURCE), words).encode()}
    content = {"modelDescription.xml": _description(name, guid, robot.prismatic)}
    content |= {f"sources/{name}": text for name, text in sources.items()}
    if library := build(sources):
        content[f"binaries/linux64/{name}.so"] = library
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for path, data in content.items():
            archive.writestr(zipfile.ZipInfo(path, _DATE), data, zipfile.ZIP_DEFLATED)
    return replace(made, files={f"{name}.fmu": buffer.getvalue()})


def _description(name: str, guid: str, slides: Sequence[bool]) -> bytes:
    """The text of modelDescription.xml; the name is one of C."""
    variables = []
    for signal, units in _SIGNALS.items():
        output = signal == "tau"
        cause = "output" if output else "input"
        start = "" if output else ' start="0"'
        for j, slide in enumerate(slides, start=1):
            variables.append(
                f'  <ScalarVariable name="{signal}{j}"'
                f' valueReference="{len(variables)}" causality="{cause}"'
                f' variability="continuous"><Real unit="{units[slide]}"{start}/>'
                "</ScalarVariable>"
            )
    first = len(variables) - len(slides) + 1
    outputs = [f'  <Unknown index="{i}"/>' for i in range(first, len(variables) + 1)]
    kind = f' modelIdentifier="{name}"'
    files = f'<SourceFiles><File name="{SOURCE}"/></SourceFiles>'
    steps = ' canHandleVariableCommunicationStepSize="true" canInterpolateInputs="true"'
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        f'<fmiModelDescription fmiVersion="2.0" modelName="{name}" guid="{guid}"',
        '  generationTool="modelgap" variableNamingConvention="flat"',
        '  numberOfEventIndicators="0">',
        f"<ModelExchange{kind}>{files}</ModelExchange>",
        f"<CoSimulation{kind}{steps}>{files}</CoSimulation>",
        "<UnitDefinitions>",
        *(
            f'  <Unit name="{unit}"><BaseUnit {base}/></Unit>'
            for unit, base in _BASE_UNITS.items()
        ),
        "</UnitDefinitions>",
        *("<ModelVariables>", *variables, "</ModelVariables>"),
        *("<ModelStructure>", "<Outputs>", *outputs, "</Outputs>"),
        *("<InitialUnknowns>", *outputs, "</InitialUnknowns>", "</ModelStructure>"),
        "</fmiModelDescription>\n",
    ]
    return "\n".join(lines).encode()
