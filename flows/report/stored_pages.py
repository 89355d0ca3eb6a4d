"""Pages of a diagnosis in the store, for schedules and the demonstration."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

from pydantic import TypeAdapter

from flows.outputs import json_text
from flows.report.charts import render_diagnosis_page
from flows.report.page import read_diagnosis_origin
from flows.report.phrases import Demonstration, HiddenEffect
from flows.report.sentences import list_headline_sentences
from flows.report.store_index import write_index
from flows.storage.diagnosis import read_outcome, store_report
from residual.verdict.document import to_json
from residual.verdict.result import Finding
from warehouse.query.store import open_store

_HIDDEN = TypeAdapter(tuple[HiddenEffect, ...])


def store_diagnosis_page(
    ids: Sequence[str],
    store: Path,
    kind: str,
    demonstration: Demonstration | None = None,
    files: Mapping[str, bytes] | None = None,
) -> Path:
    """Write the page and the verdict of a diagnosis into the store.

    Args:
        kind: What it reports, such as "nightly".
        demonstration: What only a demonstration can show.
    """
    result = read_outcome(store, ids[1])
    robot = result.verdict.robot
    origin = read_diagnosis_origin(store, ids[0])
    records = describe_name_records(store, ids[0], result.effects)
    page = render_diagnosis_page(result, robot, demonstration, origin, records)
    verdict = json_text(to_json(result.verdict)).encode()
    contents = {"report.html": page.encode(), "verdict.json": verdict, **(files or {})}
    folder = store_report(store, {"robot": robot, "kind": kind}, ids[0], contents)
    write_index(store)
    return folder / "report.html"


def store_demo_page(ids: Sequence[str], hidden: Sequence[Mapping], store: Path) -> Path:
    """Write the page of a demonstration, with the truth at its end."""
    verdict = read_outcome(store, ids[1]).verdict
    demonstration = Demonstration(parse_hidden_effects(hidden), verdict)
    files = {"truth.json": (json.dumps(list(hidden), indent=2) + "\n").encode()}
    return store_diagnosis_page(ids, store, "demo", demonstration, files)


def read_verdict_headline(proof: str, store: Path) -> str:
    """Return the headline of a stored verdict."""
    return " ".join(list_headline_sentences(read_outcome(store, proof).verdict))


def parse_hidden_effects(records: Sequence[Mapping]) -> tuple[HiddenEffect, ...]:
    """Return the records of a seal as hidden effects."""
    return _HIDDEN.validate_python(records)


_RECORD = """
    WITH this AS (
        SELECT robot, any_value(serial) AS serial FROM verdicts
        WHERE diagnosis_id = $id GROUP BY robot
    )
    SELECT diagnosis_id,
           list_sort(list(DISTINCT run_id) FILTER (role = 'fit')) AS runs,
           list(DISTINCT {'name': effect, 'joints': joints})
               FILTER (effect IS NOT NULL) AS named
    FROM verdicts JOIN this USING (robot)
    WHERE verdicts.serial IS NOT DISTINCT FROM this.serial
    GROUP BY diagnosis_id ORDER BY min(verdicts.created), diagnosis_id
"""
_LAST = 20  # diagnoses of other runs that a record goes back


def describe_name_records(store: Path, id: str, effects: Sequence[Finding]) -> tuple[str, ...]:
    """Return for each finding of a diagnosis how often its arm's diagnoses had it.

    Counts diagnoses up to this one, of the same runs only the last.
    """
    with open_store(store) as opened:
        rows = opened.sql(_RECORD, {"id": id}).to_pylist()
    named_by_runs: dict[tuple, list] = {}
    for row in rows:
        runs = tuple(row["runs"] or (row["diagnosis_id"],))
        named_by_runs.pop(runs, None)
        named_by_runs[runs] = row["named"] or []
        if row["diagnosis_id"] == id:
            break
    last = list(named_by_runs.values())[-_LAST:]
    return tuple(_record(effect, last) for effect in effects)


def _record(effect: Finding, diagnoses: Sequence[Sequence[dict]]) -> str:
    if len(diagnoses) < 2:
        return "This is the first stored diagnosis of this arm: nothing repeats it yet."
    times = sum(
        any(
            named["name"] == effect.name
            and (not effect.joints or {*named["joints"]} & {*effect.joints})
            for named in each
        )
        for each in diagnoses
    )
    of = f"{len(diagnoses)} stored diagnoses of this arm, each of other runs"
    return f"Record: named in {times} of the last {of}."
