"""The state of a service in the terminal."""

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from flows.say import say
from flows.service.status import Status


def print_status(found: Status, store: Path) -> None:
    """Print what runs, what is due, and what ran last.

    Args:
        found: The state.
        store: The store that it is of.
    """
    console = Console()
    if not console.is_terminal:
        console = Console(width=200)
    running = found.running
    if running is None:
        say(console, f"{store}: nothing runs")
        return
    word = "answers" if found.server else "does not answer"
    lines = [f"server   {word}: {running.ui} (history: {running.database})"]
    lines += [f"{name:8} {state}" for name, state in (found.workers or {}).items()]
    say(console, *lines)
    if found.deployments:
        rows = [(d["name"], _due(d)) for d in found.deployments]
        console.print(_table(("deployment", "due next (UTC)"), rows))
    if found.runs:
        rows = [_run(run) for run in found.runs]
        console.print(_table(("flow run", "state", "begun (UTC)", "time [s]"), rows))


def _due(deployment: Mapping) -> str:
    if deployment["paused"]:
        return "paused"
    if deployment["due"]:
        left = (deployment["due"] - datetime.now(UTC)).total_seconds()
        when = deployment["due"].astimezone(UTC).isoformat(" ", "seconds")[:19]
        return f"{when}, in {_span(left)}"
    if deployment["schedules"]:
        return "soon known"
    return "on an event, or by hand"


def _span(seconds: float) -> str:
    if seconds < 0:
        return "no time: late"
    for unit, length in (("d", 86400), ("h", 3600), ("min", 60)):
        if seconds >= 2 * length:
            return f"{seconds / length:.0f} {unit}"
    return f"{seconds:.0f} s"


def _run(run: Mapping) -> tuple[str, str, str, str]:
    begun = (run["start_time"] or "–")[:19].replace("T", " ")
    return run["name"], run["state"], begun, f"{run['total_run_time']:.1f}"


def _table(titles: Sequence[str], rows: Sequence[Sequence[str]]) -> Table:
    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    for title in titles:
        right = title.endswith("[s]")
        table.add_column(title.replace("[", "\\["), justify="right" if right else None)
    for row in rows:
        table.add_row(*(cell.replace("[", "\\[") for cell in row))
    return table
