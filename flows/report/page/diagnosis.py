"""The verdict as one HTML page that needs nothing else: to mail, print and keep."""

from typing import Any

from flows.report.made import Origin
from flows.report.page import charts
from flows.report.page.base import Tile, environment
from flows.report.page.chart import Chart
from flows.report.words import outlook, rows
from flows.report.words import verdict as words
from flows.report.words.outlook import other_sets
from flows.report.words.phrases import joint_words, sentence_case
from flows.report.words.rows import FindingRow, means, missing_torque, size_of, sure
from flows.report.words.staged import Staged, baseline_sentences
from flows.report.words.verdict import sentences
from residual import quantity
from residual.diagnosis.result import PLAIN, STAGES, Diagnosis, Verdict
from residual.quantity import known


def tiles_of(found: Diagnosis, named: list[FindingRow]) -> list[Tile]:
    """Return up to five figures that say what is missing, and what naming it gains."""
    return [
        *(_one_size(found, named) if len(named) == 1 else _count(named)),
        *_torque(found, named),
        *_error(found, named),
        *_sure(named),
        *_left(found),
    ]


def _one_size(found: Diagnosis, named: list[FindingRow]) -> list[Tile]:
    name, value = size_of(found.effects[0])
    return [Tile(sentence_case(name), value, f"of {named[0].title}")] if name else []


def _count(named: list[FindingRow]) -> list[Tile]:
    if not named:
        return []
    confirmed = sum(one.verdict == "confirmed" for one in named)
    note = f"{confirmed} of them confirmed on unseen motion"
    return [Tile("Effects found", str(len(named)), note)]


def _torque(found: Diagnosis, named: list[FindingRow]) -> list[Tile]:
    """What the robot's controller does not know: the most that a model lacks."""
    lacking = [(m, row) for row in named for m in missing_torque(found, row)]
    if not lacking:
        return []
    most, row = max(lacking, key=lambda pair: pair[0].share or 0.0)
    note = joint_words([most.joint])
    if most.share:
        note += f": {quantity.fraction(most.share)} of the largest torque there"
    if len(named) > 1:
        note += f", from {row.noun}"
    value = f"up to {quantity.number(most.peak)} N m"
    return [Tile("Torque that the model lacks", value, note)]


def _error(found: Diagnosis, named: list[FindingRow]) -> list[Tile]:
    label = "Error on unseen motion"
    change = words.change(found.verdict) if named else None
    if change:
        fall = f"{change.before:.1f} → {quantity.percent(change.after)}"
        where = change.where.removesuffix(",")
        return [Tile(label, fall, f"of the torque {where}, before → after")]
    if named:
        return []
    level, where = words.level(found.errors)
    note = f"of the torque {where}, refitted"
    return [Tile(label, quantity.percent(level), note)]


def _sure(named: list[FindingRow]) -> list[Tile]:
    if not named:
        return []
    if len(named) == 1:
        one = named[0]
        other = f", or {' or '.join(one.alternatives)}" if one.alternatives else ""
        note = f"that it is {one.noun}{other}; {one.held_out}"
        return [Tile("How sure", sure(one.probability), note)]
    likely = [one.probability for one in named if known(one.probability)]
    weakest = sure(min(likely, default=None))
    return [Tile("How sure", weakest, "of the least certain name, against all others")]


def _left(found: Diagnosis) -> list[Tile]:
    left = found.unexplained
    if not known(left.fraction):
        return []
    note = "of the torque"
    if known(left.noise_floor):
        note += f"; noise alone is {quantity.fraction(left.noise_floor)}"
    return [Tile("Still unexplained", quantity.fraction(left.fraction), note)]


def render(
    found: Diagnosis,
    robot_name: str,
    staged: Staged | None = None,
    motion: Chart | None = None,
    origin: Origin | None = None,
) -> str:
    """Return the report page.

    Args:
        origin: Where it comes from, and what makes the page again.

    Returns:
        One self-contained HTML document; the same diagnosis gives the same bytes.
    """
    page = environment().get_template("page.html")
    context = _context(found, robot_name)
    return page.render(context, staged=staged, motion=motion, origin=origin)


def _context(found: Diagnosis, robot_name: str) -> dict[str, Any]:
    verdict = found.verdict
    named = charts.finding_charts(found)
    findings = [row for row, _ in named]
    return {
        "robot": robot_name,
        "headline": words.sentences(verdict)[0],
        "lead": words.sentences(verdict)[1:],
        "setting": _setting(verdict),
        "same_run": verdict.error.same_run,
        "cutoff": quantity.number(verdict.error.cutoff_hz),
        "tiles": tiles_of(found, findings),
        "findings": [(row, means(found, row), shown) for row, shown in named],
        "has_p": any(f.p_value != quantity.MISSING for f in findings),
        "has_splits": any(f.splits for f in findings),
        "has_clouds": any(shown for _, shown in named),
        "given": outlook.off_rows(verdict),
        "given_more": outlook.hidden_rows(verdict),
        "changes": outlook.all_rows(verdict),
        "edits": baseline_sentences(verdict),
        "warnings": verdict.warnings,
        "notes": found.notes,
        **_proof(found),
        **_open(found),
    }


def _proof(found: Diagnosis) -> dict[str, Any]:
    """What shows that the model is better: errors, curves, spectra."""
    motions, undrawn = charts.motions(found)
    spectra, spectra_others = charts.spectrum_charts(found)
    return {
        "bars": charts.error_charts(found),
        "errors": _error_table(found),
        "worse": words.rising(found.verdict),
        "motions": motions,
        "undrawn": undrawn,
        "spectra": spectra,
        "spectra_others": spectra_others,
    }


def _open(found: Diagnosis) -> dict[str, Any]:
    """What stays open: other names, the next motion, the rest, what is too small."""
    verdict = found.verdict
    heads, sizes = outlook.detectable_rows(verdict)
    return {
        "other_sets": other_sets(verdict),
        "plan": outlook.next_words(verdict),
        "unexplained": outlook.unexplained_words(verdict),
        "left_charts": charts.left_charts(found),
        "size_heads": heads,
        "sizes": sizes,
        "confusable": outlook.confusable_words(verdict),
        "confusable_pairs": outlook.confusable_pairs(verdict),
        "never": any(outlook.NEVER in row for row in sizes) and outlook.NEVER,
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


def _error_table(found: Diagnosis) -> dict[str, Any]:
    lines = rows.error_rows(found)
    groups = [
        (metric, name, [s for s in _shown(metric) if rows.has(lines, metric, s)])
        for metric, name in rows.METRICS.items()
    ]
    return {
        "groups": [group for group in groups if group[2]],
        "rows": lines,
        "share": any(known(line.unexplained) for line in lines),
    }


def _shown(metric: str) -> tuple[str, ...]:
    """Models of a table's columns; the reference stands beside the leading one."""
    return (*STAGES, PLAIN) if metric == next(iter(rows.METRICS)) else STAGES


def summary(found: Diagnosis) -> str:
    """Return the headline, the effects, and the errors before and after, escaped."""
    errors = found.errors
    rows = [
        (name, values, errors.overall_moving.get(name))
        for name, values in errors.moving.items()
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
