"""A new project: its modelgap.toml with every option, and its inbox."""

import os
import re
import shutil
import socket
from dataclasses import dataclass
from pathlib import Path

from flows.inputs.robots import load
from flows.project.read import Project, read_project
from flows.settings import PROJECT
from residual.errors import InputError
from residual.robot.robot import built_in_robots

_TEMPLATE = Path(__file__).with_name("template.toml")
_FIRST_PORT, _PORTS = 4200, 100
INBOX = "inbox"


@dataclass(frozen=True, slots=True)
class Start:
    """What a new project begins with.

    Attributes:
        folder: Where it is made.
        robot: URDF file, folder or built-in name of its first robot; None for the
            built-in IRB140.
        simulated: Whether that one is simulated.
    """

    folder: str | Path = "."
    robot: str | None = None
    simulated: bool = False


def start(wanted: Start) -> Project:
    """Make a project.

    Args:
        wanted: What it begins with. A robot's files that lie elsewhere are copied into
            its folder.

    Raises:
        InputError: If there is one already, or the robot is not usable.
    """
    folder = Path(wanted.folder).resolve()
    file = folder / PROJECT
    if file.exists():
        raise InputError(
            f"{file} is there already, and is left as it is. Edit it, or give another "
            "folder: modelgap init DIR."
        )
    word = wanted.robot or "irb140"
    name = load(word).name
    folder.mkdir(parents=True, exist_ok=True)
    urdf = _beside(folder, word, name)
    text = _filled(name, urdf, wanted.simulated or wanted.robot is None)
    new = folder / f".{PROJECT}.{os.getpid()}"
    new.write_text(text, encoding="utf-8")
    os.replace(new, file)
    project = read_project(folder)
    for inbox in project.table.inbox:
        project.path(inbox.folder).mkdir(parents=True, exist_ok=True)
    return project


def _beside(folder: Path, word: str, name: str) -> str:
    """Return what the file shall say of a robot, its description in the folder."""
    if word in built_in_robots():
        return word
    path = Path(word).resolve()
    if path.is_relative_to(folder):
        return path.relative_to(folder).as_posix() if path != folder else "."
    if path.is_file():
        shutil.copyfile(path, folder / path.name)
        return path.name
    kept = folder / name
    kept.mkdir(exist_ok=True)
    for file in (*path.glob("*.urdf"), path / "robot.toml"):
        if file.is_file():
            shutil.copyfile(file, kept / file.name)
    return name


def _filled(name: str, urdf: str, simulated: bool) -> str:
    text = _TEMPLATE.read_text(encoding="utf-8")
    values = {
        "PORT": str(_free_port()),
        "NAME": name,
        "URDF": urdf,
        "FOLDER": INBOX,
        "SIMULATED": "" if simulated else "# ",
        "YES": "true" if simulated else "false",
        "INBOX": "# " if simulated else "",
    }
    return re.sub(r"@([A-Z]+)@", lambda found: values[found[1]], text)


def _free_port() -> int:
    """Return a port that nobody has now: each project has its own."""
    for port in range(_FIRST_PORT, _FIRST_PORT + _PORTS):
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind(("127.0.0.1", port))
            except OSError:
                continue
            return port
    return _FIRST_PORT
