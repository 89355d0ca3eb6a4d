"""What a running server tells the pages of flow runs."""

from collections.abc import Mapping
from datetime import UTC, datetime

from flows.errors import RunError
from flows.report.night.history import FlowRun, History, Past
from flows.service.api import Api, ask, flows_but_inbox

_MOST = 200  # that the server gives at once
# Levels of logs that are warnings; what is worse has failed, and says so there.
_WARNINGS = {"ge_": 30, "le_": 39}
_LONGEST = 300  # characters of one
_WAIT = 10.0  # s


def past_of(to: Api) -> Past:
    """Return what tells of the flow runs of a time, and of what they warned of."""

    def past(begin: datetime, end: datetime) -> History | None:
        span = {"after_": _iso(begin), "before_": _iso(end)}
        logs = {
            "logs": {"level": _WARNINGS, "timestamp": span},
            "sort": "TIMESTAMP_ASC",
            "limit": _MOST,
        }
        try:
            found = _runs(to, span)
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


def _runs(to: Api, span: Mapping) -> list[Mapping]:
    """Return the flow runs of a time, latest first.

    Of those of inboxes only what failed, and what refused a log.
    """
    begun = _state("not_any_", "SCHEDULED", "CANCELLED")
    wanted: tuple[Mapping, ...] = (
        {**flows_but_inbox(to), "flow_runs": begun},
        {"flow_runs": _state("any_", "FAILED", "CRASHED")},
        {"flow_runs": {"name": {"like_": "refused"}}},
    )
    found: dict[str, Mapping] = {}
    for filters in wanted:
        about = {**filters["flow_runs"], "expected_start_time": span}
        body = {**filters, "flow_runs": about, "sort": "START_TIME_DESC"}
        rows = ask(to, "/flow_runs/filter", body | {"limit": _MOST}, wait=_WAIT)
        found |= {row["id"]: row for row in rows}
    return sorted(found.values(), key=_begun, reverse=True)


def _state(how: str, *types: str) -> dict:
    return {"state": {"type": {how: list(types)}}}


def _begun(told: Mapping) -> datetime:
    when = datetime.fromisoformat(told["start_time"] or told["expected_start_time"])
    return when.astimezone(UTC).replace(tzinfo=None)


def _run(told: Mapping) -> FlowRun:
    return FlowRun(
        id=told["id"],
        name=told["name"],
        state=told["state_type"],
        begun=_begun(told),
        seconds=told["total_run_time"],
        message=(told["state"] or {}).get("message") or "",
    )


def _iso(when: datetime) -> str:
    return when.replace(tzinfo=UTC).isoformat()
