"""Pages of a diagnosis in the store, for schedules and the demonstration."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

from pydantic import TypeAdapter

from flows.outputs import json_text
from flows.report.diagnosis import render_diagnosis_page
from flows.report.next_step import describe_name_records
from flows.report.page import read_diagnosis_origin
from flows.report.phrases import Demonstration, HiddenEffect
from flows.report.sentences import list_headline_sentences
from flows.report.store_index import write_index
from flows.storage.diagnosis import read_outcome, store_report
from residual.verdict.document import to_json

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
