"""A calibration in the terminal and on a page: errors by scheme and model.

The page has the figures of the paper's chapter.
"""

from collections.abc import Sequence

import numpy as np

from flows.report import calibration_charts as figures
from flows.report.document import Callout, Chart, Document, Section, Strong, Table, Tile
from flows.report.page import render as render_page
from flows.report.words.calibration import sentences
from flows.report.words.phrases import sentence_case, texts
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
    Score,
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
    """Return a calibration for the terminal: the table, and what it shows."""
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
    least = {
        name: min(one.overall for one in result.scores if one.scheme == name)
        for name in schemes
    }
    rows = []
    for i, one in enumerate(result.scores):
        # The best of each scheme stands out.
        kind = Strong if one.overall == least[one.scheme] else str
        cells = [
            kind(f"{_percent(v)} ({_percent(c)})")
            for v, c in zip(one.rmsev, one.rmsec, strict=True)
        ]
        means = [_percent(m) for m in one.mean] if paper else []
        named = "" if one.components is None else f", A = {one.components}"
        start = [SCHEMES[one.scheme] if i in first else "", MODELS[one.model] + named]
        rows.append([*start, *cells, kind(_percent(one.overall)), *means])
    return Table(heads, rows, left=(0, 1), sections=first[1:])


def _percent(value: float) -> str:
    return "–" if not np.isfinite(value) else f"{value:.1f}"


def about_rows(result: Calibration) -> str:
    """Return in a sentence what X and Y are, so that the errors can be read."""
    rows = result.rows
    common = f"{len(rows.X)} rows of {len(rows.labels)} runs; errors are per cent of "
    common += "the measured torque"
    if rows.mode == PAPER:
        joints = ", ".join(map(str, rows.joints))
        return (
            f"X: reference of joints {joints} and its derivatives; Y: torque minus "
            f"that of the simulated twin, one sample ahead; {common}."
        )
    declared = ", ".join(result.declared) or "nothing"
    return (
        "X: measured motion of all joints; Y: torque minus that of a model (declared: "
        f"{declared}) identified without the held-out runs; {common}."
    )


def chosen_words(result: Calibration) -> str:
    """Return in a sentence what the default form takes for each joint."""
    taken = []
    for joint, option in zip(result.rows.joints, result.chosen, strict=True):
        what = option.kind
        if option.kind == LINES:
            what = (
                f"PLSR, {option.count} component(s)" if option.count else "a constant"
            )
        taken.append(f"J{joint} {what}")
    where = (
        "runs" if result.proven else "blocks of the runs, which are fewer than four,"
    )
    return f"default form, chosen on {where} left out: {'; '.join(taken)}."


def render(result: Calibration, warnings: Sequence[str] = ()) -> str:
    """Return the page of a calibration."""
    return render_page(_document(result, warnings))


def _document(result: Calibration, warnings: Sequence[str]) -> Document:
    words = sentences(result)
    return Document(
        title=f"modelgap calibration: {result.robot}",
        about=f"modelgap calibration of {result.robot}",
        headline=words[0] if words else "A data-driven correction",
        lead=words[1:],
        tiles=_tiles(result.scores),
        setting=f"{about_rows(result)} Logs: {', '.join(result.rows.labels)}.",
        callouts=[Callout("Warnings", warnings)],
        sections=(
            _every_model(result),
            _section("bars", "The same as bars (figure 10)", figures.bars(result)),
            _section(
                "time", "Corrections over time (figure 9)", figures.over_time(result)
            ),
            _section(
                "pca",
                "Principal components (figures 4 to 6)",
                figures.components(result),
                _components(result),
            ),
            _section("curves", "Components (figure 8)", figures.curves(result)),
            _section("levels", "Levels (figure 12)", figures.levels(result)),
            Section("read", "How to read this page", [texts()["read_calibration"]]),
            Section("notes", "Notes", [result.notes]),
        ),
    )


def _section(id: str, heading: str, charts: Sequence[Chart], *more: Table) -> Section:
    return Section(id, heading, [charts, *more] if charts else (), _TEXT.get(id, ""))


def _every_model(result: Calibration) -> Section:
    note = (
        "RMSEV on rows held out, RMSEC in brackets on rows fitted, per cent of the "
        "measured torque, pooled over folds"
    )
    if result.rows.mode == PAPER:
        note += "; the paper's mean over subsets beside it"
    below = f"{sentence_case(chosen_words(result))} {_TEXT['flatters']}"
    return Section(
        "table",
        "Every model under every scheme",
        [_errors(result)],
        f"{note}. {_TEXT['newness']}",
        below,
    )


def _components(result: Calibration) -> Table:
    rows = [
        (
            one.family.replace("_", " "),
            one.block,
            str(one.pca.real),
            ", ".join(f"{name} {value:+.2f}" for name, value in one.pca.strongest(0)),
        )
        for one in result.blocks
    ]
    heads = ("Motion", "Block", "Real components", "Largest loadings of the first")
    return Table(heads, rows, left=(0, 1, 3))


def _tiles(scores: Sequence[Score]) -> list[Tile]:
    out = []
    for scheme, model, label in _TILES:
        one, none = find(scores, scheme, model), find(scores, scheme, NOTHING)
        if one is not None and none is not None:
            note = f"of the torque; no compensation {none.overall:.3g} %"
            out.append(Tile(label, f"{one.overall:.3g} %", note))
    return out
