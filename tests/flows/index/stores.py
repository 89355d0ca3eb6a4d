"""A store as nights leave it, with two robots; the name of one is an attack."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from flows.storage import store_report
from tests.flows.report_outcomes import given_value
from tests.warehouse import store_samples as samples
from warehouse.record_commit import commit_adoption as adopt_model
from warehouse.record_commit import commit_record
from warehouse.store_catalogue import ADOPTED, ModelAdoption, read_record
from warehouse.view_schema import build_view_table

EVIL = '"><img src=x onerror=alert(1)>&'
STORED = b'<!doctype html><title>stored</title><h1 id="kept">A stored page</h1>'


@dataclass(frozen=True, slots=True)
class Nights:
    """What is in it."""

    store: Path
    runs: tuple[str, ...]
    missing: str
    nothing: str
    report: str
    proposal: str
    watched: str


OFF = given_value("viscous", 1)


def fill(store: Path, stored: bytes = STORED, files: Mapping[str, bytes] | None = None) -> Nights:
    runs = tuple(samples.commit(store, seed) for seed in range(4))
    missing = diagnose(store, runs[:2], samples.verdict())
    nothing = diagnose(
        store, runs[2:], samples.verdict(verdict="none", effects=[], robot=EVIL, changes=[OFF])
    )
    about = {"robot": "two_link", "kind": "nightly"}
    page = store_report(store, about, missing, {"report.html": stored, **(files or {})})
    proposal = {**about, "kind": "proposal", "parent": None, "findings": []}
    side = store_report(store, proposal, missing, {"proposal.html": STORED})
    ids = [each.name.removeprefix("report_id=") for each in (page, side)]
    rows = build_view_table("alarms", [alarm(runs[0])])
    monitoring = {"robot": "two_link", "kind": "monitor"}
    parents = {"watched": [runs[0]]}
    watched = commit_record(store, "validations", monitoring, {"alarms": rows}, parents)
    turned = {"robot": "two_link", "kind": "refused", "verdict": "bad.csv: no <t>"}
    commit_record(store, "validations", turned)
    return Nights(store, runs, missing, nothing, *ids, watched)


def diagnose(store: Path, runs: tuple[str, ...], document: dict) -> str:
    document["error"]["logs"] = list(runs[-1:])
    return samples.store_verdict(store, document, {"theta": [len(runs)]}, list(runs))


def alarm(run: str) -> dict:
    place = {"run_id": run, "time": 0.1, "until": 0.2, "joint": 2}
    fault = {"sensor": "torque", "fault": "gain drop", "kind": "t2", "score": 3.0}
    return place | fault


def adopt(store: Path, diagnosis: str, note: str = "") -> str:
    model = read_record(store, diagnosis)["model_id"]
    who = {"who": "ann", "note": note, "before": 20.0, "after": 5.6}
    return adopt_model(
        store, ModelAdoption("two_link", None, ADOPTED, model, diagnosis, None, **who)
    )
