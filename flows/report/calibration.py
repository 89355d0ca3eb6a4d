"""A calibration in the terminal and on a page: errors by scheme and model."""

from collections.abc import Sequence

import numpy as np

from flows.report import calibration_charts as figures
from flows.report.document import Chart, Document, Note, ReportTable, Section, Strong
from flows.report.page import render as render_page
from flows.report.words.calibration import sentences
from flows.report.words.phrases import count_noun, sentence_case, texts
from flows.steps.calibrate import StoredCalibration
from residual.calibration.calibrate import Calibration
from residual.calibration.choice import PLSR as LINES
from residual.calibration.rows import PAPER
from residual.calibration.scores import (
    MODELS,
    SCHEMES,
)

_TEXT = texts()["calibration"]


def terminal_parts(outcome: StoredCalibration) -> list[str | ReportTable]:
    """Return a calibration for the terminal: errors, how they are meant, warnings."""
    result = outcome.calibration
    return [
        _errors(result),
        about_rows(result),
        chosen_words(result),
        *sentences(result),
        *(f"note: {n}" for n in result.notes),
        *(f"warning: {w}" for w in outcome.warnings),
    ]


def _errors(result: Calibration) -> ReportTable:
    paper = result.rows.mode == PAPER
    joints = [f"J{j}" for j in result.rows.joints]
    heads = ["RMSEV (RMSEC) [%]", "model", *joints, "all"]
    heads += [f"mean {joint}" for joint in joints] if paper else []
    schemes = [score.scheme for score in result.scores]
    first = [i for i, name in enumerate(schemes) if name not in schemes[:i]]
    rows = []
    for i, score in enumerate(result.scores):
        scheme_errors = [
            each.overall for each in result.scores if each.scheme == score.scheme
        ]
        kind = (
            Strong if score.overall == min(scheme_errors) else str
        )  # the best of its scheme
        cells = [
            kind(f"{_percent(v)} ({_percent(c)})")
            for v, c in zip(score.rmsev, score.rmsec, strict=True)
        ]
        means = [_percent(m) for m in score.mean] if paper else []
        count = "" if score.components is None else f", A = {score.components}"
        start = [
            SCHEMES[score.scheme] if i in first else "",
            MODELS[score.model] + count,
        ]
        rows.append([*start, *cells, kind(_percent(score.overall)), *means])
    return ReportTable(heads, rows, text_columns=(0, 1), sections=first[1:])


def _percent(value: float) -> str:
    return "–" if not np.isfinite(value) else f"{value:.1f}"


def about_rows(result: Calibration) -> str:
    """Return the definitions of X and Y in a sentence."""
    rows = result.rows
    if rows.mode == PAPER:
        joints = ", ".join(map(str, rows.joints))
        pair = (
            f"X: reference of joints {joints} and its derivatives; Y: torque minus "
            "that of the simulated twin, one sample ahead"
        )
    else:
        declared = ", ".join(result.declared) or "nothing"
        pair = (
            "X: measured motion of all joints; Y: torque minus that of a model "
            f"(declared: {declared}) identified without the held-out runs"
        )
    return (
        f"{pair}; {len(rows.X)} rows of {count_noun(len(rows.labels), 'run')}; errors "
        "are in per cent of the measured torque."
    )


def chosen_words(result: Calibration) -> str:
    """Return in a sentence the default form of each joint."""
    forms = []
    for joint, option in zip(result.rows.joints, result.chosen, strict=True):
        form = option.kind
        if form == LINES:
            count = count_noun(option.count, "component")
            form = f"PLSR, {count}" if option.count else "a constant"
        forms.append(f"J{joint} {form}")
    where = "runs" if result.proven else "blocks of the runs (fewer than four runs)"
    return f"Default form, chosen on left-out {where}: {'; '.join(forms)}."


def render(result: Calibration, warnings: Sequence[str] = ()) -> str:
    """Return the page of a calibration."""

    def section(
        id: str, heading: str, charts: Sequence[Chart], *more: ReportTable
    ) -> Section:
        parts = [charts, *more] if charts else ()
        return Section(id, heading, parts, _TEXT.get(id, ""))

    words = sentences(result)
    logs = f"Logs: {', '.join(result.rows.labels)}."
    note = (
        "RMSEV on held-out rows, RMSEC in brackets on fitted rows, per cent of the "
        "measured torque, pooled over folds"
    )
    if result.rows.mode == PAPER:
        note += "; the mean over subsets, as in the paper, in the last columns"
    note = f"{note}. {_TEXT['newness']}"
    below = Note(
        f"{sentence_case(chosen_words(result))} {_TEXT['flatters']}", "soft spaced"
    )
    loadings = [
        (
            block.family.replace("_", " "),
            block.block,
            str(block.pca.real),
            ", ".join(f"{name} {value:+.2f}" for name, value in block.pca.strongest(0)),
        )
        for block in result.blocks
    ]
    heads = ("Motion", "Block", "Real components", "Largest loadings of the first")
    table = ReportTable(heads, loadings, text_columns=(0, 1, 3))
    pca, over_time = figures.components(result), figures.over_time(result)
    return render_page(
        Document(
            title=f"modelgap calibration: {result.robot}",
            about=f"modelgap calibration of {result.robot}",
            headline=words[0] if words else "A data-driven correction",
            lead=[*words[1:], about_rows(result), logs],
            warnings=warnings,
            sections=(
                Section("table", "Models and schemes", [_errors(result), below], note),
                section("bars", "Errors as bars (figure 10)", figures.bars(result)),
                section("time", "Corrections over time (figure 9)", over_time),
                section("pca", "Principal components (figures 4 to 6)", pca, table),
                section("curves", "Components (figure 8)", figures.curves(result)),
                section("levels", "Levels (figure 12)", figures.levels(result)),
                Section("read", "How to read this page", [texts()["read_calibration"]]),
                Section("notes", "Notes", [result.notes]),
            ),
        )
    )
