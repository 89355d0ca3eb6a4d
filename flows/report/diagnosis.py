"""A diagnosis in the terminal and on a page: the verdict first, then what is behind.

The page is one HTML document that needs nothing else: to mail, print and keep.
"""

from collections.abc import Iterator, Sequence
from typing import Any

from rich.console import Console

from flows.report import charts
from flows.report.console import line, show
from flows.report.document import Chart, Strong, Table, Tile
from flows.report.page import Origin, environment
from flows.report.words import outlook
from flows.report.words import rows as tables
from flows.report.words import verdict as words
from flows.report.words.outlook import other_sets
from flows.report.words.phrases import (
    Staged,
    baseline_sentences,
    joint_words,
    sentence_case,
)
from flows.report.words.rows import (
    METRICS,
    ErrorRow,
    FindingRow,
    means,
    missing_torque,
    size_of,
    sure,
)
from flows.report.words.verdict import headline, rising, sentences
from residual import quantity
from residual.diagnosis.result import PLAIN, STAGES, Diagnosis, Verdict
from residual.quantity import bare_percent, known, probability


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
    name, value = size_of(found.effects[0], found.verdict)
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
        "headline": sentences(verdict)[0],
        "lead": sentences(verdict)[1:],
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
        "worse": rising(found.verdict),
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
    lines = tables.error_rows(found)
    groups = [
        (metric, name, [s for s in _shown(metric) if tables.has(lines, metric, s)])
        for metric, name in tables.METRICS.items()
    ]
    return {
        "groups": [group for group in groups if group[2]],
        "rows": lines,
        "share": any(known(line.unexplained) for line in lines),
    }


def _shown(metric: str) -> tuple[str, ...]:
    """Models of a table's columns; the reference stands beside the leading one."""
    return (*STAGES, PLAIN) if metric == next(iter(tables.METRICS)) else STAGES


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


# Broken by hand, so that eighty columns hold all of them.
_HEADS = {"identified": "identi-\nfied", "augmented": "aug-\nmented"}
_PAIR = 12  # characters of an error before and after
_NARROW = 26


def print_diagnosis(found: Diagnosis, console: Console, verbose: bool = False) -> None:
    """Print a diagnosis: verdict, findings, errors, what is left, what to do next.

    Args:
        console: Where to print; 80 columns and no colour are enough.
        verbose: List the effects that these logs could not tell apart.
    """
    line(console, "")
    line(console, headline(found.verdict), "bold")
    for section in (_findings, _given, _errors, _left_over, _detectable):
        show(console, *section(found), wrapped=True)
    for number, warning in enumerate(found.warnings):
        line(console, f"{'' if number else chr(10)}Warning: {warning}", "yellow")
    plan = outlook.next_words(found.verdict)
    if plan:
        line(console, "\nNext experiment:", "bold")
    show(console, *(f"  {sentence}" for sentence in plan), wrapped=True)
    if verbose and not found.effects:
        pairs = outlook.confusable_pairs(found.verdict)
        show(console, *(f"  look alike: {pair}" for pair in pairs), wrapped=True)
    line(console, "")


def print_truth(staged: Staged, console: Console) -> None:
    """Print what was hidden beside what was found."""
    title, heads = (
        "The seal, opened after the verdict was stored",
        ("", "hidden", "found"),
    )
    table = Table(heads, staged.rows, title, left=range(3))
    forms = [staged.forms] if staged.forms else []
    show(console, table, staged.judged, *staged.edits, *forms, wrapped=True)


def _findings(found: Diagnosis) -> Iterator[str | Table]:
    named = tables.findings(found)
    if named:
        sizes = [tables.parameter_lines(one, _NARROW) for one in named]
        rows = [
            (one.order, _effect_cell(one), "\n".join(size), _evidence_cell(one))
            for one, size in zip(named, sizes, strict=True)
        ]
        # Short cells keep their width, so that no verdict is cut at 80 columns.
        widths = [len(line) for size in sizes for line in size]
        least = {2: max(widths, default=0), 3: len("held-out: confirmed")}
        heads = ("", "effect", "parameters", "evidence")
        yield Table(heads, rows, "What is missing", left=range(4), least=least)
        yield from other_sets(found.verdict)
    yield from baseline_sentences(found.verdict)


def _effect_cell(finding: FindingRow) -> str:
    same = " or ".join(finding.alternatives)
    tail = f"\nor {same}: these data cannot tell" if same else ""
    return Strong(finding.title + tail)


def _evidence_cell(finding: FindingRow) -> str:
    lines = [f"{finding.nats} nats"]
    if finding.by:
        lines.append(f"by {finding.by}")
    if known(finding.probability):
        lines.append(f"this name: {probability(finding.probability)}")
    lines.append(f"held-out: {finding.verdict}")
    if finding.splits:
        lines.append(f"found again: {finding.splits}")
    return "\n".join(lines)


def _given(found: Diagnosis) -> Iterator[str | Table]:
    rows = outlook.off_rows(found.verdict)
    if rows:
        heads = ("value", "as given", "as the logs have it", "")
        title = "Given values that the logs do not bear out"
        yield Table(heads, rows, title, left=range(4))
    if more := outlook.hidden_rows(found.verdict):
        yield f"and {more} more: 'changes' in the JSON has all of them."


def _errors(found: Diagnosis) -> Iterator[str | Table]:
    lines = tables.error_rows(found)
    columns = _error_columns(lines)
    if not columns:
        return
    share = any(known(row.unexplained) for row in lines)
    heads = ["joint", *(head for head, _, _ in columns)]
    heads += ["unex-\nplained"] if share else []
    rows = []
    for row in lines:
        cells = [_error_cell(row, metric, stages) for _, metric, stages in columns]
        flag = " !" if row.flagged else "  "
        rest = [bare_percent(row.unexplained) + flag] if share else []
        rows.append([row.label, *cells, *rest])
    pairs = [i for i, (_, _, stages) in enumerate(columns, 1) if len(stages) > 1]
    title = _error_title(found, columns[0][1])
    yield Table(heads, rows, title, least=dict.fromkeys(pairs, _PAIR))
    if pairs:
        yield "Arrows: identified (refit without the findings) → augmented."
    worse = rising(found.verdict)
    if worse:
        yield f"Worse with the findings: {', '.join(worse)} (moving)."


def _error_columns(lines: Sequence[ErrorRow]) -> list[tuple]:
    """Return (heading, metric, stages): stages in full for the first metric known."""
    metrics = [metric for metric in METRICS if _any(lines, metric)]
    if not metrics:
        return []
    # Two are as many as eighty columns hold; the page and the JSON have the third.
    first, *others = metrics[:2]
    shown = [s for s in STAGES if tables.has(lines, first, s)]
    columns = [(_HEADS.get(s, s), first, (s,)) for s in shown]
    if tables.has(lines, first, PLAIN):
        columns.append(("least\nsquares", first, (PLAIN,)))
    pair = ("identified", "augmented")
    return columns + [(METRICS[metric], metric, pair) for metric in others]


def _any(lines: Sequence[ErrorRow], metric: str) -> bool:
    return any(tables.has(lines, metric, s) for s in ("nominal", "identified"))


def _error_cell(row: ErrorRow, metric: str, stages: Sequence[str]) -> str:
    values = [row.values[metric].get(stage) for stage in stages]
    shown = [bare_percent(value) for value in values]
    if len(shown) == 1:
        return Strong(shown[0]) if stages == ("augmented",) else shown[0]
    return f"{shown[0]} → {shown[1]:>5}" if any(map(known, values)) else ""


def _error_title(found: Diagnosis, metric: str) -> str:
    where = f" on {', '.join(found.errors.logs)}" if found.errors.logs else ""
    weak = " (the same run: a weak proof)" if found.errors.same_run else ""
    return f"Held-out error{where}{weak}, {METRICS[metric]}, % of torque"


def _left_over(found: Diagnosis) -> Iterator[str]:
    sentences = outlook.unexplained_words(found.verdict)
    if sentences:
        yield "\n" + " ".join(sentences)


def _detectable(found: Diagnosis) -> Iterator[str | Table]:
    heads, rows = outlook.detectable_rows(found.verdict, short=True)
    if found.effects or not rows:
        return
    # The longest word of a name, so that none is broken.
    least = max(len(word) for row in rows for word in row[0].split())
    title = "Smallest size that would have been found"
    yield Table(heads, rows, title, left=(0, 1), least={0: least})
    if any(outlook.NEVER in row for row in rows):
        yield f"{outlook.NEVER}: not detectable here; no arm has so much."
    alike = outlook.confusable_words(found.verdict)
    if alike:
        yield f"{alike} --verbose lists them."
