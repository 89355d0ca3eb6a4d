"""A calibration told in the terminal and on a page: errors by scheme and model.

The page has the figures of the paper's chapter.
"""

from collections.abc import Sequence

import numpy as np

from flows.report.document import Callout, Chart, Document, Section, Strong, Table, Tile
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
from residual.lazy import Lazy
from residual.tables.form import NAMED, PAIRS
from residual.tables.form import PLSR as LINES

_TEXT = texts()["calibration"]

# Who wants no page need not wait for a plotting library.
figures = Lazy("flows.report.figures.paper")

_TILES = (
    (RANDOM, PAPER_FORM, "Paper form, random rows"),
    (RUN, PAPER_FORM, "Paper form, unseen runs"),
    (RUN, LS, "LS, unseen runs"),
    (RUN, DEFAULT, "Default form, unseen runs"),
)


def told(outcome: Calibrated) -> list[str | Table]:
    """Return a calibration for the terminal: the table, and what it shows."""
    made = outcome.made
    return [
        _errors(made),
        about_rows(made),
        chosen_words(made),
        *filter(None, [level_words(made)]),
        *sentences(made),
        *(f"note: {n}" for n in made.notes),
        *(f"warning: {w}" for w in outcome.warnings),
    ]


def _errors(made: Calibration) -> Table:
    paper = made.rows.mode == PAPER
    joints = [f"J{j}" for j in made.rows.joints]
    heads = ["RMSEV (RMSEC) [%]", "model", *joints, "all"]
    heads += [f"mean {joint}" for joint in joints] if paper else []
    schemes = [one.scheme for one in made.scores]
    first = [i for i, name in enumerate(schemes) if name not in schemes[:i]]
    least = {
        name: min(one.overall for one in made.scores if one.scheme == name)
        for name in schemes
    }
    rows = []
    for i, one in enumerate(made.scores):
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


def about_rows(made: Calibration) -> str:
    """Return in a sentence what X and Y are, so that the errors can be read."""
    rows = made.rows
    common = f"{len(rows.X)} rows of {len(rows.labels)} runs; errors are per cent of "
    common += "the measured torque"
    if rows.mode == PAPER:
        joints = ", ".join(map(str, rows.joints))
        return (
            f"X: reference of joints {joints} and its derivatives; Y: torque minus "
            f"that of the simulated twin, one sample ahead; {common}."
        )
    declared = ", ".join(made.declared) or "nothing"
    return (
        "X: measured motion of all joints; Y: torque minus that of a model (declared: "
        f"{declared}) identified without the held-out runs; {common}."
    )


def chosen_words(made: Calibration) -> str:
    """Return in a sentence what the default form takes for each joint."""
    taken = []
    for joint, option in zip(made.rows.joints, made.chosen, strict=True):
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
    where = "runs" if made.proven else "blocks of the runs, which are fewer than four,"
    return f"default form, chosen on {where} left out: {'; '.join(taken)}."


def level_words(made: Calibration) -> str | None:
    """Return in a sentence which levels the paper form takes; None where given."""
    if made.levels is None:
        return None
    form, names = made.levels.form, made.rows.names
    pairs = zip(names, form.levels, strict=True)
    return (
        f"paper form, levels chosen on runs left out: {made.levels.components} "
        f"component(s), levels {', '.join(f'{n} {k}' for n, k in pairs)}; cells that "
        "no row visited are filled from coarser levels."
    )


def render(made: Calibration, warnings: Sequence[str] = ()) -> str:
    """Return the page of a calibration."""
    return render_page(_document(made, warnings))


def _document(made: Calibration, warnings: Sequence[str]) -> Document:
    words = sentences(made)
    return Document(
        title=f"modelgap calibration: {made.robot}",
        about=f"modelgap calibration of {made.robot}",
        headline=words[0] if words else "A data-driven correction",
        lead=words[1:],
        tiles=_tiles(made.scores),
        setting=f"{about_rows(made)} Logs: {', '.join(made.rows.labels)}.",
        callouts=[Callout("Warnings", warnings)],
        sections=(
            _every_model(made),
            Section(
                "bars",
                "The same as bars (figure 10 of the paper)",
                [_schemes(made), *_bars(made)],
            ),
            Section(
                "time",
                "Corrections over time (figure 9)",
                _over_time(made),
                _TEXT["time"],
            ),
            _plane(made),
            _components(made),
            Section(
                "curves", "Components (figure 8)", [_curves(made)], _TEXT["curves"]
            ),
            Section("levels", "Levels (figure 12)", _sweep(made), _TEXT["levels"]),
            Section(
                "importance",
                "Which tables matter",
                [_importance(made)],
                _TEXT["matter"],
            ),
            _oddities(made),
            Section("read", "How to read this page", [texts()["read_calibration"]]),
            Section("notes", "Notes", [made.notes]),
        ),
    )


def _every_model(made: Calibration) -> Section:
    note = (
        "RMSEV on rows held out, RMSEC in brackets on rows fitted, per cent of the "
        "measured torque, pooled over folds"
    )
    if made.rows.mode == PAPER:
        note += "; the paper's mean over subsets beside it"
    below = f"{sentence_case(chosen_words(made))} {_TEXT['flatters']}"
    return Section(
        "table",
        "Every model under every scheme",
        [_errors(made)],
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


def _schemes(made: Calibration) -> Chart:
    """All schemes in one view, all joints together."""
    told = "; ".join(
        f"{SCHEMES[o.scheme]}, {MODELS[o.model]} {o.overall:.3g} %" for o in made.scores
    )
    return Chart(figures.schemes_figure(made.scores), f"{told}.")


def _over_time(made: Calibration) -> list[Chart]:
    if made.unseen is None:
        return []
    out = []
    for column, joint in enumerate(made.rows.joints):
        uri = figures.over_time_figure(made.unseen, joint, column)
        alt = f"Joint {joint}: residual of {made.unseen.label} and corrections over t."
        out.append(Chart(uri, alt))
    return out


def _plane(made: Calibration) -> Section:
    heading = "Scores and loadings of PLSR"
    if made.plane is None:
        return Section("plane", heading, ())
    words = plane_words(made.plane)
    chart = Chart(figures.plane_figure(made.plane, made.rows.labels), " ".join(words))
    return Section("plane", heading, (*words, chart), below=_TEXT["plane"])


def _bars(made: Calibration) -> list[Chart]:
    out = []
    for scheme in made.schemes:
        own = [one for one in made.scores if one.scheme == scheme.name]
        uri = figures.bars_figure(own, made.rows.joints)
        told = "; ".join(f"{MODELS[o.model]} {o.overall:.3g} %" for o in own)
        out.append(Chart(uri, f"{SCHEMES[scheme.name]}: {told}."))
    return out


def _curves(made: Calibration) -> list[Chart]:
    out = []
    for model in (PLSR, PAPER_FORM, SPARSE):
        own = [find(made.scores, scheme, model) for scheme in (RUN, RANDOM)]
        own = [one for one in own if one is not None and one.curve is not None]
        if own:
            told = "; ".join(
                f"{SCHEMES[o.scheme]}: least at {o.components} components" for o in own
            )
            uri = figures.curve_figure(own, made.rows.joints)
            out.append(Chart(uri, f"{MODELS[model]}: {told}."))
    return out


def _components(made: Calibration) -> Section:
    heading, every = "Principal components (figures 4 to 6)", made.components
    if not every:
        return Section("pca", heading, ())
    told = "; ".join(
        f"{o.family}, {o.block}: {o.explained[0]:.0f} % in the first" for o in every
    )
    chart = Chart(figures.components_figure(every), f"{told}.")
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


def _sweep(made: Calibration) -> list[Chart]:
    if made.sweep is None:
        return []
    levels = made.sweep.levels
    alt = f"RMSEV over {levels[0]} to {levels[-1]} levels, and time."
    return [Chart(figures.sweep_figure(made.sweep, made.rows.joints), alt)]


def _importance(made: Calibration) -> list[Chart]:
    if made.terms is None:
        return []
    out = []
    for column, joint in enumerate(made.rows.joints):
        largest = int(made.terms.sizes.values[:, column].argmax())
        alt = f"Joint {joint}: the largest contribution is {made.terms.names[largest]}."
        out.append(Chart(figures.importance_figure(made.terms, joint, column), alt))
    return out


def _oddities(made: Calibration) -> Section:
    heading, odd = "Outliers, and how new each run is to the others", made.oddities
    if odd is None:
        return Section("outliers", heading, ())
    shares = (odd.x, odd.y, *zip(*odd.by_class, strict=True))
    shares += (odd.unvisited, odd.outside)
    percents = [[f"{100 * v:.3g}" for v in column] for column in shares]
    heads = ("Run", "x-outliers, %", "y-outliers, %", "standing", "slow", "fast")
    heads += ("cells unvisited by the other runs, %", "rows outside their range, %")
    table = Table(heads, list(zip(odd.labels, *percents, strict=True)))
    return Section("outliers", heading, [table], below=_TEXT["outliers"])
