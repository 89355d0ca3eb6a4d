"""The numbers of a program, and the texts that go around them."""

from collections.abc import Mapping
from importlib import resources

import numpy as np

from residual.export.program import Program
from residual.recording import Array


def arrays_of(program: Program) -> dict[str, Array]:
    """Return the numbers by name.

    The rotation of a joint is R(q) = still + cos(q) along + sin(q) across.
    """
    chain = program.chain
    onto = np.einsum("ij,ik->ijk", chain.axis, chain.axis)
    skew = np.cross(np.eye(3)[None], chain.axis[:, None, :])
    arrays: dict[str, Array | None] = {
        "place": chain.place,
        "axis": chain.axis,
        "still": chain.rotation @ onto,
        "along": chain.rotation @ (np.eye(3) - onto),
        "across": chain.rotation @ skew,
        "flange": chain.flange,
        "gravity": program.gravity,
        "rigid": program.rigid,
        "added": program.added,
        "tilt": program.tilt,
        "force": program.force,
    }
    if program.shifts or program.tilt is not None:
        arrays["loaded"] = program.loaded
    if program.shifts:
        arrays["drive"] = program.drive
    return {name: values for name, values in arrays.items() if values is not None}


def filled(text: str, words: Mapping[str, str]) -> str:
    """Return a text with @NAME@ replaced by what it stands for."""
    for name, word in words.items():
        text = text.replace(f"@{name}@", word)
    return text


def template(name: str) -> str:
    """Return a text of the folder `templates`."""
    folder = resources.files("residual") / "export" / "templates"
    return folder.joinpath(name).read_text(encoding="utf-8")
