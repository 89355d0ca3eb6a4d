"""What a modelgap.toml may say: every table and key, with its default."""

import re
from datetime import datetime
from typing import Annotated, Literal
from zoneinfo import available_timezones

from cronsim import CronSim, CronSimError
from pydantic import AfterValidator, ConfigDict, Field, model_validator
from pydantic.dataclasses import dataclass

from residual.robot.toml import SERIAL, SLUG

_TABLE = ConfigDict(extra="forbid")
_WORD = re.compile(r"[\w.-]+(=[^\x00-\x1f]{0,60})?")
_ANY = datetime(2026, 1, 1)  # a start is needed to parse, and any will do
NOTICES = ("alarm", "finding", "refused", "failed")


def _cron(text: str) -> str:
    if not text:
        return text
    try:
        CronSim(text, _ANY)
    except CronSimError as error:
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
_Path = Annotated[str, Field(min_length=1)]


@dataclass(frozen=True, slots=True, config=_TABLE)
class RobotTable:
    """A robot of a project.

    Attributes:
        name: What it is called in this file, and its deployments.
        urdf: URDF file, folder with one and an optional robot.toml, or built-in name.
        serial: Serial number of this arm; "" for none.
        tags: What its runs are given.
        simulated: Whether the nights run a campaign on a simulated arm.
        campaign: The campaign of a simulated robot.
        held_out: Kind of motion of a campaign that is not fitted.
        nightly: When it is diagnosed, in cron; "" for never.
        timezone: Where that is meant.
        batch: Whether what an inbox has stored is diagnosed at once, not at night only.
        healthy: Tag of the runs of the arm in good order: the baseline.
        most: How many logs one diagnosis takes at most.
        auto: Whether a model that passes the gate is adopted without asking.
    """

    name: Annotated[str, Field(pattern=SLUG.pattern)]
    urdf: _Path
    serial: Annotated[str, Field(pattern=rf"^({SERIAL.pattern})?$")] = ""
    tags: Tags = ()
    simulated: Annotated[bool, Field(strict=True)] = False
    campaign: _Path = "examples/nightly.toml"
    held_out: str = "welding"
    nightly: Cron = "0 2 * * *"
    timezone: Annotated[str, AfterValidator(_zone)] = "UTC"
    batch: Annotated[bool, Field(strict=True)] = True
    healthy: Annotated[str, AfterValidator(_tag)] = "healthy"
    most: Annotated[int, Field(ge=2, le=100, strict=True)] = 12
    auto: Annotated[bool, Field(strict=True)] = False


@dataclass(frozen=True, slots=True, config=_TABLE)
class InboxTable:
    """A folder that logs of one robot drop into.

    Attributes:
        robot: Name of the robot.
        folder: The folder; made where it is not there.
        map: COLUMNS.toml of its logs; "" for the usual columns.
        tags: What its runs are given, beside the tags of the robot.
        trajectory: What kind of motion it was; "" for no word.
        kind: What it was recorded for.
        quiet: How long a file must rest before it is read [s].
    """

    robot: str
    folder: _Path
    map: str = ""
    tags: Tags = ()
    trajectory: str = ""
    kind: str = "log"
    quiet: Annotated[float, Field(ge=0, le=3600, allow_inf_nan=False)] = 10.0


@dataclass(frozen=True, slots=True, config=_TABLE)
class NotifyTable:
    """Who is told of what happens.

    Attributes:
        on: What is told.
        command: A program and its arguments, each a text of its own; () for none.
        file: A file that a line is added to; "" for none.
        timeout: How long the program may take [s].
    """

    on: tuple[Literal["alarm", "finding", "refused", "failed"], ...] = NOTICES
    command: tuple[str, ...] = ()
    file: str = ""
    timeout: Annotated[float, Field(gt=0, le=3600, allow_inf_nan=False)] = 30.0


@dataclass(frozen=True, slots=True, config=_TABLE)
class ProjectTable:
    """The content of a modelgap.toml.

    Attributes:
        schema: Version of this form.
        store: Folder of the store, or s3://BUCKET/PREFIX.
        port: Port of the server; each project has its own.
        workers: How many workers.
        poll: When the inboxes are looked into, in cron.
        robot: The robots.
        inbox: The inboxes.
        notify: Who is told of what happens.
    """

    schema: Literal[1]
    store: _Path = "store"
    port: Annotated[int, Field(ge=1, le=65535, strict=True)] = 4200
    workers: Annotated[int, Field(ge=1, le=64, strict=True)] = 1
    poll: Cron = "*/5 * * * *"
    robot: tuple[RobotTable, ...] = ()
    inbox: tuple[InboxTable, ...] = ()
    notify: NotifyTable = NotifyTable()

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
