"""A modelgap.toml from its folder, checked; what it names stands beside it."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from flows.inputs.robots import load
from flows.project.file import InboxTable, NotifyTable, ProjectTable, RobotTable
from flows.settings import PROJECT, ROOT, store_folder
from residual.errors import InputError
from residual.robot.robot import Robot, built_in_robots, with_serial
from warehouse.logs import ColumnMap, load_columns
from warehouse.objects.address import is_address
from warehouse.toml import faults, read_toml


@dataclass(frozen=True, slots=True)
class Project:
    """A project.

    Attributes:
        folder: Its folder, absolute.
        table: What its file says.
    """

    folder: Path
    table: ProjectTable

    @property
    def store(self) -> Path:
        """The folder of the store; of one in a bucket that of this machine."""
        word = self.table.store
        return store_folder(word) if is_address(word) else self.path(word)

    @property
    def notify(self) -> NotifyTable:
        """Who is told of what happens."""
        return self.table.notify

    def path(self, name: str) -> Path:
        """Return what the file means by a path: one from its own folder."""
        return (self.folder / name).resolve()

    def robot(self, name: str) -> RobotTable:
        """Return a robot by its name.

        Raises:
            InputError: If there is none of that name.
        """
        for robot in self.table.robot:
            if robot.name == name:
                return robot
        listed = ", ".join(robot.name for robot in self.table.robot) or "none"
        raise InputError(f"{PROJECT} has no robot '{name}', it has: {listed}.")

    def word(self, robot: RobotTable) -> str:
        """Return what --robot takes for a robot."""
        known = robot.urdf in built_in_robots()
        return robot.urdf if known else str(self.path(robot.urdf))

    def arm(self, robot: RobotTable) -> Robot:
        """Load a robot, with its serial number.

        Raises:
            InputError: If its description is not usable; the message has its name.
        """
        try:
            return with_serial(load(self.word(robot)), robot.serial or None)
        except InputError as error:
            raise InputError(f"{PROJECT}: robot '{robot.name}': {error}") from error

    def campaign(self, robot: RobotTable) -> Path:
        """Return the campaign of a simulated robot: its own, else one of the examples.

        Raises:
            InputError: If there is no such file.
        """
        for place in (self.folder, ROOT):
            if (place / robot.campaign).is_file():
                return (place / robot.campaign).resolve()
        raise InputError(
            f"{PROJECT}: robot '{robot.name}' is simulated, and its campaign "
            f"{robot.campaign} is not there. Write it (docs/experiments.md), or take "
            "campaign = 'examples/nightly.toml'."
        )

    def columns(self, inbox: InboxTable) -> ColumnMap:
        """Return how the logs of an inbox are read."""
        return load_columns(self.path(inbox.map)) if inbox.map else ColumnMap()


def read_project(folder: str | Path) -> Project:
    """Read and check a project: its file, and that what it names is usable.

    Raises:
        InputError: On the first fault, with its line and what to do.
    """
    file = Path(folder).resolve() / PROJECT
    if not file.is_file():
        raise InputError(
            f"No {PROJECT} in {file.parent}. Write one with modelgap init."
        )
    content = read_toml(file)
    lines = file.read_text(encoding="utf-8").splitlines()
    for words, place in faults(ProjectTable, content):
        line = _line(lines, place)
        where = f"{PROJECT}, line {line}" if line else PROJECT
        raise InputError(f"{where}: {words}")
    project = Project(file.parent, ProjectTable(**content))
    for robot in project.table.robot:
        project.arm(robot)
        if robot.simulated:
            project.campaign(robot)
    for inbox in project.table.inbox:
        project.columns(inbox)
    return project


def project_here(store: Path) -> Project | None:
    """Return the project of the working directory, where a store is its own.

    Raises:
        InputError: If its file is not usable.
    """
    if not Path(PROJECT).is_file():
        return None
    project = read_project(".")
    return project if project.store == store else None


def _line(lines: Sequence[str], place: Sequence[str | int]) -> int | None:
    """Return the line, from 1, in which a key stands, or the head of its table."""
    if not place:
        return None
    index = place[1] if len(place) > 1 and isinstance(place[1], int) else 0
    key = next((word for word in reversed(place) if isinstance(word, str)), "")
    head, count, found = "", -1, None
    for number, line in enumerate(lines, 1):
        if match := re.match(r"\s*\[\[?([\w.-]+)\]", line):
            head = match[1]
            count += head == place[0]
            if (head, count) == (place[0], index):
                found = number
        elif re.match(rf"\s*{re.escape(key)}\s*=", line) and (
            (head == "" and len(place) == 1) or (head, count) == (place[0], index)
        ):
            return number
    return found
