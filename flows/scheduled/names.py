"""The names that flow runs end with: what came out, and not what was asked for."""

from pathlib import Path

from prefect.client.orchestration import get_client
from prefect.runtime import flow_run

from flows.report.night.look import title_of
from flows.report.words.verdict import brief
from flows.storage.diagnosis import read_verdict

_LONGEST = 200  # characters; what is longer no list shows


def of_diagnosis(diagnosis: str, store: Path) -> str:
    """Return a diagnosis in half a line: "irb140 #2: load friction on joint 2, ...".

    Args:
        diagnosis: Its id.
        store: The store.
    """
    words = brief(read_verdict(store, diagnosis))
    return f"{title_of(store, diagnosis)}: {words}"


def rename(name: str) -> None:
    """Give the flow run that we are in another name; nothing outside of one."""
    if flow_run.id is None:
        return
    with get_client(sync_client=True) as client:
        client.update_flow_run(flow_run.id, name=name[:_LONGEST])
