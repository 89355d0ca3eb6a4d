"""What a server tells of flow runs: for the pages, and for modelgap status."""

from datetime import datetime

from flows.service import api
from residual.errors import RunError

TO = api.Api("http://127.0.0.1:1/api", "modelgap:key")
BEGIN, END = datetime(2026, 11, 21, 12), datetime(2026, 11, 22, 12)


def run(id: str, state: str, message: str | None = None, begun: str | None = None):
    return {
        "id": id,
        "name": f"run {id}",
        "start_time": begun,
        "expected_start_time": "2026-11-22T02:00:00+00:00",
        "end_time": None,
        "total_run_time": 3.0,
        "state_type": state,
        "state_name": state.title(),
        "state": {"message": message},
    }


class Server:
    """What stands for Prefect: it takes filters of states and limits at their word."""

    def __init__(self, runs, logs=()):
        self.runs, self.logs, self.asked = runs, logs, []

    def __call__(self, _api, path, body=None, *_given, **_more):
        self.asked.append((path, body))
        if path == "/logs/filter":
            return list(self.logs)
        if path == "/flows/filter":
            return [{"name": "nightly"}, {"name": "inbox"}]
        wanted = body["flow_runs"]
        if "name" in wanted:
            return [r for r in self.runs if wanted["name"]["like_"] in r["name"]]
        types = wanted["state"]["type"]
        kept = [
            each
            for each in self.runs
            if each["state_type"] in types.get("any_", [each["state_type"]])
            and each["state_type"] not in types.get("not_any_", [])
        ]
        return kept[: body["limit"]]


def test_the_past_has_what_failed_and_what_was_warned_of(monkeypatch):
    logs = [
        {"flow_run_id": "b", "message": "joint 2  at\nits limit"},
        {"flow_run_id": "b", "message": "joint 2 at its limit"},
        {"flow_run_id": "z", "message": "of another night"},
    ]
    runs = [run("a", "FAILED", "why", "2026-11-22T03:00:00+01:00"), run("b", "PAUSED")]
    server = Server([*runs, run("c", "CANCELLED"), run("d", "SCHEDULED")], logs)
    monkeypatch.setattr(api, "ask", server)
    told = api.past_of(TO)(BEGIN, END)
    assert [r.id for r in told.runs] == ["a", "b"]
    assert [r.failed for r in told.runs] == [True, False]
    assert told.runs[0].begun == datetime(2026, 11, 22, 2)
    assert told.runs[0].message == "why"
    assert told.warnings == (("run b", "joint 2 at its limit"),)
    _, first = next(each for each in server.asked if each[0] == "/flow_runs/filter")
    assert first["flows"] == {"name": {"any_": ["nightly"]}}
    span = first["flow_runs"]["expected_start_time"]
    assert span["after_"] == "2026-11-21T12:00:00+00:00"


def test_a_log_that_an_inbox_refused_is_seen(monkeypatch):
    refused = run("i", "COMPLETED") | {"name": "inbox: 3 stored, 1 refused"}
    monkeypatch.setattr(api, "ask", Server([refused]))
    assert [r.name for r in api.past_of(TO)(BEGIN, END).runs] == [refused["name"]]


def test_of_a_server_that_does_not_answer_there_is_no_past(monkeypatch):
    def ask(*_, **__):
        raise RunError("it does not answer")

    monkeypatch.setattr(api, "ask", ask)
    assert api.past_of(TO)(BEGIN, END) is None
