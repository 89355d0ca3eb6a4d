"""What Pinocchio makes of a URDF, and what a robot.toml may say."""

import os
import re
import sys
import tempfile
import tomllib
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from residual.errors import (
    InputError,
    RobotError,
    check_keys,
    check_name,
    check_nesting,
    shown,
)
from residual.recording import Array
from residual.robot.urdf import Choice


def build_model(text: str, where: str) -> pin.Model:
    """Build the Pinocchio model of a URDF text.

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


def sliding(model: pin.Model) -> tuple[bool, ...]:
    """Return which joints of a model move along their axis, not about it."""
    kinds = list(model.joints)[1:]
    return tuple("JointModelP" in kind.shortname() for kind in kinds)


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


# What a robot.toml may say: names, units and sizes checked.


Effects = Mapping[str, Collection[str]]

GRAVITY = (0.0, 0.0, -9.81)  # m/s^2
LARGEST = 1e30  # no number of a robot is larger, and a product of several overflows
SLUG = re.compile(r"[a-z0-9_-]{1,40}")
SERIAL = re.compile(r"[A-Za-z0-9._-]{1,40}")
_TEXTS = {
    "name": (SLUG, "1 to 40 of a-z, 0-9, '_' and '-'"),
    "serial": (SERIAL, "a text of 1 to 40 letters, digits, '.', '_' and '-'"),
}
_TABLES = {
    "robot": ("name", "serial", "gravity"),
    "joints": (
        "gear_ratio",
        "torque_per_unit",
        "torque_limit",
        "velocity_limit",
        "acceleration_limit",
    ),
    "couplings": ("motor_from_joint",),
    "prior": ("scale",),
}
_CHOICE = ("chain", "locked")  # read before, since sizes follow from them


@dataclass(frozen=True, eq=False, slots=True)
class DeclaredEffect:
    """An effect that the nominal model has."""

    # Its parameters by key, SI units. Shapes (dof,). Empty where the effect is declared
    # without values.
    values: Mapping[str, Array]
    assumed: bool = False  # whether the values are an assumption, not a measurement
    source: str = ""  # where the values are from


def parse_toml(text: str, where: str) -> dict:
    """Parse the text of a robot.toml."""
    try:
        return check_nesting(tomllib.loads(text), where)
    except (RecursionError, InputError) as error:
        raise RobotError(f"{where} is nested too deep.") from error
    except ValueError as error:  # also a number of more digits than Python reads
        raise RobotError(f"{where} is not valid TOML: {error}.") from error


def read_choice(chain: object, locked: object, where: str) -> Choice:
    """Check what a robot.toml says of its chain and of the joints outside of it.

    Raises:
        RobotError: If a table is none, or a name or value is not usable.
        UnknownNameError: On a key that is not known.
    """
    for name, table in (("chain", chain), ("locked", locked)):
        if not isinstance(table, dict):
            raise RobotError(f"{where}: '{name}' must be a table: [{name}].")
    check_keys(chain, ("joints",), f"[chain] of {where}")
    joints = chain.get("joints", [])
    if not isinstance(joints, list) or not all(isinstance(j, str) for j in joints):
        raise RobotError(
            f"{where}: joints of [chain] is {shown(joints)}, expected a list of names."
        )
    for joint, value in locked.items():
        if not _is_number(value):
            raise RobotError(
                f"{where}: {joint} in [locked] is {shown(value)}, expected a position "
                "in rad or m."
            )
    return Choice(tuple(joints), None, (), dict(locked))


def read_robot_toml(
    content: Mapping, dof: int, where: str, effects: Effects | None = None
) -> dict[str, Any]:
    """Check the content of a robot.toml.

    Args:
        effects: Parameters of each effect that may be declared; None to take any.

    Returns:
        Fields of a `Robot`, and its gravity in the base frame [m/s^2], shape (3,).

    Raises:
        RobotError: On a wrong size or a value out of range.
        UnknownNameError: On a table, key or effect that is not known.
    """
    check_keys(content, (*_TABLES, *_CHOICE, "declared", "known"), where)
    for name, table in content.items():
        if not isinstance(table, dict):
            raise RobotError(f"{where}: '{name}' must be a table: [{name}].")
        if name in _TABLES:
            check_keys(table, _TABLES[name], f"[{name}] of {where}")
    about = content.get("robot", {})
    return {
        **_joints(content.get("joints", {}), dof, where),
        "declared": _all_declared(content.get("declared", {}), dof, where, effects),
        "motor_from_joint": _coupling(content.get("couplings", {}), dof, where),
        "prior_scale": _scale(content.get("prior", {}), where),
        "known_values": _known_values(content.get("known", {}), f"[known] of {where}"),
        "name": _text(about, "name", where),
        "serial": _text(about, "serial", where),
        "gravity": _array(about.get("gravity", GRAVITY), (3,), f"{where}: gravity"),
    }


def _joints(table: dict, dof: int, where: str) -> Mapping[str, Array]:
    arrays = {}
    for key, value in table.items():
        place = f"{where}: {key}"
        array = _array(value, (dof,), place)
        if key.endswith("_limit") and (array <= 0).any():
            raise RobotError(f"{place} must be positive, got {array.min():g}.")
        if (array == 0).any():
            raise RobotError(f"{place} must not be 0 for any joint.")
        arrays[key] = array
    return arrays


def _all_declared(
    tables: dict, dof: int, where: str, effects: Effects | None
) -> Mapping[str, DeclaredEffect]:
    out = {}
    for name, table in tables.items():
        if effects is not None:
            check_name(name, effects, f"effect in {where}")
        place = f"[declared.{name}] of {where}"
        if not isinstance(table, dict):
            raise RobotError(f"{where}: write {name} as a table [declared.{name}].")
        if effects is not None:
            check_keys(table, (*effects[name], "assumed", "source"), place)
        values = dict(table)
        assumed, source = values.pop("assumed", False), values.pop("source", "")
        if not isinstance(assumed, bool) or not isinstance(source, str):
            raise RobotError(f"{place}: assumed must be true or false, source a text.")
        if assumed and not source:
            raise RobotError(f"{place}: assumed values need a source = '...'.")
        arrays = {k: _array(v, (dof,), f"{place}: {k}") for k, v in values.items()}
        out[name] = DeclaredEffect(arrays, assumed, source)
    return out


def _coupling(table: dict, dof: int, where: str) -> Array | None:
    if "motor_from_joint" not in table:
        return None
    matrix = _array(table["motor_from_joint"], (dof, dof), f"{where}: motor_from_joint")
    if np.linalg.matrix_rank(matrix) < dof or (np.diag(matrix) == 0).any():
        raise RobotError(
            f"{where}: motor_from_joint must be invertible with no 0 on its diagonal."
        )
    return matrix


def _scale(table: dict, where: str) -> float | None:
    scale = table.get("scale", "estimate")
    if scale == "estimate":
        return None
    if not (_is_number(scale) and scale > 0):
        raise RobotError(
            f"{where}: prior scale is {shown(scale)}, expected 'estimate' or a "
            "positive number such as 0.03."
        )
    return float(scale)


def _known_values(table: dict, where: str) -> Mapping[str, float]:
    for word, value in table.items():
        if not _is_number(value):
            raise RobotError(
                f"{where}: {word} is {shown(value)}, expected a number, as in "
                f'"payload.mass" = 2.8 (a name with dots stands in quotes).'
            )
    return {word: float(value) for word, value in table.items()}


def _is_number(value: object) -> bool:
    numeric = isinstance(value, int | float) and not isinstance(value, bool)
    return numeric and abs(value) < LARGEST


def _text(table: dict, key: str, where: str) -> str | None:
    """Return a name or serial number, None where there is none."""
    text = table.get(key)
    pattern, expected = _TEXTS[key]
    if text is not None and not (isinstance(text, str) and pattern.fullmatch(text)):
        raise RobotError(f"{where}: {key} is {shown(text)}, expected {expected}.")
    return text


def _array(value: object, shape: tuple[int, ...], name: str) -> Array:
    try:
        array = np.array(value, dtype=float)
    except (TypeError, ValueError, OverflowError):
        array = np.array(np.nan)
    if array.shape != shape:
        size, got = (" x ".join(map(str, s)) for s in (shape, array.shape))
        raise RobotError(f"{name} needs {size} numbers, got {got or 'none'}.")
    if not np.isfinite(array).all():
        raise RobotError(f"{name} has a value that is not a finite number.")
    array.setflags(write=False)
    return array
