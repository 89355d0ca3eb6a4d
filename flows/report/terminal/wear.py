"""Wear and warming up as text."""

from collections.abc import Sequence

from rich.box import SIMPLE_HEAD
from rich.table import Table

from flows.steps.loop.wear import Wear
from residual.monitoring.wear import JointTrend, Rate


def table_of(wear: Wear) -> Table:
    """Return what each joint's friction does, a row each."""
    heads = ("joint", "logs", "wear per 30 days", "cold to warm", "")
    table = Table(*heads, box=SIMPLE_HEAD, pad_edge=False)
    for one in wear.joints:
        cells = (_rate(one.wear), _rate(one.warming))
        table.add_row(str(one.joint), str(one.logs), *cells, one.why)
    table.caption = "in brackets: where it lies with 95 %; * told from none"
    return table


def sentence(wear: Wear) -> str:
    """Return what was found, in a sentence."""
    said = [
        *_said(wear.joints, "wear", "wear per 30 days on"),
        *_said(wear.joints, "warming", f"warming up (in {_spell(wear.time)}) on"),
    ]
    if said:
        return f"{wear.robot}: " + "; ".join(said)
    if all(one.why for one in wear.joints):
        return f"{wear.robot}: these runs cannot tell wear from warming up"
    return f"{wear.robot}: neither wear nor warming up stands out"


def _said(joints: Sequence[JointTrend], name: str, what: str) -> list[str]:
    real = [
        (one.joint, getattr(one, name))
        for one in joints
        if getattr(one, name) is not None and getattr(one, name).real
    ]
    if not real:
        return []
    each = ", ".join(f"joint {j}: {100 * rate.value:+.0f} %" for j, rate in real)
    return [f"{what} {each}"]


def _rate(rate: Rate | None) -> str:
    if rate is None:
        return "–"
    low, high = 100 * rate.low, 100 * rate.high
    mark = " *" if rate.real else ""
    return f"{100 * rate.value:+.1f} % ({low:+.1f} to {high:+.1f}){mark}"


def _spell(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.0f} min"
