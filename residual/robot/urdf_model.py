"""From a checked URDF to a Pinocchio model; what its parser prints is caught."""

import os
import re
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager

import pinocchio as pin

from residual.errors import RobotError


def build_model(text: str, where: str) -> pin.Model:
    """Build the Pinocchio model of a URDF text.

    Args:
        text: The URDF.
        where: File name, as messages begin.

    Returns:
        The model.

    Raises:
        RobotError: If the parser refuses it, with what the parser printed, or drops
            the inertia of a link.
    """
    noise: list[str] = []
    model = None
    try:
        with _captured_stderr(noise):
            model = pin.buildModelFromXML(text)
    except (ValueError, RuntimeError) as error:
        noise.append(f"Error: {error}")
    # The parser goes on with a point mass where it cannot read an inertia.
    if model is None or "nertia" in noise[0]:
        reasons = re.findall(r"Error:\s+(.*)", "\n".join(noise))
        raise RobotError(
            f"{where} is not a usable URDF: {'; '.join(reasons[:2])[:180]}"
        )
    return model


@contextmanager
def _captured_stderr(lines: list[str]) -> Iterator[None]:
    """Collect what C++ writes to file descriptor 2."""
    sys.stderr.flush()
    saved = os.dup(2)
    with tempfile.TemporaryFile() as sink:
        os.dup2(sink.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(saved, 2)
            os.close(saved)
            sink.seek(0)
            lines.append(sink.read().decode(errors="replace"))
