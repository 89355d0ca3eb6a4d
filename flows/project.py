"""A project: modelgap.toml, and the deployments of it and of prefect.yaml.

Paths are relative to its folder.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, get_args
from zoneinfo import available_timezones

import yaml
from pydantic import AfterValidator, ConfigDict, Field, model_validator
from pydantic import dataclasses as tables

from flows.inputs import load_command_robot
from flows.outputs import write_files
from flows.settings import HEALTHY, PROJECT, SHARED, port_is_free, resolve_store_folder
from residual.errors import InputError
from residual.robot.files import SERIAL, SLUG
from residual.robot.robot import (
    Robot,
    list_built_in_robots,
    parse_robot_reference,
    set_serial_number,
)
from warehouse.bucket import is_bucket_address
from warehouse.logs import read_column_map
from warehouse.toml_records import build_toml_record, read_toml

_TABLE = ConfigDict(extra="forbid")
_WORD = re.compile(r"[\w.-]+(=[^\x00-\x1f]{0,60})?")


def _cron(text: str) -> str:
    if not text:
        return text
    from prefect.client.schemas.schedules import CronSchedule

    try:
        CronSchedule(cron=text)
    except ValueError as error:
        raise ValueError(
            f"is '{text}', expected five fields of cron, such as '0 2 * * *' for two "
            "o'clock at night, or '' for never"
        ) from error
    return text


def _zone(text: str) -> str:
    if text not in available_timezones():
        raise ValueError(f"is '{text}', expected a name such as 'Europe/Zurich'")
    return text


def _tag(text: str) -> str:
    if not _WORD.fullmatch(text):
        raise ValueError(f"has '{text[:60]}', expected a word or KEY=VALUE")
    return text


Cron = Annotated[str, AfterValidator(_cron)]
Tags = tuple[Annotated[str, AfterValidator(_tag)], ...]
NoticeKind = Literal["alarm", "finding", "proposal", "refused", "failed"]
NOTICE_KINDS = get_args(NoticeKind)
_Path = Annotated[str, Field(min_length=1)]


@tables.dataclass(frozen=True, slots=True, config=_TABLE)
class RobotTable:
    """A robot of a project."""

    # Name in this file and of its deployments.
    name: Annotated[str, Field(pattern=SLUG.pattern)]
    # URDF file, folder with one and an optional robot.toml, or built-in name.
    urdf: _Path
    # Serial number of this arm; "" for none.
    serial: Annotated[str, Field(pattern=rf"^({SERIAL.pattern})?$")] = ""
    tags: Tags = ()  # tags of its runs
    # Run a nightly campaign on a simulated arm.
    simulated: Annotated[bool, Field(strict=True)] = False
    campaign: _Path = "examples/nightly.toml"
    held_out: str = "welding"  # motion family of a campaign that is not fitted
    nightly: Cron = "0 2 * * *"  # time of the diagnosis; "" for never
    timezone: Annotated[str, AfterValidator(_zone)] = "UTC"  # of `nightly`
    # Diagnose imported logs at once, not only at night.
    batch: Annotated[bool, Field(strict=True)] = True
    # Tag of the runs of the healthy arm: the baseline.
    healthy: Annotated[str, AfterValidator(_tag)] = HEALTHY
    # Largest number of logs of one diagnosis.
    most: Annotated[int, Field(ge=2, le=100, strict=True)] = 12
    # Adopt a model that passes the gate without asking.
    auto: Annotated[bool, Field(strict=True)] = False


@tables.dataclass(frozen=True, slots=True, config=_TABLE)
class InboxTable:
    """A folder for the logs of one robot."""

    robot: str
    folder: _Path  # created if it does not exist
    map: str = ""  # COLUMNS.toml of its logs; "" for the default columns
    tags: Tags = ()  # tags of its runs, besides those of the robot
    trajectory: str = ""  # kind of motion, for queries
    kind: str = "log"  # purpose of the logs, for queries
    # Time without a change before a file is read [s].
    quiet: Annotated[float, Field(ge=0, le=3600, allow_inf_nan=False)] = 10.0


@tables.dataclass(frozen=True, slots=True, config=_TABLE)
class NotifyTable:
    """Recipients of notifications, sent through Prefect."""

    # Notification block of this server: "TYPE/NAME", such as "slack-webhook/lab".
    block: Annotated[str, Field(pattern=r"^([\w-]+/[\w-]+)?$")] = ""
    # Environment variable with the address that gets each event as JSON; the address
    # is a secret, and not for a file.
    webhook: Annotated[str, Field(pattern=r"^([A-Za-z_]\w*)?$")] = ""
    kinds: tuple[NoticeKind, ...] = NOTICE_KINDS

    @model_validator(mode="after")
    def _check(self) -> "NotifyTable":
        if not (self.block or self.webhook) or not self.kinds:
            raise ValueError("notifies nobody, expected block or webhook, and kinds")
        return self


@tables.dataclass(frozen=True, slots=True, config=_TABLE)
class ProjectTable:
    """The content of a modelgap.toml."""

    schema: Literal[1]
    store: _Path = "store"  # folder of the store, or s3://BUCKET/PREFIX
    # Port of the server, one per project.
    port: Annotated[int, Field(ge=1, le=65535, strict=True)] = 4200
    workers: Annotated[int, Field(ge=1, le=64, strict=True)] = 1  # flows at once
    poll: Cron = "*/5 * * * *"  # times of the inbox runs
    robot: tuple[RobotTable, ...] = ()
    inbox: tuple[InboxTable, ...] = ()
    notify: NotifyTable | None = None

    @model_validator(mode="after")
    def _check(self) -> "ProjectTable":
        names = [robot.name for robot in self.robot]
        twice = next((n for n in names if names.count(n) > 1), None)
        if twice:
            raise ValueError(f"has two robots of the name '{twice}', expected one")
        real = [robot.name for robot in self.robot if not robot.simulated]
        for inbox in self.inbox:
            if inbox.robot not in real:
                raise ValueError(
                    f"has an inbox of the robot '{inbox.robot}', expected one of the "
                    f"robots that are not simulated: {', '.join(real) or 'none'}"
                )
        folders = [inbox.folder for inbox in self.inbox]
        if len(set(folders)) < len(folders):
            raise ValueError("has two inboxes in one folder, expected one of each")
        return self


@dataclass(frozen=True, slots=True)
class Project:
    """A modelgap.toml and its folder."""

    folder: Path
    table: ProjectTable

    @property
    def store(self) -> Path:
        """The folder of the store; of a bucket the local one."""
        word = self.table.store
        return resolve_store_folder(word) if is_bucket_address(word) else self.path(word)

    def path(self, name: str) -> Path:
        """Return a path of the file, relative to its folder."""
        return (self.folder / name).resolve()

    def robot(self, name: str) -> RobotTable:
        """Return a robot by its name."""
        for robot in self.table.robot:
            if robot.name == name:
                return robot
        listed = ", ".join(robot.name for robot in self.table.robot) or "none"
        raise InputError(f"{PROJECT} has no robot '{name}', it has: {listed}.")

    def word(self, robot: RobotTable) -> str:
        """Return the robot as --robot takes it."""
        is_built_in = robot.urdf in list_built_in_robots()
        return robot.urdf if is_built_in else str(self.path(robot.urdf))

    def arm(self, robot: RobotTable) -> Robot:
        """Load a robot, with its serial number."""
        try:
            return set_serial_number(load_command_robot(self.word(robot)), robot.serial or None)
        except InputError as error:
            raise InputError(f"{PROJECT}: robot '{robot.name}': {error}") from error

    def campaign(self, robot: RobotTable) -> Path:
        """Return the campaign file of a simulated robot."""
        for place in (self.folder, SHARED):
            if (place / robot.campaign).is_file():
                return (place / robot.campaign).resolve()
        raise InputError(
            f"{PROJECT}: the campaign {robot.campaign} of the simulated robot "
            f"'{robot.name}' does not exist. Write it (docs/experiments.md), or set "
            "campaign = 'examples/nightly.toml'."
        )


def read_project(folder: str | Path) -> Project:
    """Read and check a project, with its robots, campaigns and maps."""
    file = Path(folder).resolve() / PROJECT
    if not file.is_file():
        raise InputError(f"No {PROJECT} in {file.parent}. Create one: modelgap init.")
    project = Project(file.parent, build_toml_record(ProjectTable, read_toml(file), PROJECT))
    for robot in project.table.robot:
        project.arm(robot)
        if robot.simulated:
            project.campaign(robot)
    for inbox in project.table.inbox:
        if inbox.map:
            read_column_map(project.path(inbox.map))
    return project


def read_current_project(store: Path) -> Project | None:
    """Return the project of the working directory, if a store belongs to it."""
    if not Path(PROJECT).is_file():
        return None
    project = read_project(".")
    return project if project.store == store else None


_TEMPLATE = Path(__file__).with_name("project.toml")
_PORTS = range(4200, 4300)
INBOX = "inbox"


def create_project(
    folder: str | Path = ".", robot: str | None = None, simulated: bool = False
) -> Project:
    """Create a project.

    Args:
        folder: Its folder.
        robot: File, folder or built-in name of its first robot; None for the built-in
            IRB140, simulated.
    """
    folder = Path(folder).resolve()
    file = folder / PROJECT
    if file.exists():
        raise InputError(
            f"{file} exists, and is not changed. Edit it, or name another folder: "
            "modelgap init DIR."
        )
    word = robot or "irb140"
    name = load_command_robot(word).name
    folder.mkdir(parents=True, exist_ok=True)
    simulated = simulated or robot is None
    place, _ = parse_robot_reference(word)
    path, options = Path(place).resolve(), word.removeprefix(place)
    if path.is_relative_to(folder):  # a path from there
        path = path.relative_to(folder).as_posix()
    values = {
        # The first port that is free now.
        "PORT": str(next(filter(partial(port_is_free, "127.0.0.1"), _PORTS), 4200)),
        "NAME": name,
        "URDF": word if word in list_built_in_robots() else f"{path}{options}",
        "FOLDER": INBOX,
        "SIMULATED": "" if simulated else "# ",
        "YES": "true" if simulated else "false",
        "INBOX": "# " if simulated else "",
    }
    text = _TEMPLATE.read_text(encoding="utf-8")
    write_files({file: re.sub(r"@([A-Z]+)@", lambda word: values[word[1]], text)})
    project = read_project(folder)
    for inbox in project.table.inbox:
        project.path(inbox.folder).mkdir(parents=True, exist_ok=True)
    return project


COMMITTED = "modelgap.run.committed"
ALARM, PROPOSED = "modelgap.monitor.alarm", "modelgap.model.proposed"
STORED, STORE = "modelgap.inbox.stored", "modelgap.store"
NOTICE = "modelgap.notice"  # for people: .alarm, .finding, .refused, .failed
POOL = "modelgap"  # work pool, and tag of our deployments
_EXAMPLE_NIGHT = "nightly"  # of the built-in arm; a project has its own
_WITH_PROJECT = ("monitor", "alarm")  # get the folder of the project


def build_deployments(project: Project | None) -> dict[str, Any]:
    """Return the content of a prefect.yaml, of the program or for a project."""
    text = (SHARED / "prefect.yaml").read_text(encoding="utf-8")
    content = yaml.safe_load(text)
    content.pop("definitions", None)
    if project is None:
        return content
    base = [d for d in content["deployments"] if d["name"] != _EXAMPLE_NIGHT]
    for each in base:
        if each["name"] in _WITH_PROJECT:
            folder = {"project": str(project.folder)}
            each["parameters"] = each.get("parameters", {}) | folder
    return content | {"deployments": [*base, *_project_deployments(project)]}


def list_nightly_deployments(project: Project | None) -> tuple[str, ...]:
    """Return the nightly deployments, as "flow/name"."""
    if project is None:
        return (f"nightly/{_EXAMPLE_NIGHT}",)
    return tuple(
        f"{'nightly' if robot.simulated else 'diagnose-new'}/{robot.name}"
        for robot in project.table.robot
    )


def find_inbox_deployment(project: Project | None) -> str | None:
    """Return the deployment of the inboxes, None if there are none."""
    has = project is not None and project.table.inbox
    return "inbox/inbox" if has else None


def build_robot_resource(robot: str) -> str:
    """Return the resource id of events on the logs of a robot."""
    return f"modelgap.inbox.{robot}"


def _project_deployments(project: Project) -> Iterator[dict]:
    table, folder = project.table, {"project": str(project.folder)}
    for robot in table.robot:
        night = _build_schedule(robot.nightly, robot.timezone, "nightly")
        if robot.simulated:
            about = f"New runs of the simulated arm {robot.name}; identify, diagnose, "
            words = {"held_out": robot.held_out, "auto": robot.auto}
            words["campaign_file"] = str(project.campaign(robot))
            more = {"schedules": night, "parameters": words}
            yield _deployment(robot.name, "nightly", about + "report.", **more)
            continue
        stored = {
            "type": "event",
            "match": {"prefect.resource.id": build_robot_resource(robot.name)},
            "expect": [STORED],
            "posture": "Reactive",
            "threshold": 1,
            "within": 0,
        }
        yield _deployment(
            robot.name,
            "diagnose_new",
            f"Diagnoses the runs of {robot.name} since the last diagnosis.",
            parameters=folder | {"robot": robot.name},
            schedules=night,
            triggers=[stored] if robot.batch else [],
        )
    if table.inbox:
        about = "Checks and stores new logs in the inboxes."
        more = {"schedules": _build_schedule(table.poll, "UTC", "poll"), "parameters": folder}
        yield _deployment("inbox", "inbox", about, **more)


def _deployment(name: str, flow: str, about: str, **more: Any) -> dict:
    # An inbox run that lasts until the next one is not repeated.
    strategy = "ENQUEUE" if flow == "diagnose_new" else "CANCEL_NEW"
    return {
        "name": name,
        "entrypoint": f"flows.pipelines.flows.{flow}",
        "description": about,
        "tags": [POOL],
        "work_pool": {"name": POOL},
        "concurrency_limit": {"limit": 1, "collision_strategy": strategy},
        **more,
    }


def _build_schedule(text: str, zone: str, slug: str) -> list[dict]:
    return [{"cron": text, "timezone": zone, "slug": slug}] if text else []
