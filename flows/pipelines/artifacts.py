"""What a flow tells: artifacts and names for people, events that start other flows.

Events are sent by the flow layer after a commit; the store knows nothing of them.
"""

import os
from base64 import b64encode
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from prefect.artifacts import (
    create_link_artifact,
    create_markdown_artifact,
    create_table_artifact,
)
from prefect.client.orchestration import get_client
from prefect.events import emit_event
from prefect.runtime import flow_run

from flows.project.deployments import COMMITTED, NOTICE, STORE
from flows.report.index import INDEX, title_of
from flows.report.monitoring import meaning
from flows.report.monitoring import plot as draw
from flows.report.words.calibration import sentences
from flows.report.words.verdict import brief
from flows.settings import PAGES, page_link
from flows.steps.calibrate import Calibrated
from flows.steps.monitor import Watched
from flows.steps.validate import Validation
from flows.storage.diagnosis import read_verdict
from residual.identification.prove import Identified
from residual.recording import Recording

Rows = Sequence[Mapping]

_MOST = 200  # rows that anybody reads there
_TOGETHER = 1000  # ids in one event; the server refuses more than 1.5 MB
_LONGEST = 200  # characters; what is longer no list shows
_PICTURE = 400_000  # bytes; what is larger makes the page slow


def record(key: str, ids: Sequence[str], words: str, rows: Rows = ()) -> None:
    """Show what became of a stage: one artifact, whose description is what it found.

    Args:
        key: Name of the stage: lower case, digits and dashes.
    """
    kept = ", ".join(f"`modelgap show {id}`" for id in ids)
    about = "\n\n".join(line for line in (words, kept) if line) or key
    if rows:
        create_table_artifact([dict(r) for r in rows[:_MOST]], key, about)
    else:
        create_markdown_artifact(about, key, about.split("\n")[0])


def identification(made: Identified, kept: str | None) -> None:
    """Show an identification: errors on held-out motion by model."""
    rows = [
        _row({"model": name}, errors.per_joint("filtered"), errors.overall("filtered"))
        for name, errors in made.errors.items()
    ]
    words = " ".join(f"{warning}." for warning in made.warnings)
    about = f"Error on held-out motion by model, in per cent. {words}".strip()
    record("identify", (kept,) if kept else (), about, rows)


def calibration(done: Calibrated) -> None:
    """Show a calibration: errors by scheme and model."""
    rows = [
        _row({"scheme": s.scheme, "model": s.model}, s.rmsev, s.overall)
        for s in done.made.scores
    ]
    ids = tuple(done.kept.values())
    about = f"Error by scheme and model. {' '.join(sentences(done.made))}".strip()
    record("calibrate", ids, about, rows)


def validations(made: Mapping[str, tuple[str, Validation]]) -> None:
    """Show validations: errors per joint of each run.

    Args:
        made: Id of the validation and what was found, by run.
    """
    rows = []
    for run, (_, found) in made.items():
        figures = {
            "open loop [mrad]": found.open_loop,
            "feed-forward, nominal [mrad]": found.nominal,
            "feed-forward, the arm's own [mrad]": found.arm,
        }
        rows += [
            _row({"run": run[:8], "what": name}, 1e3 * errors)
            for name, errors in figures.items()
            if errors is not None
        ]
        rows += [
            _row({"run": run[:8], "what": f"{name}: {way} [%]"}, errors)
            for name, each in found.models.items()
            for way, errors in (("torque", each.torque), ("qdd", each.acceleration))
            if errors is not None
        ]
    about = (
        "Error of the nominal model by joint, in mrad; torque from motion and "
        "acceleration from torque of every model, in per cent where the joint moves."
    )
    record("validate", [id for id, _ in made.values()], about, rows)


def monitoring(id: str, found: Watched, watched: Mapping[str, Recording]) -> None:
    """Show what watching the sensors found: the alarms and the scores."""
    rows = [
        {
            "run": run[:8],
            "since start [s]": round(float(a.time - watched[run].t[0]), 3),
            "joint": a.joint,
            "sensor": a.sensor,
            "fault": a.fault,
        }
        for run, alarms in found.alarms.items()
        for a in alarms
    ]
    words = " ".join([meaning(found), *found.notes])
    record("monitor", (id,), words, rows)
    plot("monitor-scores", draw(found, watched), words)


def plot(key: str, png: bytes, words: str) -> None:
    """Show a picture inside of a text, as the page loads nothing from elsewhere."""
    if len(png) <= _PICTURE:
        data = b64encode(png).decode()
        text = f"{words}\n\n![{key}](data:image/png;base64,{data})"
        create_markdown_artifact(text, key, words)


def verdict(name: str, page: Path, words: str) -> None:
    """Show a verdict, its page, and where all others are.

    Args:
        name: Robot, number and verdict in half a line.
    """
    at = link_of(page)
    create_link_artifact(at, "report", key="report", description=name)
    lines = [f"**{name}**", words, f"[Report]({at})"]
    if os.environ.get(PAGES):
        lines[-1] += f" · [All reports]({page_link(INDEX, page)})"
    create_markdown_artifact("\n\n".join(lines), "verdict", description=name)


def linked(key: str, page: Path, words: str, link: str, about: str) -> None:
    """Show a text with a link to its page."""
    text = f"{words}\n\n[{link}]({link_of(page)})"
    create_markdown_artifact(text, key=key, description=about)


def link_of(page: Path) -> str:
    """Return where a browser finds a page that is a file of a report."""
    return page_link(f"{page.parent.name}/{page.name}", page)


def _row(about: dict, per_joint: np.ndarray, overall: float | None = None) -> dict:
    """Return a row of a table: figures per joint, three digits, null for none."""
    figures = {f"J{j}": _short(v) for j, v in enumerate(per_joint, 1)}
    return about | figures | ({} if overall is None else {"all": _short(overall)})


def _short(value: float) -> float | None:
    return float(f"{value:.3g}") if np.isfinite(value) else None


def runs_committed(ids: Sequence[str]) -> None:
    """Tell that runs are in the store; one event for a batch of them."""
    for start in range(0, len(ids), _TOGETHER):
        tell(COMMITTED, {"run_ids": list(ids[start : start + _TOGETHER])})


def tell(name: str, payload: dict, about: str = STORE) -> None:
    """Send an event, which may start other flows."""
    emit_event(name, resource={"prefect.resource.id": about}, payload=payload)


def notice(
    kind: str,
    robot: str,
    title: str,
    text: str = "",
    ids: Sequence[str] = (),
    page: str = "",
) -> None:
    """Send an event for people, on which an automation of Prefect notifies them.

    Args:
        kind: "alarm", "finding", "refused" or "failed".
        title: In one line.
        text: All of it.
        ids: Ids of the records that it is about.
        page: Address of the page to look at, "" for none.
    """
    payload = {"kind": kind, "robot": robot, "title": title, "text": text}
    tell(f"{NOTICE}.{kind}", payload | {"ids": list(ids), "page": page})


def name_of(diagnosis: str, store: Path) -> str:
    """Return a diagnosis in half a line: "irb140 #2: load friction on joint 2, ..."."""
    words = brief(read_verdict(store, diagnosis))
    return f"{title_of(store, diagnosis)}: {words}"


def rename(name: str) -> None:
    """Give the flow run that we are in another name; nothing outside of one."""
    if flow_run.id is None:
        return
    with get_client(sync_client=True) as client:
        client.update_flow_run(flow_run.id, name=name[:_LONGEST])
