"""The verdict as one HTML page that needs nothing else: to mail, print and keep."""

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from flows.report.page import charts
from flows.report.words import outlook, quantity, rows
from flows.report.words import verdict as words
from flows.report.words.phrases import sentence_case
from flows.report.words.quantity import as_list, dig, known, texts
from flows.report.words.staged import Staged
from residual.diagnosis.result import Outcome

_TEMPLATES = Path(__file__).parent / "templates"


class Tile(NamedTuple):
    """One figure at the head of the page: what it is, its value, what it means."""

    label: str
    value: str
    note: str


def render(outcome: Outcome, robot_name: str, staged: Staged | None = None) -> str:
    """Return the report page.

    Args:
        outcome: The diagnosis.
        robot_name: Robot as the reader calls it.
        staged: Picture and truth of an experiment of our own.

    Returns:
        One self-contained HTML document; the same outcome gives the same bytes.
    """
    page = _environment().get_template("page.html")
    return page.render(_context(outcome, robot_name), staged=staged)


@cache
def _environment() -> Environment:
    # Everything is escaped: names of logs and columns come from other people's files.
    environment = Environment(
        loader=FileSystemLoader(_TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {
        "percent": quantity.percent,
        "bare": quantity.bare_percent,
        "probability": quantity.probability,
        "sentence": sentence_case,
    }
    environment.tests["known"] = known
    return environment


def _context(outcome: Outcome, robot_name: str) -> dict[str, Any]:
    verdict = outcome.verdict
    found = rows.findings(outcome)
    clouds, clouds_left = charts.cloud_charts(outcome)
    focus, others, curves_left = charts.curve_charts(outcome)
    heads, sizes = outlook.detectable_rows(outcome)
    return {
        "robot": robot_name,
        "headline": words.sentences(verdict)[0],
        "lead": words.sentences(verdict)[1:],
        "verdict": verdict,
        "setting": _setting(verdict),
        "same_run": dig(verdict, "error", "same_run") is True,
        "cutoff": quantity.number(dig(verdict, "error", "filter", "cutoff_hz")),
        "tiles": _tiles(outcome, found),
        "findings": [(f, charts.clouds_of(clouds, f)) for f in found],
        "has_p": any(f.p_value != quantity.MISSING for f in found),
        "has_clouds": bool(clouds),
        "clouds_left": clouds_left,
        "bars": charts.error_charts(outcome),
        "errors": _error_table(outcome),
        "worse": words.rising(verdict),
        "focus": focus,
        "others": others,
        "curves_left": curves_left,
        "unexplained": outlook.unexplained_words(verdict),
        "left_charts": charts.left_charts(outcome),
        "size_heads": heads,
        "sizes": sizes,
        "confusable": outlook.confusable_words(verdict),
        "warnings": texts(verdict.get("warnings")),
        "plan": outlook.next_words(verdict.get("next_experiment")),
        "notes": outcome.notes,
    }


def _setting(verdict: Mapping) -> str:
    """Return under which assumptions and on which logs the verdict was reached."""
    declared = ", ".join(texts(verdict.get("declared")))
    parts = [f"Declared in the model: {declared or 'rigid body only'}."]
    logs = ", ".join(texts(dig(verdict, "error", "logs")))
    if logs:
        parts.append(f"Held out: {logs}.")
    if known(verdict.get("nominal_scale")):
        scale = f"{100 * verdict['nominal_scale']:.3g} %"
        parts.append(f"Assumed spread of the nominal parameters: {scale}.")
    return " ".join(parts)


def _tiles(outcome: Outcome, found: list) -> list[Tile]:
    """Return up to five figures that say how sure the verdict is."""
    tiles = _finding_tiles(found)
    change = words.change(outcome.verdict) if found else None
    if change:
        fall = f"{change.before:.1f} → {quantity.percent(change.after)}"
        where = change.where.removesuffix(",").removeprefix("on ")
        tiles.append(Tile("Held-out error", fall, f"{where}, refit → augmented"))
    if not found:
        tiles.append(_level_tile(outcome.verdict))
    left = dig(outcome.verdict, "unexplained", "fraction")
    if known(left):
        floors = as_list(dig(outcome.verdict, "unexplained", "noise_floor"))
        floors = [floor for floor in floors if known(floor)]
        note = "of the torque"
        if floors:
            note += f"; noise alone is {quantity.fraction(max(floors))}"
        tiles.append(Tile("Unexplained", quantity.fraction(left), note))
    return tiles


def _finding_tiles(found: list) -> list[Tile]:
    if not found:
        return []
    if len(found) == 1:
        one = found[0]
        sure = quantity.probability(one.probability)
        return [
            Tile("Probability", sure, "of this class against all others"),
            Tile("Evidence", f"{one.nats} nats", f"by {one.by}" if one.by else ""),
            Tile("Held-out motion", sentence_case(one.verdict), ""),
        ]
    confirmed = sum(one.verdict == "confirmed" for one in found)
    likely = [one.probability for one in found if known(one.probability)]
    weakest = quantity.probability(min(likely, default=None))
    return [
        Tile("Findings", str(len(found)), f"{confirmed} confirmed on held-out motion"),
        Tile("Weakest probability", weakest, "of a class against all others"),
    ]


def _level_tile(verdict: Mapping) -> Tile:
    level = dig(verdict, "error", "overall_filtered", "identified")
    return Tile("Held-out error", quantity.percent(level), "all joints, refitted")


def _error_table(outcome: Outcome) -> dict[str, Any]:
    lines = rows.error_rows(outcome)
    groups = [
        (metric, name, [s for s in rows.STAGES if rows.has(lines, metric, s)])
        for metric, name in rows.METRICS.items()
    ]
    return {
        "groups": [group for group in groups if group[2]],
        "rows": lines,
        "share": any(known(line.unexplained) for line in lines),
    }
