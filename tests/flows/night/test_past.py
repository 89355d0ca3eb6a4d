"""What a server tells of flow runs: for the pages, and for modelgap status."""

from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from types import SimpleNamespace
from uuid import NAMESPACE_OID, uuid5

from prefect.client.schemas.objects import FlowRun as Run
from prefect.client.schemas.objects import State

from flows.service import api

BEGIN, END = datetime(2026, 11, 21, 12), datetime(2026, 11, 22, 12)


def run(id: str, state: str, message: str | None = None, begun: str | None = None):
    return Run(
        id=uuid5(NAMESPACE_OID, id),
        name=f"run {id}",
        flow_id=uuid5(NAMESPACE_OID, "flow"),
        start_time=begun,
        expected_start_time="2026-11-22T02:00:00+00:00",
        total_run_time=timedelta(seconds=3),
        state=State(type=state, message=message),
        state_type=state,
        state_name=state.title(),
    )


class Server:
    """What stands for Prefect: it takes filters of states and limits at their word."""

    def __init__(self, runs, logs=()):
        self.runs, self.logs, self.asked = runs, logs, []

    def read_logs(self, *_, **__):
        return list(self.logs)

    def read_flows(self):
        return [SimpleNamespace(name="nightly"), SimpleNamespace(name="inbox")]

    def read_flow_runs(self, flow_filter, flow_run_filter, sort, limit):
        self.asked.append((flow_filter, flow_run_filter))
        wanted = flow_run_filter
        if wanted.name:
            return [r for r in self.runs if wanted.name.like_ in r.name]
        types = wanted.state.type
        kept = [
            each
            for each in self.runs
            if each.state_type in (types.any_ or [each.state_type])
            and each.state_type not in (types.not_any_ or [])
        ]
        return kept[:limit]

    @contextmanager
    def client(self, wait=None):
        yield self


def line(id: str, message: str):
    return SimpleNamespace(flow_run_id=uuid5(NAMESPACE_OID, id), message=message)


def test_the_past_has_what_failed_and_what_was_warned_of():
    logs = [
        line("b", "joint 2  at\nits limit"),
        line("b", "joint 2 at its limit"),
        line("z", "of another night"),
    ]
    runs = [run("a", "FAILED", "why", "2026-11-22T03:00:00+01:00"), run("b", "PAUSED")]
    server = Server([*runs, run("c", "CANCELLED"), run("d", "SCHEDULED")], logs)
    told = api.past_of(server)(BEGIN, END)
    assert [r.name for r in told.runs] == ["run a", "run b"]
    assert [r.failed for r in told.runs] == [True, False]
    assert told.runs[0].begun == datetime(2026, 11, 22, 2)
    assert told.runs[0].message == "why"
    assert told.warnings == (("run b", "joint 2 at its limit"),)
    flows, first = server.asked[0]
    assert flows.name.any_ == ["nightly"]
    assert first.expected_start_time.after_ == BEGIN.replace(tzinfo=UTC)


def test_a_log_that_an_inbox_refused_is_seen():
    refused = run("i", "COMPLETED")
    refused.name = "inbox: 3 stored, 1 refused"
    told = api.past_of(Server([refused]))(BEGIN, END)
    assert [r.name for r in told.runs] == [refused.name]


def test_of_a_server_that_does_not_answer_there_is_no_past():
    assert (
        api.past_of(api.Api("http://127.0.0.1:1/api", "modelgap:key"))(BEGIN, END)
        is None
    )
