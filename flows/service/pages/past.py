"""What a running server tells the pages of flow runs."""

from collections.abc import Mapping
from datetime import UTC, datetime

from flows.errors import RunError
from flows.report.night.history import FlowRun, History, Past
from flows.service.api import Api, ask

_MOST = 200  # that the server gives at once
# Levels of logs that are warnings; what is worse has failed, and says so there.
_WARNINGS = {"ge_": 30, "le_": 39}
_LONGEST = 300  # characters of one
_WAIT = 10.0  # s


def past_of(to: Api) -> Past:
    """Return what tells of the flow runs of a time, and of what they warned of.

    Args:
        to: The API.
    """

    def past(begin: datetime, end: datetime) -> History | None:
        span = {"after_": _iso(begin), "before_": _iso(end)}
        wanted = {
            "flow_runs": {
                "expected_start_time": span,
                "state": {"type": {"not_any_": ["SCHEDULED", "CANCELLED"]}},
            },
            "sort": "START_TIME_DESC",
            "limit": _MOST,
        }
        logs = {
            "logs": {"level": _WARNINGS, "timestamp": span},
            "sort": "TIMESTAMP_ASC",
            "limit": _MOST,
        }
        try:
            found = ask(to, "/flow_runs/filter", wanted, wait=_WAIT)
            told = ask(to, "/logs/filter", logs, wait=_WAIT)
        except RunError:
            return None
        names = {run["id"]: run["name"] for run in found}
        lines = [
            (names[line["flow_run_id"]], " ".join(line["message"].split())[:_LONGEST])
            for line in told
            if line["flow_run_id"] in names
        ]
        return History(tuple(map(_run, found)), tuple(dict.fromkeys(lines)))

    return past


def _run(told: Mapping) -> FlowRun:
    begun = told["start_time"] or told["expected_start_time"]
    when = datetime.fromisoformat(begun).astimezone(UTC).replace(tzinfo=None)
    return FlowRun(
        id=told["id"],
        name=told["name"],
        state=told["state_type"],
        begun=when,
        seconds=told["total_run_time"],
        message=(told["state"] or {}).get("message") or "",
    )


def _iso(when: datetime) -> str:
    return when.replace(tzinfo=UTC).isoformat()
