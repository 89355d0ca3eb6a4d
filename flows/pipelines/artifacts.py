"""Artifacts and names of flow runs for people, events for other flows.

Flows send the events after a commit; the store knows nothing of them.
"""

import os
from collections.abc import Sequence
from pathlib import Path

from prefect.artifacts import create_link_artifact, create_markdown_artifact
from prefect.client.orchestration import get_client
from prefect.events import emit_event
from prefect.runtime import flow_run

from flows.project.deployments import COMMITTED, NOTICE, STORE
from flows.report.document import ReportTable
from flows.report.index import INDEX, title_of
from flows.report.sentences import brief
from flows.settings import PAGES, page_link
from flows.storage.diagnosis import read_verdict

_MOST = 200  # rows of a table
_TOGETHER = 1000  # ids in one event; the server refuses more than 1.5 MB
_LONGEST = 200  # characters of the name of a flow run


def publish(key: str, ids: Sequence[str], parts: Sequence[str | ReportTable]) -> None:
    """Show the outcome of a stage as one text, the same as its command prints.

    Args:
        key: Name of the stage: lower case, digits and dashes.
        ids: Ids of the records that were stored.
        parts: Sentences and tables.
    """
    stored = [f"Stored: {', '.join(f'`modelgap show {id}`' for id in ids)}"]
    lines = [*map(_markdown, parts), *(stored if ids else [])]
    about = next((part for part in parts if isinstance(part, str)), key)
    create_markdown_artifact("\n\n".join(lines), key, about)


def _markdown(part: str | ReportTable) -> str:
    if isinstance(part, str):
        return part
    rows = [part.heads, ["---"] * len(part.heads), *part.rows[:_MOST]]
    lines = ["| " + " | ".join(" ".join(c.split()) for c in row) + " |" for row in rows]
    return "\n".join(lines)


def publish_verdict(name: str, page: Path, words: str) -> None:
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


def publish_link(key: str, page: Path, words: str, link: str, about: str) -> None:
    """Show a text with a link to its page."""
    text = f"{words}\n\n[{link}]({link_of(page)})"
    create_markdown_artifact(text, key=key, description=about)


def link_of(page: Path) -> str:
    """Return where a browser finds a page that is a file of a report."""
    return page_link(f"{page.parent.name}/{page.name}", page)


def runs_committed(ids: Sequence[str]) -> None:
    """Tell that runs are in the store; one event for a batch of them."""
    for start in range(0, len(ids), _TOGETHER):
        send_event(COMMITTED, {"run_ids": list(ids[start : start + _TOGETHER])})


def send_event(name: str, payload: dict, about: str = STORE) -> None:
    """Send an event, which may start other flows."""
    emit_event(name, resource={"prefect.resource.id": about}, payload=payload)


def send_notice(
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
    send_event(f"{NOTICE}.{kind}", payload | {"ids": list(ids), "page": page})


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
