"""What people see of a flow in Prefect's pages: tables, plots, the report."""

from base64 import b64encode
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from time import monotonic

import numpy as np
from prefect.artifacts import (
    create_link_artifact,
    create_markdown_artifact,
    create_progress_artifact,
    create_table_artifact,
    update_progress_artifact,
)

from flows.report.page.monitor_plot import plot as draw
from flows.report.terminal.monitor import meaning
from flows.report.words.calibration import sentences
from flows.steps.calibrate import Calibrated
from flows.steps.monitor import Watched
from flows.steps.validate import Validation
from residual.identification.prove import Identified
from residual.recording import Recording

Rows = Sequence[Mapping]

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


def table(key: str, rows: Rows, words: str | None = None) -> None:
    """Show a table; none where there are no rows.

    Args:
        key: Its name: lower case, digits and dashes.
        rows: One dict per row.
        words: What it shows.
    """
    if rows:
        create_table_artifact([dict(r) for r in rows[:_MOST]], key, words)


def record(key: str, ids: Sequence[str], words: str, rows: Rows = ()) -> None:
    """Show what became of a stage: its words, the ids of its records, its table.

    Args:
        key: Name of the stage.
        ids: Ids of the records that it left in the store.
        words: What it found, in sentences.
        rows: One dict per row.
    """
    lines = [words, *(f"`modelgap show {id}`" for id in ids)]
    text = "\n\n".join(line for line in lines if line)
    if text:
        create_markdown_artifact(text, f"{key}-words")
    table(key, rows)


def identification(made: Identified, kept: str | None) -> None:
    """Show an identification: errors on held-out motion by model."""
    rows = [
        _row({"model": name}, errors.per_joint("filtered"), errors.overall("filtered"))
        for name, errors in made.errors.items()
    ]
    words = " ".join(f"{warning}." for warning in made.warnings)
    record("identify", (kept,) if kept else (), words, rows)


def calibration(done: Calibrated) -> None:
    """Show a calibration: errors by scheme and model."""
    rows = [
        _row({"scheme": s.scheme, "model": s.model}, s.rmsev, s.overall)
        for s in done.made.scores
    ]
    ids = tuple(done.kept.values())
    record("calibrate", ids, " ".join(sentences(done.made)), rows)


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
    record("validate", [id for id, _ in made.values()], "", rows)


def monitoring(id: str, found: Watched, watched: Mapping[str, Recording]) -> None:
    """Show what watching the sensors found: the alarms and the scores.

    Args:
        id: Id of the record.
        found: What was found.
        watched: The watched runs by id.
    """
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


def proposal(page: Path, words: str, diagnosis: str) -> None:
    """Show two models side by side, and where the page of that is.

    Args:
        page: The page.
        words: The same as text.
        diagnosis: Id of the diagnosis of the second.
    """
    create_link_artifact(page.as_uri(), "proposal", key="proposal")
    about = f"diagnosis {diagnosis}"
    create_markdown_artifact(words, key="proposal-words", description=about)


def study(page: Path, words: str, id: str) -> None:
    """Show the figures of a blind study, and where its page is.

    Args:
        page: The page.
        words: Its figures, a line each.
        id: Id of the study.
    """
    create_link_artifact(page.as_uri(), "blind study", key="blind")
    create_markdown_artifact(words, key="blind-figures", description=f"study {id}")


def _row(about: dict, per_joint: np.ndarray, overall: float | None = None) -> dict:
    """Return a row of a table: figures per joint, three digits, null for none."""
    figures = {f"J{j}": _short(v) for j, v in enumerate(per_joint, 1)}
    return about | figures | ({} if overall is None else {"all": _short(overall)})


def _short(value: float) -> float | None:
    return float(f"{value:.3g}") if np.isfinite(value) else None
