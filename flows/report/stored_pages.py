"""Pages of a diagnosis in the store, for schedules and the demonstration."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

from pydantic import TypeAdapter

from flows.inputs.read import load_command_robot
from flows.outputs import json_text
from flows.report.diagnosis import render_diagnosis_page
from flows.report.next_step import describe_name_records
from flows.report.page import read_diagnosis_origin
from flows.report.phrases import Demonstration, HiddenEffect
from flows.report.sentences import list_headline_sentences
from flows.report.store_index import write_index
from flows.storage.diagnosis import read_outcome, store_report
from residual.verdict.document import to_json
from sim.engine.pybullet_world import animate_samples
from warehouse.runs import read_run

CLIP = 6.0  # s of motion in the picture
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


def store_demo_page(
    ids: Sequence[str], run_id: str, hidden: Sequence[Mapping], store: Path
) -> Path:
    """Write the page of a demonstration: the arm in motion, at the end the truth."""
    run = read_run(store, run_id)
    rows = run.t - run.t[0] <= CLIP
    gif = animate_samples(load_command_robot(run.robot), run.t[rows], run.q[rows])
    caption = f"The first {CLIP:g} s of one experiment, in the physics engine."
    verdict = read_outcome(store, ids[1]).verdict
    demonstration = Demonstration(gif, caption, parse_hidden_effects(hidden), verdict)
    truth = (json.dumps(list(hidden), indent=2) + "\n").encode()
    files = {"truth.json": truth, "arm.gif": gif}
    return store_diagnosis_page(ids, store, "demo", demonstration, files)


def read_verdict_headline(proof: str, store: Path) -> str:
    """Return the headline of a stored verdict."""
    return " ".join(list_headline_sentences(read_outcome(store, proof).verdict))


def parse_hidden_effects(records: Sequence[Mapping]) -> tuple[HiddenEffect, ...]:
    """Return the records of a seal as hidden effects."""
    return _HIDDEN.validate_python(records)
