"""An identified model as the files of a robot: URDF, and robot.toml beside it."""

import json
from collections.abc import Mapping

import numpy as np

from residual.errors import InputError
from residual.model.model import Model
from residual.robot.robot import with_inertials

_HEAD = """\
# Identified parameters of {name}, written by modelgap.
# Give this folder as --robot; inertias are in the URDF beside this file.
"""


def robot_files(model: Model, source: str = "") -> dict[str, bytes]:
    """Return a model as the files of a robot folder.

    Returns:
        Content by file name: one *.urdf and robot.toml; together they reload to a
        model of the same torque.

    Raises:
        InputError: If a link's mass is not positive, or an effect's values do not fit
            into a robot.toml.
    """
    name = model.robot.name
    urdf = with_inertials(model.robot, model.inertial)
    return {f"{name}.urdf": urdf.encode(), "robot.toml": robot_toml(model, source)}


def robot_toml(model: Model, source: str) -> bytes:
    """Return the robot.toml of a model: the robot's own, its declared values new."""
    content = json.loads(model.robot.toml)
    tables = {k: dict(v) for k, v in content.items() if k != "declared"}
    tables.setdefault("robot", {})["name"] = model.robot.name
    tables["robot"]["gravity"] = [float(g) for g in model.robot.model.gravity.linear]
    for effect, values in declared_values(model).items():
        entry: dict = {key: [float(v) for v in array] for key, array in values.items()}
        if source:
            entry["source"] = source
        tables[f"declared.{effect}"] = entry
    lines = [_HEAD.format(name=model.robot.name)]
    for title, table in tables.items():
        lines.append(f"[{title}]")
        lines += [f"{key} = {_value(value)}" for key, value in table.items()]
        lines.append("")
    return "\n".join(lines).encode()


def declared_values(model: Model) -> Mapping[str, Mapping[str, np.ndarray]]:
    """Return the values of the model's effects by name and parameter key. (dof,) each.

    Raises:
        InputError: If an effect stands in the model twice on one joint.
    """
    out: dict[str, dict[str, np.ndarray]] = {}
    seen = set()
    for term in model.terms:
        name, anchor = term.effect.name, term.joints[0] if term.joints else 0
        if (name, anchor) in seen:
            raise InputError(
                f"{name} on joint {anchor + 1} was fitted in several shapes at once, "
                "and a robot.toml holds one. Give its values in robot.toml, or leave "
                "it out of --declared."
            )
        seen.add((name, anchor))
        values = term.effect.values(term.theta, term.shape, model.robot)
        table = out.setdefault(name, {})
        for key, value in zip(term.effect.parameters, values, strict=True):
            table.setdefault(key, np.zeros(model.robot.dof))[anchor] = value
    return out


def _value(value: object) -> str:
    """One value as TOML; JSON writes these kinds the same way."""
    if isinstance(value, list):
        return f"[{', '.join(_value(v) for v in value)}]"
    if isinstance(value, bool | str):
        return json.dumps(value, ensure_ascii=False)
    return repr(value)
