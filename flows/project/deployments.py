"""The deployments of prefect.yaml and of a project."""

from collections.abc import Iterator, Mapping
from typing import Any

import yaml

from flows.project.read import Project, RobotTable
from flows.settings import SHARED

COMMITTED = "modelgap.run.committed"
ALARM, PROPOSED = "modelgap.monitor.alarm", "modelgap.model.proposed"
STORED, STORE = "modelgap.inbox.stored", "modelgap.store"
NOTICE = "modelgap.notice"  # for people: .alarm, .finding, .refused, .failed
POOL = "modelgap"  # work pool, and tag of our deployments
_EXAMPLE_NIGHT = "nightly"  # of the built-in arm; a project has its own
_WITH_PROJECT = ("monitor", "alarm")  # get the folder of the project
_ENTRY = "flows.pipelines.project."


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
    for robot in project.table.robot:
        yield _simulated(project, robot) if robot.simulated else _real(project, robot)
    folder = {"project": str(project.folder)}
    if project.table.inbox:
        yield _deployment(
            "inbox",
            "inbox",
            "Checks and stores the logs that dropped into the inboxes.",
            folder,
            schedules=_cron(project.table.poll, "UTC", "poll"),
        )


def _simulated(project: Project, robot: RobotTable) -> dict:
    return _deployment(
        robot.name,
        "nightly",
        f"New runs of the simulated arm {robot.name}; identify, diagnose, report.",
        {
            "campaign_file": str(project.campaign(robot)),
            "held_out": robot.held_out,
            "auto": robot.auto,
        },
        entry="flows.pipelines.nightly.",
        schedules=_cron(robot.nightly, robot.timezone, "nightly"),
    )


def _real(project: Project, robot: RobotTable) -> dict:
    stored = {
        "type": "event",
        "enabled": True,
        "match": {"prefect.resource.id": build_robot_resource(robot.name)},
        "expect": [STORED],
        "posture": "Reactive",
        "threshold": 1,
        "within": 0,
        "parameters": {},
    }
    return _deployment(
        robot.name,
        "diagnose_new",
        f"Diagnoses what has come in of {robot.name} since the last time.",
        {"project": str(project.folder), "robot": robot.name},
        schedules=_cron(robot.nightly, robot.timezone, "nightly"),
        triggers=[stored] if robot.batch else [],
    )


def _deployment(
    name: str, flow: str, about: str, parameters: Mapping, **more: Any
) -> dict:
    entry = more.pop("entry", _ENTRY)
    # An inbox run that lasts until the next one is not repeated.
    strategy = "CANCEL_NEW" if flow in ("inbox", "nightly") else "ENQUEUE"
    return {
        "name": name,
        "entrypoint": f"{entry}{flow}",
        "description": about,
        "tags": [POOL],
        "work_pool": {"name": POOL},
        "parameters": dict(parameters),
        "concurrency_limit": {"limit": 1, "collision_strategy": strategy},
        "schedules": [],
        **more,
    }


def _cron(text: str, zone: str, slug: str) -> list[dict]:
    return [{"cron": text, "timezone": zone, "slug": slug}] if text else []
