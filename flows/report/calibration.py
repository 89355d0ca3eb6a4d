"""A calibration in the terminal and on a page: errors by scheme and model."""

from collections.abc import Sequence

import numpy as np

from flows.report import calibration_charts as figures
from flows.report.document import Chart, Document, Note, Section, Strong, Table, Tile
from flows.report.page import render as render_page
from flows.report.words.calibration import sentences
from flows.report.words.phrases import many, sentence_case, texts
from flows.steps.calibrate import StoredCalibration
from residual.calibration.calibrate import Calibration
from residual.calibration.choice import PLSR as LINES
from residual.calibration.rows import PAPER
from residual.calibration.scores import (
    DEFAULT,
    LS,
    MODELS,
    NOTHING,
    PAPER_FORM,
    RANDOM,
    RUN,
    SCHEMES,
    find,
)

_TEXT = texts()["calibration"]

_TILES = (
    (RANDOM, PAPER_FORM, "Paper form, random rows"),
    (RUN, PAPER_FORM, "Paper form, unseen runs"),
    (RUN, LS, "LS, unseen runs"),
    (RUN, DEFAULT, "Default form, unseen runs"),
)


def told(outcome: StoredCalibration) -> list[str | Table]:
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


def _errors(result: Calibration) -> Table:
    paper = result.rows.mode == PAPER
    joints = [f"J{j}" for j in result.rows.joints]
    heads = ["RMSEV (RMSEC) [%]", "model", *joints, "all"]
    heads += [f"mean {joint}" for joint in joints] if paper else []
    schemes = [one.scheme for one in result.scores]
    first = [i for i, name in enumerate(schemes) if name not in schemes[:i]]
    rows = []
    for i, one in enumerate(result.scores):
        same = [other.overall for other in result.scores if other.scheme == one.scheme]
        kind = Strong if one.overall == min(same) else str  # the best of its scheme
        cells = [
            kind(f"{_percent(v)} ({_percent(c)})")
            for v, c in zip(one.rmsev, one.rmsec, strict=True)
        ]
        means = [_percent(m) for m in one.mean] if paper else []
        count = "" if one.components is None else f", A = {one.components}"
        start = [SCHEMES[one.scheme] if i in first else "", MODELS[one.model] + count]
        rows.append([*start, *cells, kind(_percent(one.overall)), *means])
    return Table(heads, rows, left=(0, 1), sections=first[1:])


def _percent(value: float) -> str:
    return "–" if not np.isfinite(value) else f"{value:.1f}"


def about_rows(result: Calibration) -> str:
    """Return in a sentence what X and Y are, so that the errors can be read."""
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
        f"{pair}; {len(rows.X)} rows of {many(len(rows.labels), 'run')}; errors are in "
        "per cent of the measured torque."
    )


def chosen_words(result: Calibration) -> str:
    """Return in a sentence the default form of each joint."""
    forms = []
    for joint, option in zip(result.rows.joints, result.chosen, strict=True):
        form = option.kind
        if form == LINES:
            count = many(option.count, "component")
            form = f"PLSR, {count}" if option.count else "a constant"
        forms.append(f"J{joint} {form}")
    where = "runs" if result.proven else "blocks of the runs (fewer than four runs)"
    return f"Default form, chosen on left-out {where}: {'; '.join(forms)}."


def render(result: Calibration, warnings: Sequence[str] = ()) -> str:
    """Return the page of a calibration."""

    def section(
        id: str, heading: str, charts: Sequence[Chart], *more: Table
    ) -> Section:
        parts = [charts, *more] if charts else ()
        return Section(id, heading, parts, _TEXT.get(id, ""))

    words = sentences(result)
    tiles = []
    for scheme, model, label in _TILES:
        one, none = (find(result.scores, scheme, m) for m in (model, NOTHING))
        if one is not None and none is not None:
            note = f"of the torque; no compensation {none.overall:.3g} %"
            tiles.append(Tile(label, f"{one.overall:.3g} %", note))
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
            one.family.replace("_", " "),
            one.block,
            str(one.pca.real),
            ", ".join(f"{name} {value:+.2f}" for name, value in one.pca.strongest(0)),
        )
        for one in result.blocks
    ]
    heads = ("Motion", "Block", "Real components", "Largest loadings of the first")
    table = Table(heads, loadings, left=(0, 1, 3))
    pca, over_time = figures.components(result), figures.over_time(result)
    return render_page(
        Document(
            title=f"modelgap calibration: {result.robot}",
            about=f"modelgap calibration of {result.robot}",
            headline=words[0] if words else "A data-driven correction",
            lead=words[1:],
            tiles=tiles,
            setting=f"{about_rows(result)} Logs: {', '.join(result.rows.labels)}.",
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
