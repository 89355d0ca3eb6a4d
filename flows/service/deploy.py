"""Put the deployments and automations of a store on its Prefect server.

`prefect deploy` does it in a process of its own, for three times the processor time.
To be imported under `flows.settings.build_prefect_environment`.
"""

import hashlib
import json
import os
from uuid import UUID

from prefect.blocks.webhook import Webhook
from prefect.client.orchestration import SyncPrefectClient
from prefect.client.schemas.actions import DeploymentScheduleCreate
from prefect.client.schemas.schedules import IntervalSchedule
from prefect.events import AutomationCore, DeploymentEventTrigger
from prefect.events.actions import CallWebhook, SendNotification
from prefect.exceptions import ObjectNotFound
from prefect.flows import load_flow_from_entrypoint
from prefect.settings import PREFECT_API_AUTH_STRING, PREFECT_API_URL, temporary_settings
from prefect.utilities.callables import parameter_schema

from flows.project.deployments import NOTICE, POOL, build_deployments
from flows.project.read import NotifyTable, Project
from flows.service.state import BEAT
from flows.settings import PROJECT, ROOT, SHARED
from residual.errors import InputError

_EVERY = "every"  # slug of the schedule of --every
_STALE = "close flow runs without a sign of life"
_NOTIFY = "notify people of alarms, findings, refused logs and proposals"
_BLOCK = "modelgap-notify"  # name of the block with the address of the webhook
# What a chat shows is "text"; the other keys are for programs.
_MESSAGE = """{%- set p = event.payload -%}
{{ dict(p, text=[p.title, p.text, p.page] | select | join("\n")) | tojson }}"""


def hash_deployments(project: Project | None) -> str:
    """Return a hash of the deployments, to know whether a server has those of now."""
    content = json.dumps(build_deployments(project)), str(ROOT), _read_notify(project)
    return hashlib.sha256(repr(content).encode()).hexdigest()[:20]


def _read_notify(project: Project | None) -> tuple[NotifyTable, str] | None:
    """Return what [notify] says, and the address of its webhook."""
    if project is None or project.table.notify is None:
        return None
    notify = project.table.notify
    address = os.environ.get(notify.webhook, "")
    if notify.webhook and not address.startswith(("http://", "https://")):
        raise InputError(
            f"{PROJECT}: [notify] webhook: the environment variable {notify.webhook} "
            f"has {'another value' if address else 'no value'}, expected the address "
            f"of the webhook. Set it, then: modelgap up."
        )
    return notify, address


def deploy(client: SyncPrefectClient, project: Project | None, key: str) -> None:
    """Create or replace all deployments and automations; remove other ones of ours."""
    notify = _build_notify_rule(client, project, key)  # may be refused
    kept = {_deploy(client, each) for each in build_deployments(project)["deployments"]}
    for each in client.read_deployments():
        if POOL in (each.tags or ()) and each.id not in kept:
            client.delete_deployment(each.id)
    _replace_rule(client, _STALE, _build_stale_run_rule())
    _replace_rule(client, _NOTIFY, notify)


def _deploy(client: SyncPrefectClient, each: dict) -> UUID:
    flow = load_flow_from_entrypoint(each["entrypoint"])
    limit = each.get("concurrency_limit") or {}
    when = ("cron", "timezone")
    schedules = [
        {"schedule": {key: each.pop(key) for key in when}, **each}
        for each in map(dict, each.get("schedules", ()))
    ]
    id = client.create_deployment(
        client.create_flow(flow),
        each["name"],
        schedules=schedules,
        concurrency_limit=limit.get("limit"),
        concurrency_options={k: v for k, v in limit.items() if k != "limit"} or None,
        parameters=each.get("parameters"),
        description=each["description"],
        work_pool_name=POOL,
        tags=each["tags"],
        entrypoint=each["entrypoint"],
        parameter_openapi_schema=parameter_schema(flow).model_dump(exclude_unset=True),
        enforce_parameter_schema=True,
        pull_steps=[],  # those of `prefect deploy` name a folder that may be gone
        job_variables={"working_dir": str(SHARED)},  # where the examples are
    )
    client.delete_resource_owned_automations(f"prefect.deployment.{id}")
    for trigger in each.get("triggers", ()):
        rule = DeploymentEventTrigger(name=f"start {each['name']}", **trigger)
        rule.set_deployment_id(id)
        client.create_automation(rule.as_automation())
    return id


def schedule_every(
    client: SyncPrefectClient, deployment: str, seconds: int, parameters: dict | None = None
) -> None:
    """Replace the schedule of --every of a deployment; 0 s removes it."""
    target = client.read_deployment_by_name(deployment)
    for old in target.schedules:
        if old.slug == _EVERY:
            client.delete_deployment_schedule(target.id, old.id)
    if seconds:
        when, given = IntervalSchedule(interval=seconds), parameters or {}
        new = DeploymentScheduleCreate(schedule=when, slug=_EVERY, parameters=given)
        client.create_deployment_schedules(target.id, [new])


def _replace_rule(client: SyncPrefectClient, name: str, rule: dict | None) -> None:
    for old in client.read_automations_by_name(name):
        client.delete_automation(old.id)
    if rule:
        rule["trigger"] |= {"type": "event", "threshold": 1}
        client.create_automation(AutomationCore.model_validate(rule | {"name": name}))


def _build_stale_run_rule() -> dict:
    """Return the automation that closes flow runs without heartbeat.

    A suspended run, which waits for an answer, has no process and no heartbeat.
    """
    rests = ("Completed", "Failed", "Cancelled", "Crashed", "Suspended", "Paused")
    beat = "prefect.flow-run.heartbeat"
    trigger = {
        "match": {"prefect.resource.id": "prefect.flow-run.*"},
        "after": [beat],
        "expect": [beat, *(f"prefect.flow-run.{rest}" for rest in rests)],
        "for_each": ["prefect.resource.id"],
        "posture": "Proactive",
        # Two heartbeats may get lost, and a busy machine is late.
        "within": 4 * BEAT,
    }
    message = f"No sign of life for {4 * BEAT} s."
    close = {"type": "change-flow-run-state", "state": "CRASHED", "message": message}
    about = "A killed process cannot report its end."
    action = {**close, "name": "Crashed"}
    return {"description": about, "trigger": trigger, "actions": [action]}


def _build_notify_rule(client: SyncPrefectClient, project: Project | None, key: str) -> dict | None:
    """Return the automation of [notify]; None where the project has none."""
    if (asked := _read_notify(project)) is None:
        return None
    (notify, address), actions = asked, []
    if notify.block:
        kind, _, name = notify.block.partition("/")
        try:
            id = client.read_block_document_by_name(name, kind).id
        except ObjectNotFound:
            raise InputError(
                f"{PROJECT}: [notify] block: this server has no '{notify.block}'. "
                "Create it in Prefect's page under Blocks, then: modelgap up."
            ) from None
        title, text = "{{ event.payload.title }}", "{{ event.payload.text }}"
        text += "\n{{ event.payload.page }}"
        actions.append(SendNotification(block_document_id=id, subject=title, body=text))
    if notify.webhook:
        server = {PREFECT_API_URL: str(client.api_url), PREFECT_API_AUTH_STRING: key}
        block = Webhook(url=address, headers={"Content-Type": "application/json"})
        with temporary_settings(server):  # a block takes them from nowhere else
            id = block.save(_BLOCK, overwrite=True)
        actions.append(CallWebhook(block_document_id=id, payload=_MESSAGE))
    expect = [f"{NOTICE}.{kind}" for kind in notify.kinds]
    trigger = {"expect": expect, "posture": "Reactive", "within": 0}
    return {"trigger": trigger, "actions": actions}
