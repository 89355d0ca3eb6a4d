"""The arms of an export: the built-in one, and some drawn for this study alone."""

import json
from collections.abc import Mapping
from pathlib import Path

from flows.specs.experiment import derived_seed
from residual.robot.robot import Robot
from sim.drawn_arm import light_arm

URDF, DECLARED, TOML = "{}.urdf", "declared.json", "robot.toml"


def drawn_arm(folder: Path, seed: int, number: int) -> Path:
    """Write the description of an arm that no other study has.

    Args:
        folder: Where; a folder of its own is made there.
    """
    robot = light_arm(derived_seed(seed, f"arm/{number}"))
    name = f"drawn_{robot.content_hash[:8]}"
    place = folder / name
    place.mkdir(parents=True, exist_ok=True)
    (place / URDF.format(name)).write_text(robot.urdf, encoding="utf-8")
    content = {"robot": {"name": name}, **json.loads(robot.toml)}
    (place / TOML).write_text(_toml(content), encoding="utf-8")
    return place


def describe(robot: Robot, folder: Path) -> None:
    """Write what anybody may know of an arm: its URDF, and what is declared of it.

    Args:
        folder: Where; a folder of its name is made there.
    """
    place = folder / robot.name
    place.mkdir(parents=True, exist_ok=True)
    (place / URDF.format(robot.name)).write_text(robot.urdf, encoding="utf-8")
    content = json.loads(robot.toml)
    own = content.setdefault("robot", {})
    own["name"] = robot.name
    own["gravity"] = [float(x) for x in robot.model.gravity.linear]
    text = json.dumps(content, indent=1, sort_keys=True)
    (place / DECLARED).write_text(text + "\n", encoding="utf-8")


def _toml(content: Mapping, name: str = "") -> str:
    """Return tables of numbers, texts and lists as TOML."""
    lines = [f"[{name}]"] if name else []
    lines += [
        f"{key} = {json.dumps(value)}"
        for key, value in content.items()
        if not isinstance(value, Mapping)
    ]
    tables = [
        _toml(value, f"{name}.{key}" if name else key)
        for key, value in content.items()
        if isinstance(value, Mapping)
    ]
    return "\n".join([*lines, *tables]) + "\n"
