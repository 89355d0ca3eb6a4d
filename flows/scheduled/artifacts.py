"""What people see of a flow in Prefect's pages: tables, plots, the report."""

from base64 import b64encode
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from time import monotonic

from prefect.artifacts import (
    create_link_artifact,
    create_markdown_artifact,
    create_progress_artifact,
    create_table_artifact,
    update_progress_artifact,
)

from flows.scheduled.stages import Stage

_MOST = 200  # rows that anybody reads there
_PAUSE = 5.0  # s between two steps of a bar: whoever tells it waits for the server
_PICTURE = 400_000  # bytes; what is larger makes the page slow


def progress(key: str, say: Callable[[str], None]) -> Callable[[str, float], None]:
    """Show a bar; returns what is to be told the stage and the share done.

    Args:
        key: Its name.
        say: Told each stage.
    """
    bar, shown = create_progress_artifact(0.0, key), [monotonic()]

    def tell(stage: str, share: float) -> None:
        say(stage)
        if share >= 1.0 or monotonic() - shown[0] > _PAUSE:
            shown[0] = monotonic()
            update_progress_artifact(bar, 100 * share)

    return tell


def table(key: str, rows: Sequence[Mapping], words: str | None = None) -> None:
    """Show a table; none where there are no rows.

    Args:
        key: Its name: lower case, digits and dashes.
        rows: One dict per row.
        words: What it shows.
    """
    if rows:
        create_table_artifact([dict(r) for r in rows[:_MOST]], key, words)


def stage(key: str, done: Stage) -> None:
    """Show what a stage came to: its words, ids and table.

    Args:
        key: Name of the stage.
        done: What it came to.
    """
    lines = [done.words, *(f"`modelgap show {id}`" for id in done.ids)]
    text = "\n\n".join(line for line in lines if line)
    if text:
        create_markdown_artifact(text, f"{key}-words")
    table(key, done.rows)


def plot(key: str, png: bytes, words: str) -> None:
    """Show a picture inside of a text, as the page loads nothing from elsewhere.

    Args:
        key: Its name.
        png: The picture.
        words: What it shows.
    """
    if len(png) <= _PICTURE:
        data = b64encode(png).decode()
        create_markdown_artifact(
            f"{words}\n\n![{key}](data:image/png;base64,{data})", key
        )


def report(page: Path, words: str, diagnosis: str) -> None:
    """Show the verdict, and where its page is.

    Args:
        page: The page.
        words: The verdict in sentences.
        diagnosis: Id of the diagnosis.
    """
    create_link_artifact(page.as_uri(), "report", key="report")
    create_markdown_artifact(words, key="verdict", description=f"diagnosis {diagnosis}")
