"""The deployments of prefect.yaml and of a project."""

from collections.abc import Iterator
from typing import Any

import yaml

from flows.project.read import Project
from flows.settings import SHARED

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
        night = _cron(robot.nightly, robot.timezone, "nightly")
        if robot.simulated:
            about = f"New runs of the simulated arm {robot.name}; identify, diagnose, "
            words = {"held_out": robot.held_out, "auto": robot.auto}
            words["campaign_file"] = str(project.campaign(robot))
            more = {"schedules": night, "parameters": words}
            yield _deployment(robot.name, "nightly.nightly", about + "report.", **more)
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
            "project.diagnose_new",
            f"Diagnoses what has come in of {robot.name} since the last time.",
            parameters=folder | {"robot": robot.name},
            schedules=night,
            triggers=[stored] if robot.batch else [],
        )
    if table.inbox:
        about = "Checks and stores the logs that dropped into the inboxes."
        more = {"schedules": _cron(table.poll, "UTC", "poll"), "parameters": folder}
        yield _deployment("inbox", "project.inbox", about, **more)


def _deployment(name: str, flow: str, about: str, **more: Any) -> dict:
    # An inbox run that lasts until the next one is not repeated.
    strategy = "ENQUEUE" if flow == "project.diagnose_new" else "CANCEL_NEW"
    return {
        "name": name,
        "entrypoint": f"flows.pipelines.{flow}",
        "description": about,
        "tags": [POOL],
        "work_pool": {"name": POOL},
        "concurrency_limit": {"limit": 1, "collision_strategy": strategy},
        **more,
    }


def _cron(text: str, zone: str, slug: str) -> list[dict]:
    return [{"cron": text, "timezone": zone, "slug": slug}] if text else []
