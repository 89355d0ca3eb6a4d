"""The verdict as one HTML page that needs nothing else: to mail, print and keep."""

from typing import Any

from flows.report.page import charts
from flows.report.page.base import Tile, environment
from flows.report.words import given, outlook, rows
from flows.report.words import next as following
from flows.report.words import verdict as words
from flows.report.words.edit import baseline_sentences
from flows.report.words.phrases import sentence_case
from flows.report.words.sets import other_sets
from flows.report.words.staged import Staged
from flows.report.words.verdict import sentences
from residual import quantity
from residual.diagnosis.result import STAGES, Diagnosis, Verdict
from residual.quantity import known


def render(
    found: Diagnosis,
    robot_name: str,
    staged: Staged | None = None,
    motion: charts.Chart | None = None,
) -> str:
    """Return the report page.

    Args:
        found: The diagnosis.
        robot_name: Robot as the reader calls it.
        staged: Picture and truth of an experiment of our own.
        motion: Picture of the motion that is proposed.

    Returns:
        One self-contained HTML document; the same diagnosis gives the same bytes.
    """
    page = environment().get_template("page.html")
    context = _context(found, robot_name)
    return page.render(context, staged=staged, motion=motion)


def _context(found: Diagnosis, robot_name: str) -> dict[str, Any]:
    verdict = found.verdict
    named = rows.findings(found)
    clouds, clouds_left = charts.cloud_charts(found)
    focus, others, curves_left = charts.curve_charts(found)
    heads, sizes = outlook.detectable_rows(verdict)
    return {
        "robot": robot_name,
        "headline": words.sentences(verdict)[0],
        "lead": words.sentences(verdict)[1:],
        "setting": _setting(verdict),
        "same_run": verdict.error.same_run,
        "cutoff": quantity.number(verdict.error.cutoff_hz),
        "tiles": _tiles(verdict, named),
        "findings": [(f, charts.clouds_of(clouds, f)) for f in named],
        "edits": baseline_sentences(verdict),
        "has_p": any(f.p_value != quantity.MISSING for f in named),
        "has_clouds": bool(clouds),
        "clouds_left": clouds_left,
        "other_sets": other_sets(verdict),
        "given": given.off_rows(verdict),
        "given_more": given.hidden_rows(verdict),
        "bars": charts.error_charts(found),
        "errors": _error_table(found),
        "worse": words.rising(verdict),
        "focus": focus,
        "others": others,
        "curves_left": curves_left,
        "unexplained": outlook.unexplained_words(verdict),
        "left_charts": charts.left_charts(found),
        "size_heads": heads,
        "sizes": sizes,
        "confusable": outlook.confusable_words(verdict),
        "confusable_pairs": outlook.confusable_pairs(verdict),
        "never": any(outlook.NEVER in row for row in sizes) and outlook.NEVER,
        "warnings": verdict.warnings,
        "plan": following.next_words(verdict),
        "notes": found.notes,
    }


def _setting(verdict: Verdict) -> str:
    """Return under which assumptions and on which logs the verdict was reached."""
    declared = ", ".join(verdict.declared)
    parts = [f"Declared in the model: {declared or 'rigid body only'}."]
    if verdict.error.logs:
        parts.append(f"Held out: {', '.join(verdict.error.logs)}.")
    if known(verdict.nominal_scale):
        scale = f"{100 * verdict.nominal_scale:.3g} %"
        parts.append(f"Assumed spread of the nominal parameters: {scale}.")
    return " ".join(parts)


def _tiles(verdict: Verdict, named: list[rows.FindingRow]) -> list[Tile]:
    """Return up to five figures that say how sure the verdict is."""
    tiles = _finding_tiles(named)
    change = words.change(verdict) if named else None
    if change:
        fall = f"{change.before:.1f} → {quantity.percent(change.after)}"
        where = change.where.removesuffix(",").removeprefix("on ")
        tiles.append(Tile("Held-out error", fall, f"{where}, refit → augmented"))
    if not named:
        level = quantity.percent(verdict.error.overall_filtered.get("identified"))
        tiles.append(Tile("Held-out error", level, "all joints, refitted"))
    left = verdict.unexplained
    if known(left.fraction):
        note = "of the torque"
        if known(left.noise_floor):
            note += f"; noise alone is {quantity.fraction(left.noise_floor)}"
        tiles.append(Tile("Unexplained", quantity.fraction(left.fraction), note))
    return tiles


def _finding_tiles(found: list[rows.FindingRow]) -> list[Tile]:
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


def _error_table(found: Diagnosis) -> dict[str, Any]:
    lines = rows.error_rows(found)
    groups = [
        (metric, name, [s for s in STAGES if rows.has(lines, metric, s)])
        for metric, name in rows.METRICS.items()
    ]
    return {
        "groups": [group for group in groups if group[2]],
        "rows": lines,
        "share": any(known(line.unexplained) for line in lines),
    }


def summary(found: Diagnosis) -> str:
    """Return the headline, the effects, and the errors before and after, escaped."""
    errors = found.errors
    rows = [
        (name, values, errors.overall_filtered[name])
        for name, values in errors.filtered.items()
        if values is not None
    ]
    return (
        environment()
        .get_template("summary.html")
        .render(
            headline=sentences(found.verdict)[0],
            effects=found.effects,
            logs=errors.logs,
            joints=range(1, found.verdict.dof + 1),
            errors=rows,
            warnings=found.warnings,
        )
    )
