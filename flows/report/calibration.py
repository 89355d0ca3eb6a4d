"""A calibration told in the terminal and on a page: errors by scheme and model.

The page has the figures of the paper's chapter.
"""

from collections.abc import Sequence

import numpy as np

from flows.report.document import Callout, Chart, Document, Section, Strong, Table, Tile
from flows.report.figures import paper as figures
from flows.report.page import render as render_page
from flows.report.words.calibration import plane_words, sentences
from flows.report.words.phrases import sentence_case, texts
from flows.steps.calibrate import Calibrated
from residual.calibration.calibrate import Calibration
from residual.calibration.methods import DEFAULT, LS, NONE, PAPER_FORM, PLSR, SPARSE
from residual.calibration.methods import WORDS as MODELS
from residual.calibration.rows import PAPER
from residual.calibration.scores import RANDOM, RUN, Score, find
from residual.calibration.scores import WORDS as SCHEMES
from residual.tables.form import NAMED, PAIRS
from residual.tables.form import PLSR as LINES

_TEXT = texts()["calibration"]

_TILES = (
    (RANDOM, PAPER_FORM, "Paper form, random rows"),
    (RUN, PAPER_FORM, "Paper form, unseen runs"),
    (RUN, LS, "LS, unseen runs"),
    (RUN, DEFAULT, "Default form, unseen runs"),
)


def told(outcome: Calibrated) -> list[str | Table]:
    """Return a calibration for the terminal: the table, and what it shows."""
    result = outcome.made
    return [
        _errors(result),
        about_rows(result),
        chosen_words(result),
        *filter(None, [level_words(result)]),
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
        if option.kind == NAMED:
            what = f"main effects and {option.count} pair table(s)"
        elif option.kind == PAIRS:
            what = f"main effects and all pairs, {option.count} component(s)"
        elif option.kind == LINES:
            what = "a constant"
            if option.count:
                what = f"PLSR, {option.count} component(s)"
        taken.append(f"J{joint} {what}")
    where = (
        "runs" if result.proven else "blocks of the runs, which are fewer than four,"
    )
    return f"default form, chosen on {where} left out: {'; '.join(taken)}."


def level_words(result: Calibration) -> str | None:
    """Return in a sentence which levels the paper form takes; None where given."""
    if result.levels is None:
        return None
    form, names = result.levels.form, result.rows.names
    pairs = zip(names, form.levels, strict=True)
    return (
        f"paper form, levels chosen on runs left out: {result.levels.components} "
        f"component(s), levels {', '.join(f'{n} {k}' for n, k in pairs)}; cells that "
        "no row visited are filled from coarser levels."
    )


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
            Section(
                "bars",
                "The same as bars (figure 10 of the paper)",
                [_schemes(result), *_bars(result)],
            ),
            Section(
                "time",
                "Corrections over time (figure 9)",
                _over_time(result),
                _TEXT["time"],
            ),
            _plane(result),
            _components(result),
            Section(
                "curves", "Components (figure 8)", [_curves(result)], _TEXT["curves"]
            ),
            Section("levels", "Levels (figure 12)", _sweep(result), _TEXT["levels"]),
            Section(
                "importance",
                "Which tables matter",
                [_importance(result)],
                _TEXT["matter"],
            ),
            _oddities(result),
            Section("read", "How to read this page", [texts()["read_calibration"]]),
            Section("notes", "Notes", [result.notes]),
        ),
    )


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


def _tiles(scores: Sequence[Score]) -> list[Tile]:
    out = []
    for scheme, model, label in _TILES:
        one, none = find(scores, scheme, model), find(scores, scheme, NONE)
        if one is not None and none is not None:
            note = f"of the torque; no compensation {none.overall:.3g} %"
            out.append(Tile(label, f"{one.overall:.3g} %", note))
    return out


def _schemes(result: Calibration) -> Chart:
    """All schemes in one view, all joints together."""
    text = "; ".join(
        f"{SCHEMES[o.scheme]}, {MODELS[o.model]} {o.overall:.3g} %"
        for o in result.scores
    )
    return Chart(figures.schemes_figure(result.scores), f"{text}.")


def _over_time(result: Calibration) -> list[Chart]:
    if result.unseen is None:
        return []
    out = []
    for column, joint in enumerate(result.rows.joints):
        uri = figures.over_time_figure(result.unseen, joint, column)
        alt = (
            f"Joint {joint}: residual of {result.unseen.label} and corrections over t."
        )
        out.append(Chart(uri, alt))
    return out


def _plane(result: Calibration) -> Section:
    heading = "Scores and loadings of PLSR"
    if result.plane is None:
        return Section("plane", heading, ())
    words = plane_words(result.plane)
    chart = Chart(
        figures.plane_figure(result.plane, result.rows.labels), " ".join(words)
    )
    return Section("plane", heading, (*words, chart), below=_TEXT["plane"])


def _bars(result: Calibration) -> list[Chart]:
    out = []
    for scheme in result.schemes:
        own = [one for one in result.scores if one.scheme == scheme.name]
        uri = figures.bars_figure(own, result.rows.joints)
        text = "; ".join(f"{MODELS[o.model]} {o.overall:.3g} %" for o in own)
        out.append(Chart(uri, f"{SCHEMES[scheme.name]}: {text}."))
    return out


def _curves(result: Calibration) -> list[Chart]:
    out = []
    for model in (PLSR, PAPER_FORM, SPARSE):
        own = [find(result.scores, scheme, model) for scheme in (RUN, RANDOM)]
        own = [one for one in own if one is not None and one.curve is not None]
        if own:
            text = "; ".join(
                f"{SCHEMES[o.scheme]}: least at {o.components} components" for o in own
            )
            uri = figures.curve_figure(own, result.rows.joints)
            out.append(Chart(uri, f"{MODELS[model]}: {text}."))
    return out


def _components(result: Calibration) -> Section:
    heading, every = "Principal components (figures 4 to 6)", result.components
    if not every:
        return Section("pca", heading, ())
    text = "; ".join(
        f"{o.family}, {o.block}: {o.explained[0]:.0f} % in the first" for o in every
    )
    chart = Chart(figures.components_figure(every), f"{text}.")
    rows = [
        (
            one.family.replace("_", " "),
            one.block,
            str(one.real),
            str(one.permuted),
            ", ".join(f"{name} {value:+.2f}" for name, value in one.first),
        )
        for one in every
    ]
    heads = ("Motion", "Block", "Real components", "by permuted rows")
    table = Table((*heads, "Largest loadings of the first"), rows, left=(0, 1, 4))
    return Section("pca", heading, ([chart], table), _TEXT["pca"])


def _sweep(result: Calibration) -> list[Chart]:
    if result.sweep is None:
        return []
    levels = result.sweep.levels
    alt = f"RMSEV over {levels[0]} to {levels[-1]} levels, and time."
    return [Chart(figures.sweep_figure(result.sweep, result.rows.joints), alt)]


def _importance(result: Calibration) -> list[Chart]:
    if result.terms is None:
        return []
    out = []
    for column, joint in enumerate(result.rows.joints):
        largest = int(result.terms.sizes.values[:, column].argmax())
        alt = (
            f"Joint {joint}: the largest contribution is {result.terms.names[largest]}."
        )
        out.append(Chart(figures.importance_figure(result.terms, joint, column), alt))
    return out


def _oddities(result: Calibration) -> Section:
    heading, odd = "Outliers, and how new each run is to the others", result.oddities
    if odd is None:
        return Section("outliers", heading, ())
    shares = (odd.x, odd.y, *zip(*odd.by_class, strict=True))
    shares += (odd.unvisited, odd.outside)
    percents = [[f"{100 * v:.3g}" for v in column] for column in shares]
    heads = ("Run", "x-outliers, %", "y-outliers, %", "standing", "slow", "fast")
    heads += ("cells unvisited by the other runs, %", "rows outside their range, %")
    table = Table(heads, list(zip(odd.labels, *percents, strict=True)))
    return Section("outliers", heading, [table], below=_TEXT["outliers"])
