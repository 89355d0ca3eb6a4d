"""Flow runs that are said to run and that nobody runs: found and closed."""

from flows.service import api
from flows.service.processes import flow_processes, worker_name
from flows.service.wanted import BEAT

GONE = "Its process is gone; closed when modelgap up found it."
_WATCH = "close flow runs without a sign of life"


def close_stale(to: api.Api) -> list[str]:
    """Close flow runs of our pool that no process of this machine runs.

    Those of workers on other machines are left to `watch_for_stale`, which needs no
    look at processes.
    """
    alive, closed = flow_processes(), []
    if _elsewhere(to):
        return closed
    for run in api.active_runs(to):
        if run["id"] not in alive:
            api.end_run(to, run["id"], GONE)
            closed.append(run["name"])
    return closed


def watch_for_stale(to: api.Api) -> None:
    """Let the server itself close a flow run that gives no sign of life any more."""
    wanted = {"automations": {"name": {"any_": [_WATCH]}}}
    if api.ask(to, "/automations/filter", wanted):
        return
    ends = ("Completed", "Failed", "Cancelled", "Crashed")
    beat = "prefect.flow-run.heartbeat"
    trigger = {
        "type": "event",
        "match": {"prefect.resource.id": "prefect.flow-run.*"},
        "after": [beat],
        "expect": [beat, *(f"prefect.flow-run.{end}" for end in ends)],
        "for_each": ["prefect.resource.id"],
        "posture": "Proactive",
        "threshold": 1,
        # Two signs may get lost, and a busy machine is late.
        "within": 4 * BEAT,
    }
    action = {
        "type": "change-flow-run-state",
        "state": "CRASHED",
        "name": "Crashed",
        "message": f"No sign of life for {4 * BEAT} s.",
    }
    rule = {"name": _WATCH, "enabled": True, "trigger": trigger, "actions": [action]}
    about = "A killed process cannot say that it has ended."
    api.ask(to, "/automations/", {**rule, "description": about})


def _elsewhere(to: api.Api) -> bool:
    here = worker_name("")
    return any(not name.endswith(here) for name in api.workers_online(to))
