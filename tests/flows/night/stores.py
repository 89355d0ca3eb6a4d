"""A store as nights leave it, with two robots; the name of one is an attack."""

from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa

from flows.storage.diagnosis import store_report
from tests.warehouse import store_samples as made
from warehouse.commit import commit_record
from warehouse.layout import read_record
from warehouse.numbered import ADOPTED, Adoption, commit_adoption
from warehouse.schema import rows_table

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


def fill(store: Path, stored: bytes = STORED) -> Nights:
    """Put runs, two diagnoses, a report, a proposal, an alarm and models into it."""
    runs = tuple(made.commit(store, seed) for seed in range(4))
    missing = diagnose(store, runs[:2], made.verdict())
    nothing = diagnose(
        store, runs[2:], made.verdict(verdict="none", effects=[], robot=EVIL)
    )
    about = {"robot": "two_link", "kind": "nightly"}
    page = store_report(store, about, missing, {"report.html": stored})
    asked = {**about, "kind": "proposal", "parent": None, "findings": []}
    side = store_report(store, asked, missing, {"proposal.html": STORED})
    rows = rows_table("alarms", [alarm(runs[0])])
    told = {"robot": "two_link", "kind": "monitor"}
    parents = {"watched": [runs[0]]}
    watched = commit_record(store, "validations", told, {"alarms": rows}, parents)
    for night, value in enumerate((*5 * (1.0, 1.1), 9.0)):
        identify(store, runs[0], night, value)
    return Nights(store, runs, missing, nothing, _id(page), _id(side), watched)


def diagnose(store: Path, runs: tuple[str, ...], document: dict) -> str:
    """Store a diagnosis of some runs, the last one held out."""
    document["error"]["logs"] = list(runs[-1:])
    return made.store_verdict(store, document, {"theta": [len(runs)]}, list(runs))


def alarm(run: str) -> dict:
    place = {"run_id": run, "time": 0.1, "until": 0.2, "joint": 2}
    fault = {"sensor": "torque", "fault": "gain drop", "kind": "t2", "score": 3.0}
    return place | fault


def identify(store: Path, run: str, night: int, value: float) -> str:
    """Store a model with one parameter."""
    same = {"name": "mass of link 2", "joint": 2, "unit": "kg", "status": "fitted"}
    numbers = {"value": value, "std": 0.1, "nominal": 1.0}
    rows = pa.Table.from_pylist([same | numbers])
    record = {"robot": "two_link", "stage": "identified", "night": night}
    return commit_record(store, "models", record, {"parameters": rows}, {"fit": [run]})


def adopt(store: Path, diagnosis: str, note: str = "") -> str:
    """Give the robot the model of a diagnosis."""
    model = read_record(store, diagnosis)["model_id"]
    who = {"who": "ann", "note": note, "before": 20.0, "after": 5.6}
    return commit_adoption(
        store, Adoption("two_link", None, ADOPTED, model, diagnosis, None, **who)
    )


def _id(page: Path) -> str:
    return page.name.removeprefix("report_id=")
