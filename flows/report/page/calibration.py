"""A calibration as one HTML page, in the look of the report."""

from collections.abc import Sequence
from typing import Any

from flows.report.figures import paper as plots
from flows.report.page.base import Tile, environment
from flows.report.page.chart import Chart
from flows.report.terminal.calibration import about_rows, chosen_words
from flows.report.words.calibration import plane_words, sentences
from residual.calibration.calibrate import Calibration
from residual.calibration.methods import DEFAULT, LS, NONE, PAPER_FORM, PLSR
from residual.calibration.methods import WORDS as MODELS
from residual.calibration.rows import PAPER
from residual.calibration.scores import RANDOM, RUN, Score, find
from residual.calibration.scores import WORDS as SCHEMES

_TILES = (
    (RANDOM, PAPER_FORM, "Paper form, random rows"),
    (RUN, PAPER_FORM, "Paper form, unseen runs"),
    (RUN, LS, "LS, unseen runs"),
    (RUN, DEFAULT, "Default form, unseen runs"),
)


def render(made: Calibration, warnings: Sequence[str] = ()) -> str:
    """Return the page of a calibration.

    Args:
        made: The calibration.
    """
    page = environment().get_template("calibration.html")
    return page.render(_context(made, warnings))


def _context(made: Calibration, warnings: Sequence[str]) -> dict[str, Any]:
    words = sentences(made)
    joints = made.rows.joints
    return {
        "robot": made.robot,
        "headline": words[0] if words else "A data-driven correction",
        "lead": words[1:],
        "tiles": _tiles(made.scores),
        "setting": f"{about_rows(made)} Logs: {', '.join(made.rows.labels)}.",
        "chosen": chosen_words(made),
        "warnings": warnings,
        "joints": joints,
        "groups": _groups(made),
        "paper": made.rows.mode == PAPER,
        "schemes": _schemes(made),
        "over_time": _over_time(made),
        "plane": _plane(made),
        "bars": _bars(made),
        "curves": _curves(made),
        "components": _components(made),
        "real": made.components,
        "sweep": _sweep(made),
        "importance": _importance(made),
        "oddities": _oddities(made),
        "notes": made.notes,
    }


def _tiles(scores: Sequence[Score]) -> list[Tile]:
    out = []
    for scheme, model, label in _TILES:
        one, none = find(scores, scheme, model), find(scores, scheme, NONE)
        if one is not None and none is not None:
            note = f"of the torque; no compensation {none.overall:.3g} %"
            out.append(Tile(label, f"{one.overall:.3g} %", note))
    return out


def _groups(made: Calibration) -> list[tuple[str, list[dict]]]:
    """The table: for each scheme its name, then a row per model."""
    out = []
    for scheme in made.schemes:
        own = [one for one in made.scores if one.scheme == scheme.name]
        best = min(one.overall for one in own)
        rows = [_row(one, best) for one in own]
        out.append((SCHEMES[scheme.name], rows))
    return out


def _row(one: Score, best: float) -> dict:
    told = "" if one.components is None else f" (A = {one.components})"
    return {
        "model": MODELS[one.model] + told,
        "rmsev": one.rmsev.tolist(),
        "rmsec": one.rmsec.tolist(),
        "mean": one.mean.tolist(),
        "overall": one.overall,
        "best": one.overall == best,
    }


def _schemes(made: Calibration) -> Chart:
    """All schemes in one view, all joints together."""
    told = "; ".join(
        f"{SCHEMES[o.scheme]}, {MODELS[o.model]} {o.overall:.3g} %" for o in made.scores
    )
    return Chart(plots.schemes_figure(made.scores), f"{told}.", "")


def _over_time(made: Calibration) -> list[Chart]:
    if made.unseen is None:
        return []
    out = []
    for column, joint in enumerate(made.rows.joints):
        uri = plots.over_time_figure(made.unseen, joint, column)
        alt = f"Joint {joint}: residual of {made.unseen.label} and corrections over t."
        out.append(Chart(uri, alt, ""))
    return out


def _plane(made: Calibration) -> dict[str, Any] | None:
    if made.plane is None:
        return None
    words = plane_words(made.plane)
    chart = Chart(plots.plane_figure(made.plane, made.rows.labels), " ".join(words), "")
    return {"chart": chart, "words": words}


def _bars(made: Calibration) -> list[Chart]:
    out = []
    for scheme in made.schemes:
        own = [one for one in made.scores if one.scheme == scheme.name]
        uri = plots.bars_figure(own, made.rows.joints)
        told = "; ".join(f"{MODELS[o.model]} {o.overall:.3g} %" for o in own)
        out.append(Chart(uri, f"{SCHEMES[scheme.name]}: {told}.", ""))
    return out


def _curves(made: Calibration) -> list[Chart]:
    out = []
    for model in (PLSR, PAPER_FORM):
        own = [find(made.scores, scheme, model) for scheme in (RUN, RANDOM)]
        own = [one for one in own if one is not None and one.curve is not None]
        if own:
            told = "; ".join(
                f"{SCHEMES[o.scheme]}: least at {o.components} components" for o in own
            )
            uri = plots.curve_figure(own, made.rows.joints)
            out.append(Chart(uri, f"{MODELS[model]}: {told}.", ""))
    return out


def _components(made: Calibration) -> list[Chart]:
    if not made.components:
        return []
    told = "; ".join(
        f"{o.family}, {o.block}: {o.explained[0]:.0f} % in the first"
        for o in made.components
    )
    return [Chart(plots.components_figure(made.components), f"{told}.", "")]


def _sweep(made: Calibration) -> Chart | None:
    if made.sweep is None:
        return None
    levels = made.sweep.levels
    alt = f"RMSEV over {levels[0]} to {levels[-1]} levels, and time."
    return Chart(plots.sweep_figure(made.sweep, made.rows.joints), alt, "")


def _importance(made: Calibration) -> list[Chart]:
    if made.terms is None:
        return []
    out = []
    for column, joint in enumerate(made.rows.joints):
        largest = int(made.terms.sizes.values[:, column].argmax())
        alt = f"Joint {joint}: the largest contribution is {made.terms.names[largest]}."
        out.append(Chart(plots.importance_figure(made.terms, joint, column), alt, ""))
    return out


def _oddities(made: Calibration) -> list[tuple]:
    odd = made.oddities
    if odd is None:
        return []
    shares = (odd.x, odd.y, *zip(*odd.by_class, strict=True))
    shares += (odd.unvisited, odd.outside)
    percents = [[f"{100 * v:.3g}" for v in column] for column in shares]
    return list(zip(odd.labels, *percents, strict=True))
