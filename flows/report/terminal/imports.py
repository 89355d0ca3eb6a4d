"""What was understood of a log, for people."""

from rich.box import SIMPLE_HEAD
from rich.table import Table

from flows.steps.imports import Log
from residual.robot.robot import Robot
from warehouse.logs.columns import shorten


def table(log: Log) -> Table:
    """Return a table: which column became which channel, and what was done to it."""
    out = Table(box=SIMPLE_HEAD, pad_edge=False)
    for title in ("channel", "column", "unit of the file", "done to it"):
        out.add_column(title)
    for channel, column, unit, done in log.known.channels:
        out.add_row(channel, _escaped(column), unit, done or "–")
    return out


def lines(log: Log, robot: Robot, all: bool) -> list[str]:
    """Return what was understood, one line each."""
    known = log.known
    if not all:
        return [known.text, *(f"warning: {w}" for w in known.warnings)]
    names = tuple(robot.model.names)[1:]
    joints = ", ".join(f"{i} {name}" for i, name in enumerate(names, 1))
    gaps = [w for w in known.warnings if "gap(s)" in w]
    window = f", window @{known.window}" if known.window else ""
    return [
        f"log: {known.file}{window}",
        f"robot: {robot.name}, {robot.dof} joints: {joints}",
        f"rows: {known.rows}, {known.rate:.6g} Hz, {known.duration:.6g} s, from "
        f"t = {log.recording.t[0]:.9g} s",
        *([] if gaps else ["gaps: none"]),
        *(f"warning: {warning}" for warning in known.warnings),
        *(f"file: {note}" for note in known.notes),
        f"recorded: {log.manifest['recorded_at'] or 'unknown; see --recorded-at'}",
        f"serial number: {log.manifest['serial'] or 'none'}, "
        f"tags: {' '.join(log.manifest['tags']) or 'none'}",
        f"ignored columns: {shorten(known.ignored) or 'none'}",
        f"run id: {log.run_id}, {'in the store already' if log.stored else 'new'}; "
        "a dry run stores nothing",
    ]


def _escaped(text: str) -> str:
    return text.replace("[", "\\[")
